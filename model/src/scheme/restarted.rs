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
//!
//! Euler's step excites the computational mode and amplifies every wave, which the leapfrog steps that follow do not undo.
//! On ẋ = iωx with θ = ωΔt a cycle multiplies the amplitude by |x_n|,
//!
//! ```text
//! x_k = A λ₊^k + B λ₋^k,    λ± = α + iθ ± √((1 − α)² − θ²),    x_0 = 1,    x_1 = 1 + iθ,
//! ```
//!
//! the amplification factors being those of [`super::leapfrog`]. Without the filter |x_n|² = 1 + θ²/(1 − θ²) sin²(n asin θ) for
//! an even n, which is never below one: a free forecast grows from cycle to cycle, at a step of 45 % of the leapfrog's limit
//! by 10 % in a cycle of four steps (α = 0.01). The filter damps a wave by about α θ²/2 in a step, so that n α ⪆ 1 makes up
//! for it. The limit of the time step is that of the cycle: |x_n| ≤ 1 + [`LARGEST_GROWTH`] for all waves.
//!
//! A [`Forcing`] B u(t) is integrated exactly over what a step leaps over, 2Δt and with Euler's step Δt,
//!
//! ```text
//! x̄(t₀ − Δt) = x − Δt f(x) − F₁      F₁ = B ∫ u dt, t₀ to t₀ + Δt                             start
//! x(t + Δt)  = x̄(t − Δt) + 2Δt f(x(t)) + F,      F = 2 F₁ at first, then B ∫ u dt, t − Δt to t + Δt,
//! ```
//!
//! so that it has the errors of the scheme itself, of second order but for Euler's step and the filter. It depends on no state:
//! derivative and transpose stay those of the leapfrog, along the trajectory with the forcing.

use super::leapfrog::Leapfrog;
use super::tendency::Tendency;
use crate::error::ModelError;
use crate::forced::time_of;
use crate::forcing::Forcing;
use crate::forecast::{Adjoint, Between, Model, TangentLinear, along};
use crate::state::{Layout, State};
use crate::stored::{ColumnsMut, Stored};
use crate::time::{Duration, Time};
use std::ops::Range;
use std::sync::Arc;

/// By how much a wave may grow in a cycle.
pub const LARGEST_GROWTH: f64 = 1e-3;

/// So many leapfrog steps, from one start to the next, as a step.
#[derive(Clone, Debug)]
pub struct RestartedLeapfrog<T> {
    leapfrog: Leapfrog<T>,
    steps: usize,
    time_step: Duration,
    /// The largest θ up to which no wave grows by more than [`LARGEST_GROWTH`] in a cycle.
    largest_angle: f64,
    forcing: Arc<Forcing>,
}

impl<T: Tendency> RestartedLeapfrog<T> {
    /// `steps` leapfrog steps as one step.
    ///
    /// # Errors
    /// [`ModelError::Parameter`] if there are none.
    pub fn new(leapfrog: Leapfrog<T>, steps: usize) -> Result<Self, ModelError> {
        crate::error::require_positive("steps", steps as f64)?;
        let time_step = Duration::from_seconds(steps as i64 * leapfrog.time_step().seconds());
        let largest_angle = largest_angle(steps, leapfrog.robert_filter());
        Ok(Self { leapfrog, steps, time_step, largest_angle, forcing: Arc::default() })
    }

    /// The same with a forcing.
    ///
    /// # Errors
    /// As [`Forcing::check`].
    pub fn forced(self, forcing: Arc<Forcing>) -> Result<Self, ModelError> {
        forcing.check(self.layout())?;
        Ok(Self { forcing, ..self })
    }

    /// Calls `visit` with the state before each of the leapfrog steps from `at`, and returns that after the last.
    fn run(&self, at: &State, mut visit: impl FnMut(&State)) -> State {
        let mut x = self.start(at);
        for step in 0..self.steps {
            visit(&x);
            self.leapfrog.step(&mut x);
            if !self.forcing.is_empty() {
                self.force(step, time_of(at), x.values_mut());
            }
        }
        x
    }

    /// Both levels from which the first of the leapfrog steps starts.
    fn start(&self, at: &State) -> State {
        let mut x = self.leapfrog.start(at);
        if !self.forcing.is_empty() {
            let earlier = self.layout().len();
            self.forcing.add(-1.0, time_of(at), self.leapt(0), &mut x.values_mut()[earlier..]);
        }
        x
    }

    /// Seconds of the cycle over which a step's forcing is integrated.
    fn leapt(&self, step: usize) -> [f64; 2] {
        let (dt, step) = (self.leapfrog.time_step().as_f64(), step as f64);
        [(step - 1.0).max(0.0) * dt, (step + 1.0) * dt]
    }

    /// Adds the forcing of a step of the cycle that begins at a time to both levels: to the filtered one as far as the filter
    /// takes over from the new one.
    fn force(&self, step: usize, time: Time, x: &mut [f64]) {
        let (now, filtered) = x.split_at_mut(self.leapfrog.tendency().layout().len());
        let factor = if step == 0 { 2.0 } else { 1.0 };
        self.forcing.add(factor, time, self.leapt(step), now);
        self.forcing.add(factor * self.leapfrog.robert_filter(), time, self.leapt(step), filtered);
    }

    /// Advances increments by a cycle from `at`: their start is in double precision.
    fn advance<N: Stored>(&self, at: &State, columns: &mut [N]) {
        let mut levels = self.leapfrog.start_tl(at, columns);
        let forced = |step: usize, x: &mut [f64]| {
            if !self.forcing.is_empty() {
                self.force(step - 1, time_of(at), x);
            }
        };
        self.leapfrog.steps_tl_between(&self.start(at), N::columns_mut(&mut levels), self.steps, &forced);
        let one = self.layout().len();
        for (column, levels) in columns.chunks_exact_mut(one).zip(levels.chunks_exact(2 * one)) {
            column.copy_from_slice(&levels[..one]);
        }
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
        // The waves of least damping are taken to have none: the bounds do not say which waves are damped.
        let oscillation = self.leapfrog.tendency().spectral_bounds(x.values()).oscillation_per_s;
        self.leapfrog.largest_time_step_s(x).min(self.largest_angle / oscillation)
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Arc<dyn Adjoint>> {
        let forcing = Arc::new(self.forcing.in_rows(&self.layout().grid, rows));
        Some(Arc::new(Self { leapfrog: self.leapfrog.in_rows(rows)?, forcing, ..*self }))
    }

    /// As far as f in each leapfrog step and in the start.
    fn reach(&self) -> usize {
        self.leapfrog.tendency().reach() * (self.steps + 1) + 1
    }

    fn needs_time(&self) -> bool {
        !self.forcing.is_empty()
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        crate::forecast::require_finite_state(x)?;
        self.leapfrog.tendency().check(x.values())
    }

    fn step(&self, x: &mut State) {
        self.steps(std::slice::from_mut(x), 1);
    }

    fn best_together(&self) -> usize {
        if self.forcing.is_empty() { self.leapfrog.best_together() } else { 1 }
    }

    fn steps(&self, states: &mut [State], steps: usize) {
        for _ in 0..steps {
            if self.forcing.is_empty() {
                let mut levels: Vec<State> = states.iter().map(|x| self.leapfrog.start(x)).collect();
                self.leapfrog.steps(&mut levels, self.steps);
                states.iter_mut().zip(&levels).for_each(|(x, levels)| *x = self.leapfrog.present(levels));
            } else {
                states.iter_mut().for_each(|x| *x = self.leapfrog.present(&self.run(x, |_| ())));
            }
        }
    }
}

impl<T: Tendency> TangentLinear for RestartedLeapfrog<T> {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.advance(at, columns);
    }

    fn steps_tl_between(&self, at: &State, columns: ColumnsMut<'_>, steps: usize, between: Between<'_>) {
        match columns {
            ColumnsMut::Double([]) | ColumnsMut::Single([]) => {}
            ColumnsMut::Double(columns) => along(self, at, steps, between, |at| self.advance(at, columns)),
            ColumnsMut::Single(columns) => along(self, at, steps, between, |at| self.advance(at, columns)),
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
        self.leapfrog.steps_ad(&trajectory, &mut levels);
        columns.copy_from_slice(&self.leapfrog.start_ad(at, &levels));
    }
}

/// |x_n| of a cycle of n steps.
fn amplification(steps: usize, robert_filter: f64, theta: f64) -> f64 {
    let (double, filter) = (2.0 * theta, robert_filter);
    // x_k and x̄_{k−1}, real and imaginary parts.
    let (mut now, mut before) = ([1.0, 0.0], [1.0, -theta]);
    for _ in 0..steps {
        let next = [before[0] - double * now[1], before[1] + double * now[0]];
        before = [0, 1].map(|part| now[part] + filter * (next[part] - 2.0 * now[part] + before[part]));
        now = next;
    }
    now[0].hypot(now[1])
}

/// The largest θ below which |x_n| ≤ 1 + [`LARGEST_GROWTH`] everywhere.
///
/// |x_n| oscillates with a period of π/n; from [`MOST_STEPS`] steps on the filter has damped the computational mode and what
/// is left of the start is 1 + θ²/4, whatever n, so that no longer cycle is looked at.
fn largest_angle(steps: usize, robert_filter: f64) -> f64 {
    const MOST_STEPS: usize = 1000;
    const PARTS_OF_PERIOD: f64 = 16.0;
    let steps = steps.min(MOST_STEPS);
    let is_stable = |theta: f64| amplification(steps, robert_filter, theta) <= 1.0 + LARGEST_GROWTH;
    let limit = ((1.0 - robert_filter) / (1.0 + robert_filter)).sqrt();
    let spacing = std::f64::consts::PI / (PARTS_OF_PERIOD * steps as f64);
    let count = (limit / spacing).ceil() as usize;
    let angle = |number: usize| (number as f64 * spacing).min(limit);
    let Some(unstable) = (1..=count).map(angle).find(|&theta| !is_stable(theta)) else { return limit };
    let (mut stable, mut unstable) = (unstable - spacing, unstable);
    for _ in 0..40 {
        let middle = 0.5 * (stable + unstable);
        if is_stable(middle) {
            stable = middle;
        } else {
            unstable = middle;
        }
    }
    stable.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed form without the filter, and the value that four steps at 45 % of the limit have.
    #[test]
    fn amplification_of_a_cycle_is_that_of_its_two_modes() {
        for (steps, theta) in [(4, 0.448_f64), (10, 0.2), (72, 0.9)] {
            let growth = theta.powi(2) / (1.0 - theta.powi(2)) * (steps as f64 * theta.asin()).sin().powi(2);
            assert!((amplification(steps, 0.0, theta).powi(2) / (1.0 + growth) - 1.0).abs() < 1e-11);
        }
        assert!((amplification(4, 0.01, 0.448) - 1.1026).abs() < 1e-4);
        assert!((amplification(1, 0.3, 0.2) - 1.04_f64.sqrt()).abs() < 1e-15);
    }

    /// Up to the largest angle no wave grows, just above it one does, and n α > 1 leaves nearly all of the leapfrog's range.
    #[test]
    fn the_largest_angle_is_that_of_all_waves_below_it() {
        for (steps, filter) in [(1, 0.01), (4, 0.01), (7, 0.1), (24, 0.05), (72, 0.01), (200, 0.001)] {
            let largest = largest_angle(steps, filter);
            let worst = (1..=20_000).map(|i| amplification(steps, filter, largest * f64::from(i) / 20_000.0));
            let worst = worst.fold(0.0, f64::max);
            assert!(worst <= 1.0 + 1.01 * LARGEST_GROWTH, "{steps} steps, α = {filter}: {worst} below {largest}");
            assert!(
                amplification(steps, filter, 1.001 * largest) > 1.0 + LARGEST_GROWTH,
                "{steps} steps, α = {filter}"
            );
        }
        assert!(largest_angle(4, 0.01) < 0.11 && largest_angle(24, 0.05) > 0.89 && largest_angle(5000, 0.01) > 0.98);
    }
}
