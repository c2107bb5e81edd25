//! Leapfrog with the Robert–Asselin filter: a two-level scheme, so a model whose state holds two time levels.
//!
//! ```text
//! x(t + Δt) = x̄(t − Δt) + 2 Δt f(x(t))                             leapfrog
//! x̄(t)      = x(t) + α [x(t + Δt) − 2 x(t) + x̄(t − Δt)]            filter (Robert 1966; Asselin 1972, MWR 100)
//! ```
//!
//! The state of the model is (x(t), x̄(t − Δt)): its layout has the variables of the tendency twice, the present level
//! first, so that a variable is found there by its name, and everything that works on states and increments (the loops
//! of [`crate::forecast`], covariance factors, the contract battery) works on the pair without knowing of it.
//!
//! A run begins with [`Leapfrog::start`], (x, x − Δt f(x)): the first leapfrog step from there,
//! x − Δt f + 2 Δt f = x + Δt f, is the forward Euler step, and the filter changes nothing in it. So there is no first
//! step to remember; the start has a tangent-linear and an adjoint of its own.
//!
//! On ẋ = λx the amplification factors are those of the matrix \[\[2λΔt, 1\], \[1 − 2α + 2αλΔt, 2α\]\]:
//! α + λΔt ± √((1 − α)² + (λΔt)²). For λΔt = iθ they are at most 1 in size up to θ = √((1 − α)/(1 + α)), for λΔt = −σ up
//! to σ = 2α/(1 + α): without the filter any damping makes the computational mode grow.

use super::adjoint_sweep::sweep_ad;
use super::side_by_side::{best_together, sweep_states};
use super::tangent_sweep::sweep_tl;
use super::tendency::Tendency;
use super::update::{Leap, Scheme};
use crate::columns::Columns;
use crate::error::{ModelError, require};
use crate::forecast::{Adjoint, Between, Model, TangentLinear, require_finite_state, step_by_step, step_by_step_ad};
use crate::state::{Layout, State};
use crate::stored::{ColumnsMut, Stored};
use crate::time::Duration;
use crate::vector;
use std::ops::Range;
use std::sync::Arc;

/// A tendency integrated by leapfrog; its states hold two time levels.
#[derive(Clone, Debug)]
pub struct Leapfrog<T> {
    tendency: T,
    layout: Arc<Layout>,
    time_step: Duration,
    robert_filter: f64,
}

impl<T: Tendency> Leapfrog<T> {
    /// A model of this tendency with the filter's α, 0 ≤ α < 1 (customary: 0.001 to 0.1).
    ///
    /// # Errors
    /// If the time step is not positive or α out of its range.
    pub fn new(tendency: T, time_step: Duration, robert_filter: f64) -> Result<Self, ModelError> {
        crate::error::require_positive("time_step_s", time_step.as_f64())?;
        let range = (0.0..1.0).contains(&robert_filter);
        require(range, "robert_filter", robert_filter, "at least 0 and less than 1")?;
        let one = tendency.layout();
        let variables = one.variables.iter().chain(&one.variables).cloned().collect();
        let layout = Arc::new(Layout { grid: one.grid.clone(), variables });
        Ok(Self { tendency, layout, time_step, robert_filter })
    }

    /// The same on some rows, as [`Tendency::in_rows`].
    pub(super) fn in_rows(&self, rows: &Range<isize>) -> Option<Self> {
        Self::new(self.tendency.in_rows(rows)?, self.time_step, self.robert_filter).ok()
    }

    /// The right-hand side.
    pub fn tendency(&self) -> &T {
        &self.tendency
    }

    /// The filter's α.
    pub fn robert_filter(&self) -> f64 {
        self.robert_filter
    }

    /// The two-level state (x, x − Δt f(x)) from which the first step is Euler's.
    ///
    /// # Panics
    /// If the state is not of the tendency's layout.
    pub fn start(&self, x: &State) -> State {
        let mut now = x.values().to_vec();
        self.tendency.constrain(&mut now);
        let mut slope = vec![0.0; now.len()];
        self.tendency.tendency(&now, &mut slope, &mut vec![0.0; self.tendency.scratch_len()]);
        let dt = self.time_step.as_f64();
        let before: Vec<f64> = now.iter().zip(&slope).map(|(x, slope)| x - dt * slope).collect();
        State::from_values(&self.layout, [now, before].concat()).valid_at(x.time())
    }

    /// The present level of a two-level state.
    pub fn present(&self, x: &State) -> State {
        State::from_values(self.tendency.layout(), x.values()[..self.half()].to_vec()).valid_at(x.time())
    }

    /// Tangent-linear of [`Leapfrog::start`]: columns of one level to columns of two.
    pub fn start_tl<N: Stored>(&self, at: &State, columns: &[N]) -> Vec<N> {
        let linearisation = self.linearise(at.values());
        let dt = self.time_step.as_f64();
        let mut result = Vec::with_capacity(2 * columns.len());
        let (mut slope, mut scratch) = (vec![0.0; self.half()], vec![0.0; self.tendency.scratch_len()]);
        for column in columns.chunks_exact(self.half()) {
            let mut now: Vec<f64> = column.iter().map(|value| value.widen()).collect();
            self.tendency.constrain(&mut now);
            self.tendency.tendency_tl(&linearisation, &now, &mut slope, &mut scratch);
            result.extend(now.iter().map(|&now| N::narrow(now)));
            result.extend(now.iter().zip(&slope).map(|(now, slope)| N::narrow(now - dt * slope)));
        }
        result
    }

    /// Adjoint of [`Leapfrog::start_tl`]: columns of two levels to columns of one.
    pub fn start_ad(&self, at: &State, columns: &[f64]) -> Vec<f64> {
        let linearisation = self.linearise(at.values());
        let dt = self.time_step.as_f64();
        let mut result = Vec::with_capacity(columns.len() / 2);
        let mut scratch = vec![0.0; self.tendency.scratch_len()];
        for column in columns.chunks_exact(2 * self.half()) {
            let (now, before) = column.split_at(self.half());
            let mut sum: Vec<f64> = now.iter().zip(before).map(|(now, before)| now + before).collect();
            let slope: Vec<f64> = before.iter().map(|before| -dt * before).collect();
            self.tendency.tendency_ad(&linearisation, &slope, &mut sum, &mut scratch);
            self.tendency.constrain(&mut sum);
            result.extend_from_slice(&sum);
        }
        result
    }

    /// Number of values of one level.
    fn half(&self) -> usize {
        self.tendency.layout().len()
    }

    fn linearise(&self, at: &[f64]) -> T::Linearisation {
        let mut now = at[..self.half()].to_vec();
        self.tendency.constrain(&mut now);
        self.tendency.linearise(&now)
    }

    fn leap(&self) -> Leap {
        Leap { dt: self.time_step.as_f64(), alpha: self.robert_filter }
    }

    /// Advances increments in sweeps over the rows; returns false, with nothing done, if the tendency has no row form.
    fn sweep_columns(&self, at: &State, columns: &mut ColumnsMut<'_>, steps: usize, between: Between<'_>) -> bool {
        sweep_tl(&self.tendency, Scheme::Leapfrog(self.leap()), at.values(), columns, steps, between)
    }

    /// Takes increments back in sweeps over the rows; returns false, with nothing done, if the tendency has no row form.
    fn sweep_columns_ad(&self, states: &[State], columns: &mut [f64]) -> bool {
        sweep_ad(&self.tendency, Scheme::Leapfrog(self.leap()), states, columns)
    }

    fn columns<'a>(&self, columns: &'a mut [f64]) -> Columns<'a, f64> {
        Columns::new(columns, self.layout.len())
    }

    fn constrain(&self, x: &mut [f64]) {
        let (now, before) = x.split_at_mut(self.half());
        self.tendency.constrain(now);
        self.tendency.constrain(before);
    }
}

impl<T: Tendency> Model for Leapfrog<T> {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn time_step(&self) -> Duration {
        self.time_step
    }

    /// `x` may be one level or two.
    fn largest_time_step_s(&self, x: &State) -> f64 {
        let bounds = self.tendency.spectral_bounds(&x.values()[..self.half()]);
        let alpha = self.robert_filter;
        let (imaginary, real) = (((1.0 - alpha) / (1.0 + alpha)).sqrt(), 2.0 * alpha / (1.0 + alpha));
        let damping = if bounds.damping_per_s > 0.0 { bounds.damping_per_s / real } else { 0.0 };
        1.0 / (bounds.oscillation_per_s / imaginary + damping)
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        require_finite_state(x)?;
        let (now, before) = x.values().split_at(self.half());
        self.tendency.check(now)?;
        self.tendency.check(before)
    }

    fn step(&self, x: &mut State) {
        self.steps(std::slice::from_mut(x), 1);
    }

    fn best_together(&self) -> usize {
        best_together(&self.tendency)
    }

    fn steps(&self, states: &mut [State], steps: usize) {
        for x in &mut *states {
            assert_eq!(x.values().len(), self.layout.len(), "the state is not of this model's layout");
            x.advance(self.time_step * steps);
        }
        if sweep_states(&self.tendency, Scheme::Leapfrog(self.leap()), states, steps) {
            return;
        }
        let (mut slope, mut scratch) = (vec![0.0; self.half()], vec![0.0; self.tendency.scratch_len()]);
        for x in states {
            for _ in 0..steps {
                self.constrain(x.values_mut());
                let (now, before) = x.values_mut().split_at_mut(self.half());
                self.tendency.tendency(now, &mut slope, &mut scratch);
                self.leap().advance(now, before, &slope);
            }
        }
    }
}

impl<T: Tendency> TangentLinear for Leapfrog<T> {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        if self.sweep_columns(at, &mut ColumnsMut::Double(columns), 1, &|_, _| ()) {
            return;
        }
        let linearisation = self.linearise(at.values());
        self.columns(columns).for_each(
            || (vec![0.0; self.half()], vec![0.0; self.tendency.scratch_len()]),
            #[inline(always)]
            |column, (slope, scratch)| {
                self.constrain(column);
                let (now, before) = column.split_at_mut(self.half());
                self.tendency.tendency_tl(&linearisation, now, slope, scratch);
                self.leap().advance(now, before, slope);
            },
        );
    }

    fn steps_tl_between(&self, at: &State, mut columns: ColumnsMut<'_>, steps: usize, between: Between<'_>) {
        if !self.sweep_columns(at, &mut columns, steps, between) {
            step_by_step(self, at, columns, steps, between);
        }
    }
}

impl<T: Tendency> Adjoint for Leapfrog<T> {
    /// With n* and f* for the gradients with respect to the new and the filtered level:
    /// n* += α f*, now* = (1 − 2α) f* + f'ᵀ 2Δt n*, before* = n* + α f*.
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        if self.sweep_columns_ad(std::slice::from_ref(at), columns) {
            return;
        }
        let linearisation = self.linearise(at.values());
        let (two_dt, alpha) = (2.0 * self.time_step.as_f64(), self.robert_filter);
        self.columns(columns).for_each(
            || (vec![0.0; self.half()], vec![0.0; self.half()], vec![0.0; self.tendency.scratch_len()]),
            #[inline(always)]
            |column, (slope, gradient, scratch)| {
                let (now, before) = column.split_at_mut(self.half());
                for i in 0..now.len() {
                    let (new, filtered) = (now[i] + alpha * before[i], before[i]);
                    slope[i] = two_dt * new;
                    now[i] = (1.0 - 2.0 * alpha) * filtered;
                    before[i] = new + alpha * filtered;
                }
                gradient.fill(0.0);
                self.tendency.tendency_ad(&linearisation, slope, gradient, scratch);
                vector::add(now, gradient);
                self.constrain(column);
            },
        );
    }

    fn steps_ad(&self, states: &[State], columns: &mut [f64]) {
        if !self.sweep_columns_ad(states, columns) {
            step_by_step_ad(self, states, columns);
        }
    }
}

#[cfg(test)]
mod tests {
    /// The larger amplification factor for λΔt = −σ + iθ, from the characteristic polynomial.
    fn amplification(alpha: f64, damping: f64, oscillation: f64) -> f64 {
        // w² = (1 − α)² + z², z = −σ + iθ; λ = α + z ± w.
        let (re, im) = ((1.0 - alpha).powi(2) + damping.powi(2) - oscillation.powi(2), -2.0 * damping * oscillation);
        let size = re.hypot(im).sqrt();
        let angle = 0.5 * im.atan2(re);
        let (w_re, w_im) = (size * angle.cos(), size * angle.sin());
        let plus = (alpha - damping + w_re).hypot(oscillation + w_im);
        plus.max((alpha - damping - w_re).hypot(oscillation - w_im))
    }

    #[test]
    fn the_triangle_lies_in_the_stability_region_and_touches_it_at_its_corners() {
        for alpha in [0.001, 0.05, 0.2] {
            let (imaginary, real) = (f64::sqrt((1.0 - alpha) / (1.0 + alpha)), 2.0 * alpha / (1.0 + alpha));
            for step in 0..=1000 {
                let part = f64::from(step) / 1000.0;
                for size in [0.1, 0.5, 0.9, 1.0] {
                    let factor = amplification(alpha, real * part * size, imaginary * (1.0 - part) * size);
                    assert!(factor <= 1.0 + 1e-9, "{alpha} {part} {size}: {factor}");
                }
            }
            assert!(amplification(alpha, 0.0, imaginary + 1e-4) > 1.0);
            assert!(amplification(alpha, real + 1e-4, 0.0) > 1.0);
        }
    }
}
