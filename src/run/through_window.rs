//! A model run, cycle by cycle, with the states at which observations within a window look.

use isobar_model::{ForecastError, Model, State, forecast};
use isobar_obs::WindowStates;
use std::sync::Arc;

/// A model run that goes on by windows.
pub struct ThroughWindow {
    model: Arc<dyn Model>,
    steps_per_cycle: usize,
    /// The states through the last window, or the last one alone where nothing is observed before it.
    states: Vec<State>,
    keeps_window: bool,
}

impl ThroughWindow {
    /// A run that is at `state`; `keeps_window`: with its states within a window.
    pub fn new(model: Arc<dyn Model>, steps_per_cycle: usize, state: State, keeps_window: bool) -> Self {
        Self { model, steps_per_cycle, states: vec![state], keeps_window }
    }

    /// The state at the end of the last window.
    pub fn state(&self) -> &State {
        &self.states[self.states.len() - 1]
    }

    /// The states through the last window.
    pub fn window(&self) -> WindowStates<'_> {
        WindowStates::new(&self.states, self.model.time_step() * self.steps_per_cycle)
    }

    /// Goes on by one window.
    ///
    /// # Errors
    /// If the state leaves the finite numbers; the run then stays where it is.
    pub fn advance(&mut self) -> Result<(), ForecastError> {
        self.states = if self.keeps_window {
            forecast::trajectory(&*self.model, self.state(), self.steps_per_cycle)?
        } else {
            let mut end = self.state().clone();
            forecast::forecast(&*self.model, &mut end, self.steps_per_cycle)?;
            vec![end]
        };
        Ok(())
    }

    /// Adds to the state at the end of the last window.
    pub fn add(&mut self, increment: impl Iterator<Item = f64>) {
        let end = self.states.len() - 1;
        self.states[end].values_mut().iter_mut().zip(increment).for_each(|(value, change)| *value += change);
    }

    /// Goes to a state that was saved; whether it fits.
    pub fn restore(&mut self, saved: State) -> bool {
        let fits = saved.layout() == self.state().layout();
        if fits {
            self.states = vec![saved];
        }
        fits
    }
}
