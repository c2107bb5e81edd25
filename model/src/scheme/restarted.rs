//! Leapfrog that begins anew again and again, as it does after every analysis: a model whose state has one time level.
//!
//! ```text
//! (x, x̄) = (x, x − Δt f(x))          start: the first of the steps is Euler's
//! (x, x̄) ← leapfrog, n times
//! x(t + n Δt) = x
//! ```
//!
//! An analysis changes the present level alone, so that what a method knows of the other is worth nothing after it. So a
//! cycle's n steps are one step of this model, and its derivative and transpose are those of the whole: no increment of
//! the earlier level is estimated, stored or localised.

use super::leapfrog::Leapfrog;
use super::tendency::Tendency;
use crate::error::ModelError;
use crate::forecast::{Adjoint, Model, TangentLinear};
use crate::state::{Layout, State};
use crate::stored::ColumnsMut;
use crate::time::Duration;
use std::sync::Arc;

/// So many leapfrog steps, from one start to the next, as a step.
#[derive(Clone, Debug)]
pub struct RestartedLeapfrog<T> {
    leapfrog: Leapfrog<T>,
    steps: usize,
    time_step: Duration,
}

impl<T: Tendency> RestartedLeapfrog<T> {
    /// `steps` leapfrog steps as one step.
    ///
    /// # Errors
    /// [`ModelError::Parameter`] if there are none.
    pub fn new(leapfrog: Leapfrog<T>, steps: usize) -> Result<Self, ModelError> {
        crate::error::require_positive("steps", steps as f64)?;
        let time_step = Duration::from_seconds(steps as i64 * leapfrog.time_step().seconds());
        Ok(Self { leapfrog, steps, time_step })
    }

    /// Calls `visit` with the state before each of the leapfrog steps from `at`, and returns that after the last.
    fn run(&self, at: &State, mut visit: impl FnMut(&State)) -> State {
        let mut x = self.leapfrog.start(at);
        for _ in 0..self.steps {
            visit(&x);
            self.leapfrog.step(&mut x);
        }
        x
    }
}

impl<T: Tendency> Model for RestartedLeapfrog<T> {
    fn layout(&self) -> &Arc<Layout> {
        self.leapfrog.tendency().layout()
    }

    fn time_step(&self) -> Duration {
        self.time_step
    }

    fn substeps(&self) -> usize {
        self.steps
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.leapfrog.largest_time_step_s(x)
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        crate::forecast::require_finite_state(x)?;
        self.leapfrog.tendency().check(x.values())
    }

    fn step(&self, x: &mut State) {
        *x = self.leapfrog.present(&self.run(x, |_| ()));
    }
}

impl<T: Tendency> TangentLinear for RestartedLeapfrog<T> {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        let mut levels = self.leapfrog.start_tl(at, columns);
        self.leapfrog.steps_tl(&self.leapfrog.start(at), ColumnsMut::Double(&mut levels), self.steps);
        let one = self.layout().len();
        for (column, levels) in columns.chunks_exact_mut(one).zip(levels.chunks_exact(2 * one)) {
            column.copy_from_slice(&levels[..one]);
        }
    }
}

impl<T: Tendency> Adjoint for RestartedLeapfrog<T> {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        let mut trajectory = Vec::with_capacity(self.steps);
        self.run(at, |at| trajectory.push(at.clone()));
        let one = self.layout().len();
        let mut levels = vec![0.0; 2 * columns.len()];
        for (levels, column) in levels.chunks_exact_mut(2 * one).zip(columns.chunks_exact(one)) {
            levels[..one].copy_from_slice(column);
        }
        for at in trajectory.iter().rev() {
            self.leapfrog.step_ad(at, &mut levels);
        }
        columns.copy_from_slice(&self.leapfrog.start_ad(at, &levels));
    }
}
