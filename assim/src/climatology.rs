//! Climatology: what is known without forecast and observations.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::covariance;
use crate::error::Error;
use crate::problem::Problem;
use crate::saved::unfit;
use isobar_model::Duration;
use isobar_obs::ObservationWindow;

/// The first background with the spread of B for ever: the baseline that no forecast is needed for.
pub struct Climatology {
    problem: Problem,
    estimate: Estimate,
}

impl Climatology {
    /// The climate is the background of the problem.
    pub fn new(problem: Problem) -> Self {
        let spread = covariance::standard_deviations(&*problem.background_error);
        let parameters = problem.estimated_calibration().parameters;
        let estimate = Estimate {
            state: problem.background.clone(),
            calibration: vec![0.0; problem.calibration.len()],
            state_spread: Some(spread),
            calibration_spread: (!parameters.is_empty())
                .then(|| parameters.iter().map(|parameter| parameter.sigma_prior).collect()),
        };
        Self { problem, estimate }
    }
}

impl Assimilator for Climatology {
    fn forecast(&mut self, _: Duration) -> Result<Estimate, Error> {
        Ok(self.estimate.clone())
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let departures = self.problem.departures(observed, &self.estimate.state, &self.estimate.calibration);
        Ok(Analysis {
            estimate: self.estimate.clone(),
            background_departures: departures.clone(),
            analysis_departures: departures,
            innovation_chi2: None,
            partition: None,
            warnings: Vec::new(),
        })
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        Ok(Vec::new())
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        if saved.is_empty() { Ok(()) } else { Err(unfit("what is saved of a climatology")) }
    }
}
