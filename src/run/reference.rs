//! The reference of quality control: a forecast that no observation and no truth ever touches.

use isobar_model::{Model, State, forecast};
use isobar_obs::QualityControl;
use std::sync::Arc;

/// A forecast from the first background, and how observations are compared with it.
pub struct Reference {
    control: QualityControl,
    model: Arc<dyn Model>,
    steps_per_cycle: usize,
    state: State,
}

impl Reference {
    /// The forecast that begins at `state`.
    pub fn new(control: QualityControl, model: Arc<dyn Model>, steps_per_cycle: usize, state: State) -> Self {
        Self { control, model, steps_per_cycle, state }
    }

    /// How observations are compared, and with which state.
    pub fn now(&self) -> (&QualityControl, &State) {
        (&self.control, &self.state)
    }

    /// Goes on by one cycle. A forecast that blows up leaves the reference as it is: an old one is better than none.
    pub fn advance(&mut self) {
        let mut next = self.state.clone();
        if forecast::forecast(&*self.model, &mut next, self.steps_per_cycle).is_ok() {
            self.state = next;
        }
    }

    /// Its state, for a checkpoint.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Takes back what [`Reference::state`] gave; whether it fits.
    pub fn restore(&mut self, saved: State) -> bool {
        let fits = saved.layout() == self.state.layout();
        if fits {
            self.state = saved;
        }
        fits
    }
}
