//! The augmented state s = (x, c).

use crate::error::Error;
use crate::memory::require;
use crate::problem::Problem;
use isobar_model::State;
use isobar_model::vector::add;
use serde::{Deserialize, Serialize};

/// State and calibration.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Augmented {
    /// x.
    pub state: State,
    /// All parameters of the experiment. Those that are estimated, c, are all or none of them.
    pub bias: Vec<f64>,
}

impl Augmented {
    /// The background of a problem, with parameters of zero.
    pub fn background<M: ?Sized>(problem: &Problem<M>) -> Self {
        Self { state: problem.background.clone(), bias: vec![0.0; problem.calibration.len()] }
    }

    /// s ← s + δs, with an increment of the state and of the parameters that are estimated.
    pub fn add(&mut self, increment: &[f64]) {
        let (of_state, of_bias) = increment.split_at(self.state.values().len());
        add(self.state.values_mut(), of_state);
        add(&mut self.bias[..of_bias.len()], of_bias);
    }

    /// c ← φ c, for the parameters that are estimated.
    pub fn decay(&mut self, kept: &[f64]) {
        self.bias.iter_mut().zip(kept).for_each(|(value, kept)| *value *= kept);
    }

    /// Fails if `self` is of another experiment than `like`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require_like(&self, like: &Augmented) -> Result<(), Error> {
        require(self.state.layout() == like.state.layout(), "the state")?;
        require(self.bias.len() == like.bias.len(), "the calibration")
    }
}
