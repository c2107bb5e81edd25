//! How an analysis responds to innovations of one's choice: its gain, without a look into the method.

use crate::assimilator::{Assimilator, Estimate};
use crate::error::Error;
use faer::Mat;
use isobar_obs::ObservationWindow;

/// A method between forecast and analysis, to be asked what its analysis would make of innovations d.
///
/// An analysis that is linear in d is `(δx, δc) = K d`; its columns are the responses to unit innovations. The method is
/// set back before each of them by [`Assimilator::restore`], and by [`Responder::finish`] once and for all, so that its
/// own analysis has the same bits as without.
pub struct Responder<'a> {
    method: &'a mut dyn Assimilator,
    background: &'a Estimate,
    memory: Vec<u8>,
    /// The observations, whose values are replaced.
    window: ObservationWindow,
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
    ///
    /// # Errors
    /// Those of [`Assimilator::save`].
    pub fn new(
        method: &'a mut dyn Assimilator,
        background: &'a Estimate,
        observed: &ObservationWindow,
    ) -> Result<Self, Error> {
        let memory = method.save()?;
        let simulated = observed.operator.simulate(&background.state, &background.calibration);
        Ok(Self { method, background, memory, window: observed.clone(), simulated })
    }

    /// The analysis of these innovations.
    ///
    /// # Errors
    /// Those of the method.
    pub fn to(&mut self, innovations: &[f64]) -> Result<Response, Error> {
        self.window.values = self.simulated.iter().zip(innovations).map(|(value, d)| value + d).collect();
        self.method.restore(&self.memory)?;
        let analysis = self.method.analyse(&self.window)?;
        let change = |after: &[f64], before: &[f64]| after.iter().zip(before).map(|(a, b)| a - b).collect();
        Ok(Response {
            state: change(analysis.estimate.state.values(), self.background.state.values()),
            calibration: change(&analysis.estimate.calibration, &self.background.calibration),
            fit: change(&analysis.background_departures, &analysis.analysis_departures),
        })
    }

    /// K, column by column: as many analyses as there are observations.
    ///
    /// # Errors
    /// Those of the method.
    pub fn gain(&mut self) -> Result<Gain, Error> {
        let (m, p, n) = (self.background.state.values().len(), self.background.calibration.len(), self.window.len());
        let mut gain = Gain { state: Mat::zeros(m, n), calibration: Mat::zeros(p, n) };
        let mut innovations = vec![0.0; n];
        for column in 0..n {
            // Of the size of the errors, lest it be lost among the digits of the state.
            let size = self.window.sigma[column];
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

    /// Sets the method back.
    ///
    /// # Errors
    /// Those of [`Assimilator::restore`].
    pub fn finish(self) -> Result<(), Error> {
        self.method.restore(&self.memory)
    }
}
