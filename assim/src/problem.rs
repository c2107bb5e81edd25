//! What every method is given at its start, and the innovations it computes from a window of observations.

use crate::assimilator::{Analysis, BiasTreatment, Estimate};
use crate::covariance::Covariance;
use crate::error::Error;
use isobar_model::{Adjoint, Duration, State};
use isobar_obs::{Calibration, Jacobian, ObservationWindow, SparseRows};
use std::sync::Arc;

/// An assimilation problem: everything that a method may know. The truth is not part of it.
#[derive(Clone)]
pub struct Problem {
    /// The forecast model.
    pub model: Arc<dyn Adjoint>,
    /// The background at the start.
    pub background: State,
    /// Covariance of its error.
    pub background_error: Arc<dyn Covariance>,
    /// Covariance of the model error that a cycle adds; `None` for a perfect model.
    pub model_error: Option<Arc<dyn Covariance>>,
    /// The calibration parameters, with prior mean zero.
    pub calibration: Calibration,
    /// What becomes of the biases.
    pub bias: BiasTreatment,
    /// The most memory that the method may use \[bytes\].
    pub memory_limit_bytes: u64,
}

impl Problem {
    /// The time steps of a forecast over `window`.
    pub(crate) fn steps(&self, window: Duration) -> Result<usize, Error> {
        window.steps_of(self.model.time_step()).ok_or_else(|| {
            Error::Setting(format!(
                "the window of {window} is not a whole number of time steps of {}",
                self.model.time_step()
            ))
        })
    }

    /// The calibration parameters that the method estimates: all or none.
    pub(crate) fn estimated_calibration(&self) -> Calibration {
        match self.bias {
            BiasTreatment::Estimate => self.calibration.clone(),
            BiasTreatment::Ignore | BiasTreatment::Known => Calibration::default(),
        }
    }

    /// Innovations about an estimate; `calibration` holds all parameters of the experiment.
    pub(crate) fn innovations(
        &self,
        observed: &ObservationWindow,
        state: &State,
        calibration: &[f64],
    ) -> Result<Innovations, Error> {
        let mut jacobian = observed.operator.linearize(state, calibration);
        if self.bias != BiasTreatment::Estimate {
            jacobian.calibration = SparseRows::new();
            (0..observed.len()).for_each(|_| jacobian.calibration.push_row([]));
        }
        let departures = self.departures(observed, state, calibration);
        if let Some(row) = departures.iter().position(|departure| !departure.is_finite()) {
            let report = &observed.reports[row];
            return Err(Error::NotFinite { what: format!("the innovation of {}/{}", report.network, report.platform) });
        }
        let variance = observed.sigma.iter().map(|sigma| sigma * sigma).collect();
        Ok(Innovations { departures, jacobian, variance })
    }

    /// y − h(x, c).
    pub(crate) fn departures(&self, observed: &ObservationWindow, state: &State, calibration: &[f64]) -> Vec<f64> {
        let simulated = observed.operator.simulate(state, calibration);
        observed.values.iter().zip(simulated).map(|(value, simulated)| value - simulated).collect()
    }

    /// What an analysis did with `observed`, from the innovations that it began with and the estimate that it came to.
    pub(crate) fn analysis(
        &self,
        observed: &ObservationWindow,
        innovations: Innovations,
        estimate: Estimate,
        innovation_chi2: f64,
    ) -> Analysis {
        let analysis_departures = self.departures(observed, &estimate.state, &estimate.calibration);
        Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2),
            partition: None,
        }
    }
}

/// The observations of a cycle as seen from an estimate.
pub(crate) struct Innovations {
    /// d = y − h(x, c).
    pub departures: Vec<f64>,
    /// X and G.
    pub jacobian: Jacobian,
    /// The diagonal of R.
    pub variance: Vec<f64>,
}

impl Innovations {
    /// R^-½ dy.
    pub fn whiten(&self, mut dy: Vec<f64>) -> Vec<f64> {
        dy.iter_mut().zip(&self.variance).for_each(|(value, variance)| *value /= variance.sqrt());
        dy
    }
}
