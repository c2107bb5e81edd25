//! Climatology: what is known without forecast and observations.

use crate::assimilator::Assimilator;
use crate::covariance;
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::problem::Problem;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};

/// The first background with the spread of B in every cycle: the baseline that no forecast is needed for.
#[derive(Clone)]
pub struct Climatology {
    problem: Problem<dyn Model>,
    estimate: Estimate,
}

impl Climatology {
    /// The climate is the background of the problem.
    pub fn new(problem: impl Into<Problem<dyn Model>>) -> Self {
        let problem = problem.into();
        let spread = covariance::standard_deviations(&*problem.background_error);
        let parameters = problem.estimated_calibration().parameters;
        let estimate = Estimate {
            // A climatology has no valid time.
            state: problem.background.clone().valid_at(None),
            calibration: vec![0.0; problem.calibration.len()],
            state_spread: Some(spread),
            calibration_spread: (!parameters.is_empty())
                .then(|| parameters.iter().map(|parameter| parameter.sigma_prior).collect()),
        };
        Self { problem, estimate }
    }
}

impl Assimilator for Climatology {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        Ok(Background { estimate: self.estimate.clone(), window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        Ok(self.problem.unchanged(observed, self.estimate.clone()))
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, _: &mut dyn Write) -> Result<(), Error> {
        Ok(())
    }

    fn recall(&mut self, _: &mut dyn Read) -> Result<(), Error> {
        Ok(())
    }
}
