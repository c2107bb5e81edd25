//! No assimilation: the model runs free.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::error::Error;
use crate::problem::Problem;
use crate::saved::{from_bytes, restore_state, to_bytes};
use isobar_model::{Duration, State, forecast};
use isobar_obs::ObservationWindow;

/// The free run: the error that every method must beat.
pub struct FreeRun {
    problem: Problem,
    state: State,
}

impl FreeRun {
    /// A free run from the background.
    pub fn new(problem: Problem) -> Self {
        let state = problem.background.clone();
        Self { problem, state }
    }

    fn estimate(&self) -> Estimate {
        Estimate {
            state: self.state.clone(),
            calibration: vec![0.0; self.problem.calibration.len()],
            state_spread: None,
            calibration_spread: None,
        }
    }
}

impl Assimilator for FreeRun {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        forecast::forecast(&*self.problem.model, &mut self.state, self.problem.steps(window)?)?;
        Ok(self.estimate())
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let estimate = self.estimate();
        let departures = self.problem.departures(observed, &estimate.state, &estimate.calibration);
        Ok(Analysis {
            estimate,
            background_departures: departures.clone(),
            analysis_departures: departures,
            innovation_chi2: None,
            partition: None,
            warnings: Vec::new(),
        })
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&self.state.values())
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let values: Vec<f64> = from_bytes(saved)?;
        restore_state(&mut self.state, &values)
    }
}
