//! The model with state-transition corrections, and the columns of M(s).
//!
//! With S_θ a time step of the model, ρ̄_c the mean of ρ_c over the domain, θ̄ the parameters corrected by these means, and ∘
//! the product place by place, a step of the corrected model is
//!
//! ```text
//! x_{n+1} = S_θ̄(x_n) + Σ_c (ρ_c − ρ̄_c) ∘ D_c(x_n),     D_c = ∂S_θ/∂θ_c at θ̄
//! ```
//!
//! and with L_n the derivative of that step by x_n, the column of M over a cycle is what the step's derivative by r_ck,
//! added in every step, has become at the end:
//!
//! ```text
//! z_0 = 0,     z_{n+1} = L_n z_n + w_ck ∘ D_c(x_n)
//! ```
//!
//! This is the model S_θ̄ itself where each ρ_c is the same everywhere, whatever patterns make it up, and linear in what is
//! not: of the step's derivative by r_ck a part of second order, w̄_ck (ρ − ρ̄) ∘ ∂D/∂θ, is left out. D_c is a central
//! difference, of second order in its step and so exact for what is linear in a parameter; one-sided where the model on one
//! side does not exist. All columns are one batch of the tangent-linear model, and D_c is two steps of the model, however
//! many patterns its candidate has.

use super::correction::{Candidate, Correction, Corrections};
use crate::error::Error;
use crate::tall_matrix::TallMatrix;
use isobar_model::{Duration, Layout, Model, ModelError, State, TangentLinear, forecast};
use rayon::prelude::*;
use std::sync::Arc;

/// The model with corrections.
pub(super) struct CorrectedModel {
    /// That with the means of the corrections, S_θ̄.
    mean: Arc<dyn TangentLinear>,
    derivatives: Vec<Derivative>,
}

/// D_c, and what multiplies it.
struct Derivative {
    above: Arc<dyn TangentLinear>,
    below: Arc<dyn TangentLinear>,
    /// Of the parameter between the two.
    width: f64,
    /// ρ_c − ρ̄_c, `[y, x]`; `None` where it is zero everywhere.
    deviation: Option<Vec<f64>>,
}

/// The number of increments of which two copies are made at a time.
const GROUP: usize = 64;

/// A deviation from the mean below this share of the largest correction is rounding.
const ROUNDING: f64 = 1e-12;

impl CorrectedModel {
    /// The model with these amplitudes r of the candidates of a family, whose patterns may have moved.
    ///
    /// # Errors
    /// If there is no model with the means of the corrections, or with what they are where they are largest or least.
    pub fn new(family: &dyn Corrections, candidates: &[Candidate], r: &[f64]) -> Result<Self, Error> {
        let (mut means, mut fields) = (Vec::new(), Vec::new());
        let mut rest = r;
        for candidate in candidates {
            let (own, others) = rest.split_at(candidate.amplitudes());
            rest = others;
            let field = field(candidate, own);
            means.push(field.as_ref().map_or(own[0], |field| mean(field)));
            fields.push(field);
        }
        let with = |candidate: usize, change: f64| {
            let mut moved = means.clone();
            moved[candidate] += change;
            family.model(&moved)
        };
        let mean = family.model(&means)?;
        let mut derivatives = Vec::new();
        for (number, (candidate, field)) in candidates.iter().zip(fields).enumerate() {
            let step = candidate.step;
            let (above, below, width) = match (with(number, step), with(number, -step)) {
                (Ok(above), Ok(below)) => (above, below, 2.0 * step),
                (Ok(above), Err(_)) => (above, Arc::clone(&mean), step),
                (Err(_), Ok(below)) => (Arc::clone(&mean), below, step),
                (Err(error), Err(_)) => return Err(error),
            };
            let deviation = field.and_then(|field| deviation(field, means[number]));
            for extreme in deviation.iter().flat_map(|it| extremes(it)) {
                with(number, extreme)?;
            }
            derivatives.push(Derivative { above, below, width, deviation });
        }
        Ok(Self { mean, derivatives })
    }

    /// The model; that with the means itself where the corrections are the same everywhere.
    pub fn model(self: &Arc<Self>) -> Arc<dyn TangentLinear> {
        if self.derivatives.iter().all(|it| it.deviation.is_none()) {
            return Arc::clone(&self.mean);
        }
        Arc::<Self>::clone(self)
    }

    /// M(s) over a cycle: derivatives of the forecast from `state` by each amplitude, `[m, amplitudes]`; as far as that
    /// forecast is finite.
    ///
    /// # Errors
    /// If a column is not finite where the forecast is.
    pub fn columns(
        self: &Arc<Self>,
        candidates: &[Candidate],
        amplitudes: &[Correction],
        state: &State,
        steps: usize,
    ) -> Result<TallMatrix, Error> {
        let (model, m) = (self.model(), state.values().len());
        let mut columns = vec![0.0; m * amplitudes.len()];
        let mut at = state.clone();
        for step in 0..steps {
            if step > 0 {
                model.step_tl(&at, &mut columns);
            }
            let derivatives: Vec<Vec<f64>> = self.derivatives.par_iter().map(|it| it.at(&at)).collect();
            columns.par_chunks_exact_mut(m).zip(amplitudes).for_each(|(column, amplitude)| {
                let derivative = &derivatives[amplitude.candidate];
                let pattern = amplitude.pattern.map(|k| &candidates[amplitude.candidate].patterns[k].weights);
                match pattern {
                    None => column.iter_mut().zip(derivative).for_each(|(own, change)| *own += change),
                    Some(weights) => add_product(1.0, weights, derivative, column),
                }
            });
            self.mean.step(&mut at);
            for (own, change) in self.derivatives.iter().zip(&derivatives) {
                own.add_deviation(change, &mut at);
            }
            if at.first_non_finite().is_some() {
                columns.fill(0.0);
                break;
            }
        }
        forecast::require_finite_increments(model.layout(), &columns, steps)?;
        Ok(TallMatrix::from_values(m, amplitudes.len(), columns))
    }
}

impl Derivative {
    /// D_c(x).
    fn at(&self, x: &State) -> Vec<f64> {
        let (mut above, mut below) = (x.clone(), x.clone());
        self.above.step(&mut above);
        self.below.step(&mut below);
        above.values().iter().zip(below.values()).map(|(above, below)| (above - below) / self.width).collect()
    }

    /// x += (ρ_c − ρ̄_c) ∘ D_c, with D_c at the state before the step.
    fn add_deviation(&self, change: &[f64], x: &mut State) {
        if let Some(deviation) = &self.deviation {
            add_product(1.0, deviation, change, x.values_mut());
        }
    }
}

impl Model for CorrectedModel {
    fn layout(&self) -> &Arc<Layout> {
        self.mean.layout()
    }

    fn time_step(&self) -> Duration {
        self.mean.time_step()
    }

    fn substeps(&self) -> usize {
        self.mean.substeps()
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.mean.largest_time_step_s(x)
    }

    fn needs_time(&self) -> bool {
        self.mean.needs_time()
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        self.mean.check_state(x)
    }

    fn step(&self, x: &mut State) {
        let from = x.clone();
        self.mean.step(x);
        for derivative in self.derivatives.iter().filter(|it| it.deviation.is_some()) {
            derivative.add_deviation(&derivative.at(&from), x);
        }
    }
}

impl TangentLinear for CorrectedModel {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        let m = at.values().len();
        let (mut from, mut side) = (Vec::new(), Vec::new());
        for group in columns.chunks_mut(GROUP * m) {
            from.clear();
            from.extend_from_slice(group);
            self.mean.step_tl(at, group);
            for Derivative { above, below, width, deviation } in &self.derivatives {
                let Some(deviation) = deviation else { continue };
                for (model, sign) in [(above, 1.0), (below, -1.0)] {
                    side.clear();
                    side.extend_from_slice(&from);
                    model.step_tl(at, &mut side);
                    let columns = group.par_chunks_exact_mut(m).zip(side.par_chunks_exact(m));
                    columns.for_each(|(column, side)| add_product(sign / width, deviation, side, column));
                }
            }
        }
    }
}

/// out += a w ∘ x, with w the same for all variables.
fn add_product(a: f64, weights: &[f64], x: &[f64], out: &mut [f64]) {
    for (out, x) in out.chunks_exact_mut(weights.len()).zip(x.chunks_exact(weights.len())) {
        for ((out, x), weight) in out.iter_mut().zip(x).zip(weights) {
            *out += a * weight * x;
        }
    }
}

/// ρ_c, `[y, x]`; `None` if it has no patterns.
fn field(candidate: &Candidate, r: &[f64]) -> Option<Vec<f64>> {
    let mut field = vec![0.0; candidate.patterns.first()?.weights.len()];
    for (pattern, r) in candidate.patterns.iter().zip(r) {
        field.iter_mut().zip(&pattern.weights).for_each(|(value, weight)| *value += r * weight);
    }
    Some(field)
}

/// What a field is beside its mean; `None` if that is nothing.
fn deviation(field: Vec<f64>, mean: f64) -> Option<Vec<f64>> {
    let largest = field.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let deviation: Vec<f64> = field.into_iter().map(|value| value - mean).collect();
    deviation.iter().any(|value| value.abs() > ROUNDING * largest).then_some(deviation)
}

fn mean(field: &[f64]) -> f64 {
    field.iter().sum::<f64>() / field.len() as f64
}

fn extremes(field: &[f64]) -> [f64; 2] {
    field.iter().fold([0.0; 2], |[least, most], &value| [value.min(least), value.max(most)])
}

#[cfg(test)]
mod tests;
