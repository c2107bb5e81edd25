//! How an analysis responds to innovations of one's choice: its gain, without a look into the method.

use crate::assimilator::Assimilator;
use crate::error::Error;
use crate::estimate::Background;
use faer::Mat;
use isobar_model::vector::{add, difference};
use isobar_obs::ObservationWindow;

/// A method between forecast and analysis, to be asked what its analysis would make of innovations d.
///
/// An analysis that is linear in d is `(δx, δc) = K d`; its columns are the responses to unit innovations. Each answer is
/// that of a copy of the method, which stays as it is.
pub struct Responder<'a> {
    method: &'a dyn Assimilator,
    background: &'a Background,
    observed: &'a ObservationWindow,
    /// h(x, c) of the background.
    simulated: Vec<f64>,
}

/// What an analysis adds.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// δx.
    pub state: Vec<f64>,
    /// δc, all parameters of the experiment.
    pub calibration: Vec<f64>,
    /// h(analysis) − h(background), one per observation.
    pub fit: Vec<f64>,
}

/// K of an analysis.
#[derive(Clone, Debug, PartialEq)]
pub struct Gain {
    /// Of the state, `[m, n]`.
    pub state: Mat<f64>,
    /// Of the calibration, `[p, n]`.
    pub calibration: Mat<f64>,
}

impl<'a> Responder<'a> {
    /// Asks a method that has just forecast `background` about the operators of `observed`.
    pub fn new(method: &'a dyn Assimilator, background: &'a Background, observed: &'a ObservationWindow) -> Self {
        let estimate = &background.estimate;
        let simulated = observed.operator.simulate(&estimate.state, &estimate.calibration);
        Self { method, background, observed, simulated }
    }

    /// The analysis of these innovations.
    ///
    /// # Errors
    /// Those of the method.
    pub fn to(&self, innovations: &[f64]) -> Result<Response, Error> {
        let mut observed = self.observed.clone();
        observed.values.clone_from(&self.simulated);
        add(&mut observed.values, innovations);
        // Comparisons of sensors say nothing new.
        let calibration = &self.background.estimate.calibration;
        observed.comparisons.iter_mut().for_each(|it| it.value = it.simulate(calibration));
        let analysis = self.method.boxed_clone().analyse(self.background, &observed)?;
        let before = &self.background.estimate;
        Ok(Response {
            state: difference(analysis.estimate.state.values(), before.state.values()),
            calibration: difference(&analysis.estimate.calibration, &before.calibration),
            fit: difference(&analysis.background_departures, &analysis.analysis_departures),
        })
    }

    /// K, column by column: as many analyses as there are observations.
    ///
    /// # Errors
    /// Those of the method.
    pub fn gain(&self) -> Result<Gain, Error> {
        let before = &self.background.estimate;
        let (m, p, n) = (before.state.values().len(), before.calibration.len(), self.observed.len());
        let mut gain = Gain { state: Mat::zeros(m, n), calibration: Mat::zeros(p, n) };
        let mut innovations = vec![0.0; n];
        // A response is a difference of two states: one of a thousandth of the state's size keeps all but three of its digits,
        // where one of the size of a very small σ would be rounded away.
        let values = before.state.values().iter().chain(&before.calibration).chain(&self.simulated);
        let least = 1e-3 * values.fold(0.0f64, |largest, value| largest.max(value.abs()));
        for column in 0..n {
            let size = self.observed.sigma[column].max(least);
            innovations[column] = size;
            let response = self.to(&innovations)?;
            innovations[column] = 0.0;
            let divide =
                |to: &mut [f64], from: &[f64]| to.iter_mut().zip(from).for_each(|(to, from)| *to = from / size);
            divide(gain.state.col_as_slice_mut(column), &response.state);
            divide(gain.calibration.col_as_slice_mut(column), &response.calibration);
        }
        Ok(gain)
    }
}
