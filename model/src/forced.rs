//! A model with a forcing: dx/dt = f(x) + B u(t).
//!
//! A step of the model of f stands between the integrals of the forcing over the two halves of that step:
//!
//! ```text
//! x ← x + B ∫ u dt, t to t + Δt/2      x ← M(x)      x ← x + B ∫ u dt, t + Δt/2 to t + Δt
//! ```
//!
//! (Strang 1968, SIAM J. Numer. Anal. 5, 506–517). The integrals are exact, so the only error is that f acts on what the forcing
//! has added as if it came at the ends of the step: with f(x) = A x it is, in one step,
//!
//! ```text
//! ∫ e^(A (Δt − s)) B u(t + s) ds − e^(A Δt) B ∫₁ u − B ∫₂ u = Δt³ (A B u'/24 − A² B u/12) + O(Δt⁴),
//! ```
//!
//! of second order in the end, whatever the order of M. It is zero where f does not act on B: where the flow follows the lines
//! on which a pattern is constant.
//!
//! What is added does not depend on the state: the derivative of the step and its transpose are those of M, taken at the state
//! with the first half. M has any time scheme, or none.

use crate::error::ModelError;
use crate::forcing::Forcing;
use crate::forecast::{Adjoint, Between, Model, TangentLinear};
use crate::state::{Layout, State};
use crate::stored::ColumnsMut;
use crate::time::{Duration, Time};
use std::ops::Range;
use std::sync::Arc;

/// A model with a forcing.
#[derive(Clone)]
pub struct Forced {
    model: Arc<dyn Adjoint>,
    forcing: Arc<Forcing>,
}

impl Forced {
    /// A model with this forcing; as it is, without one.
    ///
    /// # Errors
    /// As [`Forcing::check`].
    pub fn of(model: Arc<dyn Adjoint>, forcing: &Arc<Forcing>) -> Result<Arc<dyn Adjoint>, ModelError> {
        if forcing.is_empty() {
            return Ok(model);
        }
        forcing.check(model.layout())?;
        Ok(Arc::new(Self { model, forcing: Arc::clone(forcing) }))
    }

    /// Adds the forcing of the first or of the second half of a step that begins at a time.
    fn add_half(&self, time: Time, second: bool, x: &mut [f64]) {
        let step_s = self.model.time_step().as_f64();
        let span_s = if second { [0.5 * step_s, step_s] } else { [0.0, 0.5 * step_s] };
        self.forcing.add(1.0, time, span_s, x);
    }

    /// The state from which M goes on.
    fn with_first_half(&self, x: &State) -> State {
        let mut x = x.clone();
        self.add_half(time_of(&x), false, x.values_mut());
        x
    }
}

/// The time of a state from which a forecast has been allowed to start.
///
/// # Panics
/// If it has none.
pub(crate) fn time_of(x: &State) -> Time {
    x.require_time().unwrap_or_else(|error| panic!("{error}"))
}

impl Model for Forced {
    fn layout(&self) -> &Arc<Layout> {
        self.model.layout()
    }

    fn time_step(&self) -> Duration {
        self.model.time_step()
    }

    fn substeps(&self) -> usize {
        self.model.substeps()
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.model.largest_time_step_s(x)
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Arc<dyn Adjoint>> {
        let forcing = Arc::new(self.forcing.in_rows(&self.layout().grid, rows));
        Some(Arc::new(Self { model: self.model.in_rows(rows)?, forcing }))
    }

    fn reach(&self) -> usize {
        self.model.reach()
    }

    fn needs_time(&self) -> bool {
        true
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        self.model.check_state(x)
    }

    fn step(&self, x: &mut State) {
        self.steps(std::slice::from_mut(x), 1);
    }

    fn best_together(&self) -> usize {
        self.model.best_together()
    }

    fn steps(&self, states: &mut [State], steps: usize) {
        let (starts, span) = (states.iter().map(time_of).collect::<Vec<Time>>(), self.time_step());
        for step in 0..steps {
            let add_half = |states: &mut [State], second: bool| {
                let times = starts.iter().map(|&start| start + span * step);
                states.iter_mut().zip(times).for_each(|(x, time)| self.add_half(time, second, x.values_mut()));
            };
            add_half(states, false);
            self.model.steps(states, 1);
            add_half(states, true);
        }
    }
}

impl TangentLinear for Forced {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.model.step_tl(&self.with_first_half(at), columns);
    }

    fn steps_tl_between(&self, at: &State, columns: ColumnsMut<'_>, steps: usize, between: Between<'_>) {
        let (start, span) = (time_of(at), self.time_step());
        // From the end of M in a step to its beginning in the next.
        let sources = |step: usize, x: &mut [f64]| {
            self.add_half(start + span * (step - 1), true, x);
            between(step, x);
            self.add_half(start + span * step, false, x);
        };
        self.model.steps_tl_between(&self.with_first_half(at), columns, steps, &sources);
    }
}

impl Adjoint for Forced {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        self.model.step_ad(&self.with_first_half(at), columns);
    }

    fn steps_ad(&self, states: &[State], columns: &mut [f64]) {
        let states: Vec<State> = states.iter().map(|at| self.with_first_half(at)).collect();
        self.model.steps_ad(&states, columns);
    }
}
