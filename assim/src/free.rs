//! No assimilation: the model runs free.

use crate::assimilator::Assimilator;
use crate::augmented::Augmented;
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::memory::{read, write};
use crate::problem::{Problem, steps};
use isobar_model::{Duration, Model, forecast};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};

/// The free run: the error that every method must beat.
#[derive(Clone)]
pub struct FreeRun {
    problem: Problem<dyn Model>,
    /// The parameters stay zero.
    s: Augmented,
}

impl FreeRun {
    /// A free run from the background.
    pub fn new(problem: impl Into<Problem<dyn Model>>) -> Self {
        let problem = problem.into();
        Self { s: Augmented::background(&problem), problem }
    }

    fn estimate(&self) -> Estimate {
        let Augmented { state, bias } = self.s.clone();
        Estimate { state, calibration: bias, state_spread: None, calibration_spread: None }
    }
}

impl Assimilator for FreeRun {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let model = &*self.problem.model;
        forecast::forecast(model, &mut self.s.state, steps(model, window)?)?;
        Ok(Background { estimate: self.estimate(), window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        Ok(self.problem.unchanged(observed, self.estimate()))
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.s, to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let s: Augmented = read(from)?;
        s.require_like(&self.s)?;
        self.s = s;
        Ok(())
    }
}
