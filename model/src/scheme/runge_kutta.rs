//! Runge–Kutta schemes: a [`Tendency`] dx/dt = f(x) and a [`TimeScheme`] make a [`Stepped`] model with its exact
//! tangent-linear and adjoint.
//!
//! An explicit Runge–Kutta scheme with coefficients a, b (Butcher 1963) is
//!
//! ```text
//! x_s = x + Δt Σ_{r<s} a_sr k_r,   k_s = f(x_s),   x(t + Δt) = x + Δt Σ b_s k_s;
//! ```
//!
//! its derivative, with F_s = f'(x_s), is the same scheme applied to the increment,
//!
//! ```text
//! δk_s = F_s (δx + Δt Σ_{r<s} a_sr δk_r),   δx(t + Δt) = δx + Δt Σ b_s δk_s,
//! ```
//!
//! and its transpose runs the stages backwards,
//!
//! ```text
//! k*_s = Δt b_s y* + Δt Σ_{r>s} a_rs g_r,   g_s = F_sᵀ k*_s,   x* = y* + Σ g_s.
//! ```

use super::adjoint_sweep::sweep_ad;
use super::side_by_side::{best_together, sweep_states};
use super::tangent_sweep::{sweep_tl, sweep_tl_exchanging};
use super::tendency::{SpectralBounds, Tendency};
use super::update::Scheme;
use crate::columns::Columns;
use crate::error::ModelError;
use crate::forecast::{
    Adjoint, Between, Exchange, Model, TangentLinear, require_finite_state, step_by_step, step_by_step_ad,
    step_by_step_exchanging,
};
use crate::state::{Layout, State};
use crate::stored::ColumnsMut;
use crate::time::Duration;
use crate::vector;
use std::ops::Range;
use std::sync::Arc;

/// How a tendency is integrated in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeScheme {
    /// The classical Runge–Kutta scheme of fourth order (Kutta 1901).
    Rk4,
    /// The strong-stability-preserving Runge–Kutta scheme of third order (Shu & Osher 1988).
    SspRk3,
}

/// A model: a tendency, a time scheme and a time step.
#[derive(Clone, Debug, PartialEq)]
pub struct Stepped<T> {
    tendency: T,
    time_step: Duration,
    scheme: TimeScheme,
}

/// Fails if the model's time step is beyond the stability limit at `x`.
///
/// # Errors
/// [`ModelError::TimeStepTooLong`] with the largest stable time step.
pub fn check_time_step(model: &dyn Model, x: &State) -> Result<(), ModelError> {
    let largest_s = model.largest_time_step_s(x);
    let time_step_s = model.time_step().seconds() / model.substeps() as i64;
    if time_step_s as f64 <= largest_s { Ok(()) } else { Err(ModelError::TimeStepTooLong { time_step_s, largest_s }) }
}

impl TimeScheme {
    /// Order of accuracy.
    pub fn order(self) -> u32 {
        match self {
            TimeScheme::Rk4 => 4,
            TimeScheme::SspRk3 => 3,
        }
    }

    /// The largest Δt \[s\] for which Δt λ is in the stability region for all λ within the bounds; infinite if there
    /// is neither oscillation nor damping.
    ///
    /// The region is replaced by the triangle between its ends on the two axes (2√2 i and −2.785 for fourth order,
    /// √3 i and −2.512 for third), which lies inside of it: ω Δt / ω_max + σ Δt / σ_max ≤ 1.
    pub fn largest_time_step_s(self, bounds: SpectralBounds) -> f64 {
        let (imaginary, real) = self.stability_limits();
        1.0 / (bounds.oscillation_per_s / imaginary + bounds.damping_per_s / real)
    }

    /// Ends of the stability region on the imaginary and the negative real axis, rounded down.
    fn stability_limits(self) -> (f64, f64) {
        match self {
            TimeScheme::Rk4 => (2.828_427, 2.785_293),
            TimeScheme::SspRk3 => (1.732_050, 2.512_745),
        }
    }

    /// Rows of a (below the diagonal), and b.
    fn coefficients(self) -> (&'static [&'static [f64]], &'static [f64]) {
        match self {
            TimeScheme::Rk4 => {
                (&[&[], &[0.5], &[0.0, 0.5], &[0.0, 0.0, 1.0]], &[1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0])
            }
            TimeScheme::SspRk3 => (&[&[], &[1.0], &[0.25, 0.25]], &[1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0]),
        }
    }
}

impl<T: Tendency> Stepped<T> {
    /// A model of this tendency.
    ///
    /// # Errors
    /// If the time step is not positive. Whether it is stable depends on the state: [`check_time_step`].
    pub fn new(tendency: T, time_step: Duration, scheme: TimeScheme) -> Result<Self, ModelError> {
        crate::error::require_positive("time_step_s", time_step.as_f64())?;
        Ok(Self { tendency, time_step, scheme })
    }

    /// The right-hand side.
    pub fn tendency(&self) -> &T {
        &self.tendency
    }

    /// The time scheme.
    pub fn scheme(&self) -> TimeScheme {
        self.scheme
    }

    /// One step of the scheme from `x`, with `evaluate(stage, stage state, k, scratch)` for the tendency.
    #[inline(always)]
    fn advance(&self, x: &mut [f64], work: &mut Work, mut evaluate: impl FnMut(usize, &[f64], &mut [f64], &mut [f64])) {
        let (a, b) = self.scheme.coefficients();
        let dt = self.time_step.as_f64();
        self.tendency.constrain(x);
        for (stage, row) in a.iter().enumerate() {
            let (done, rest) = work.slopes.split_at_mut(stage);
            work.stage.copy_from_slice(x);
            for (&weight, k) in row.iter().zip(done) {
                add_scaled(&mut work.stage, dt * weight, k);
            }
            evaluate(stage, &work.stage, &mut rest[0], &mut work.scratch);
        }
        for (&weight, k) in b.iter().zip(&work.slopes) {
            add_scaled(x, dt * weight, k);
        }
    }

    /// The tendency linearised at each stage of the step from `at`.
    fn linearise_stages(&self, at: &State) -> Vec<T::Linearisation> {
        self.check_layout(at);
        let mut x = at.values().to_vec();
        let mut linearisations = Vec::with_capacity(4);
        self.advance(&mut x, &mut self.work(), |_, x, k, scratch| {
            linearisations.push(self.tendency.linearise(x));
            self.tendency.tendency(x, k, scratch);
        });
        linearisations
    }

    /// The scheme's numbers, with the time step.
    fn numbers(&self) -> Scheme<'static> {
        let (a, b) = self.scheme.coefficients();
        Scheme::RungeKutta { a, b, dt: self.time_step.as_f64() }
    }

    /// Advances increments in sweeps over the rows; returns false, with nothing done, if the tendency has no row form.
    fn sweep_columns(&self, at: &State, columns: &mut ColumnsMut<'_>, steps: usize, between: Between<'_>) -> bool {
        self.check_layout(at);
        sweep_tl(&self.tendency, self.numbers(), at.values(), columns, steps, between)
    }

    /// Takes increments back in sweeps over the rows; returns false, with nothing done, if the tendency has no row form.
    fn sweep_columns_ad(&self, states: &[State], columns: &mut [f64]) -> bool {
        states.iter().for_each(|at| self.check_layout(at));
        sweep_ad(&self.tendency, self.numbers(), states, columns)
    }

    fn work(&self) -> Work {
        let len = self.layout().len();
        let stages = self.scheme.coefficients().1.len();
        Work {
            stage: vec![0.0; len],
            slopes: vec![vec![0.0; len]; stages],
            scratch: vec![0.0; self.tendency.scratch_len()],
        }
    }

    fn check_layout(&self, x: &State) {
        assert_eq!(x.values().len(), self.layout().len(), "the state is not of this model's layout");
    }
}

impl<T: Tendency> Model for Stepped<T> {
    fn layout(&self) -> &Arc<Layout> {
        self.tendency.layout()
    }

    fn time_step(&self) -> Duration {
        self.time_step
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.scheme.largest_time_step_s(self.tendency.spectral_bounds(x.values()))
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Arc<dyn Adjoint>> {
        Some(Arc::new(Self { tendency: self.tendency.in_rows(rows)?, ..*self }))
    }

    /// Each stage reaches as far as f; the flow through a wall, which is zero, belongs to the row beside it.
    fn reach(&self) -> usize {
        self.tendency.reach() * self.scheme.coefficients().1.len() + 1
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        require_finite_state(x)?;
        self.tendency.check(x.values())
    }

    fn step(&self, x: &mut State) {
        self.steps(std::slice::from_mut(x), 1);
    }

    fn best_together(&self) -> usize {
        best_together(&self.tendency)
    }

    fn steps(&self, states: &mut [State], steps: usize) {
        for x in &mut *states {
            self.check_layout(x);
            x.advance(self.time_step * steps);
        }
        if sweep_states(&self.tendency, self.numbers(), states, steps) {
            return;
        }
        for x in states {
            Columns::new(x.values_mut(), self.layout().len()).for_each(
                || self.work(),
                #[inline(always)]
                |x, work| {
                    for _ in 0..steps {
                        self.advance(
                            x,
                            work,
                            #[inline(always)]
                            |_, x, k, scratch| self.tendency.tendency(x, k, scratch),
                        );
                    }
                },
            );
        }
    }
}

impl<T: Tendency> TangentLinear for Stepped<T> {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        if self.sweep_columns(at, &mut ColumnsMut::Double(columns), 1, &|_, _| ()) {
            return;
        }
        let linearisations = self.linearise_stages(at);
        Columns::new(columns, self.layout().len()).for_each(
            || self.work(),
            #[inline(always)]
            |column, work| {
                self.advance(
                    column,
                    work,
                    #[inline(always)]
                    |stage, dx, k, scratch| {
                        self.tendency.tendency_tl(&linearisations[stage], dx, k, scratch);
                    },
                );
            },
        );
    }

    fn steps_tl_between(&self, at: &State, mut columns: ColumnsMut<'_>, steps: usize, between: Between<'_>) {
        if !self.sweep_columns(at, &mut columns, steps, between) {
            step_by_step(self, at, columns, steps, between);
        }
    }

    fn steps_tl_exchanging(&self, at: &mut State, mut columns: ColumnsMut<'_>, steps: usize, exchange: Exchange<'_>) {
        let with_step = (&mut *at, |x: &mut State| self.step(x));
        if !sweep_tl_exchanging(&self.tendency, self.numbers(), with_step, &mut columns, steps, &mut *exchange) {
            step_by_step_exchanging(self, at, columns, steps, exchange);
        }
    }
}

impl<T: Tendency> Adjoint for Stepped<T> {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        if self.sweep_columns_ad(std::slice::from_ref(at), columns) {
            return;
        }
        let linearisations = self.linearise_stages(at);
        let (a, b) = self.scheme.coefficients();
        let dt = self.time_step.as_f64();
        Columns::new(columns, self.layout().len()).for_each(
            || self.work(),
            #[inline(always)]
            |column, work| {
                let Work { stage: gradient, slopes, scratch } = work;
                for (&weight, k) in b.iter().zip(slopes.iter_mut()) {
                    k.iter_mut().zip(column.iter()).for_each(|(k, y)| *k = dt * weight * y);
                }
                for (stage, row) in a.iter().enumerate().rev() {
                    gradient.fill(0.0);
                    self.tendency.tendency_ad(&linearisations[stage], &slopes[stage], gradient, scratch);
                    vector::add(column, gradient);
                    for (&weight, k) in row.iter().zip(slopes.iter_mut()) {
                        add_scaled(k, dt * weight, gradient);
                    }
                }
                self.tendency.constrain(column);
            },
        );
    }

    fn steps_ad(&self, states: &[State], columns: &mut [f64]) {
        if !self.sweep_columns_ad(states, columns) {
            step_by_step_ad(self, states, columns);
        }
    }
}

/// y += factor x; nothing for a factor of zero, as many coefficients of a scheme are zero.
#[inline(always)]
fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    if factor != 0.0 {
        vector::axpy(factor, x, y);
    }
}

/// Scratch space of one worker: stage increment, the slopes k of all stages, and that of the tendency.
struct Work {
    stage: Vec<f64>,
    slopes: Vec<Vec<f64>>,
    scratch: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// |1 + z + z²/2 + … + zⁿ/n!|: both schemes have the exponential's Taylor polynomial for amplification factor.
    fn amplification(scheme: TimeScheme, re: f64, im: f64) -> f64 {
        let (mut sum, mut term) = ((1.0, 0.0), (1.0, 0.0));
        for power in 1..=scheme.order() {
            let n = f64::from(power);
            term = ((term.0 * re - term.1 * im) / n, (term.0 * im + term.1 * re) / n);
            sum = (sum.0 + term.0, sum.1 + term.1);
        }
        sum.0.hypot(sum.1)
    }

    #[test]
    fn the_triangle_lies_in_the_stability_region_and_touches_it_at_its_corners() {
        for scheme in [TimeScheme::Rk4, TimeScheme::SspRk3] {
            for step in 0..=1000 {
                let part = f64::from(step) / 1000.0;
                let (imaginary, real) = scheme.stability_limits();
                for size in [0.1, 0.5, 0.9, 1.0] {
                    let factor = amplification(scheme, -real * part * size, imaginary * (1.0 - part) * size);
                    assert!(factor <= 1.0 + 1e-12, "{scheme:?} {part} {size}: {factor}");
                }
            }
            let (imaginary, real) = scheme.stability_limits();
            assert!(amplification(scheme, 0.0, imaginary + 1e-5) > 1.0);
            assert!(amplification(scheme, -real - 1e-5, 0.0) > 1.0);
        }
    }
}
