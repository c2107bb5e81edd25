//! The truth: a model run of its own, with stochastic model error, that no method ever sees.

use isobar_assim::{Covariance, covariance};
use isobar_model::{ForecastError, Model, State, forecast};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The true world.
pub struct Truth {
    model: Arc<dyn Model>,
    steps_per_cycle: usize,
    /// Covariance of what a cycle adds, and the factor on its standard deviation.
    model_error: Option<(Arc<dyn Covariance>, f64)>,
    random: ChaCha8Rng,
    state: State,
}

/// The truth's memory, for a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedTruth {
    state: State,
    /// Numbers drawn so far, in words of 32 bits.
    random: u128,
}

impl Truth {
    /// A world that is at `state` now, and follows `model` with random errors of the given covariance and factor on the
    /// standard deviation.
    pub fn new(
        model: Arc<dyn Model>,
        steps_per_cycle: usize,
        model_error: Option<(Arc<dyn Covariance>, f64)>,
        random: ChaCha8Rng,
        state: State,
    ) -> Self {
        Self { model, steps_per_cycle, model_error, random, state }
    }

    /// The true state now.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Everything that the next cycles depend on and the scenario does not determine.
    pub fn save(&self) -> SavedTruth {
        SavedTruth { state: self.state.clone(), random: self.random.get_word_pos() }
    }

    /// Takes back what [`Truth::save`] gave; whether it fits.
    pub fn restore(&mut self, saved: SavedTruth) -> bool {
        let fits = saved.state.layout() == self.state.layout();
        if fits {
            self.state = saved.state;
            self.random.set_word_pos(saved.random);
        }
        fits
    }

    /// Goes on by one cycle.
    ///
    /// # Errors
    /// If the true state leaves the finite numbers.
    pub fn advance(&mut self) -> Result<(), ForecastError> {
        forecast::forecast(&*self.model, &mut self.state, self.steps_per_cycle)?;
        if let Some((covariance, factor)) = &self.model_error {
            let error = covariance::randomize(&**covariance, &mut self.random);
            self.state.values_mut().iter_mut().zip(error).for_each(|(value, error)| *value += factor * error);
        }
        Ok(())
    }
}
