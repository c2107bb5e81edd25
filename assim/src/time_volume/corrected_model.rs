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
//! not: of the step's derivative by r_ck a part of second order, w̄_ck (ρ − ρ̄) ∘ ∂D/∂θ, is left out. D_c is a central difference, of second order in its step and so exact for what is linear in a parameter;
//! one-sided where the model on one side does not exist. All columns are one batch of the tangent-linear model, and D_c is
//! two steps of the model, however many patterns its candidate has.

use super::transition::{Candidate, Correction, Corrections};
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
    /// The model with these amplitudes r.
    ///
    /// # Errors
    /// If there is no model with the means of the corrections, or with what they are where they are largest or least.
    pub fn new(family: &dyn Corrections, r: &[f64]) -> Result<Self, Error> {
        let candidates = family.candidates();
        let (mut means, mut fields) = (Vec::new(), Vec::new());
        let mut rest = r;
        for candidate in candidates {
            let (own, others) = rest.split_at(candidate.patterns.len().max(1));
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
            model.step(&mut at);
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

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        self.mean.check_state(x)
    }

    fn step(&self, x: &mut State) {
        let from = x.clone();
        self.mean.step(x);
        for derivative in &self.derivatives {
            if let Some(deviation) = &derivative.deviation {
                add_product(1.0, deviation, &derivative.at(&from), x.values_mut());
            }
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
mod tests {
    use super::super::tiles::tile_patterns;
    use super::super::transition::Transition;
    use super::*;
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::{
        Advection, AdvectionScheme, Boundary, Grid, ShallowWater, ShallowWaterParameters, Stepped, TimeScheme,
        VectorInvariant, Wind,
    };

    const STEP: Duration = Duration::from_seconds(1800);
    const STEPS: usize = 6;

    fn grid() -> Grid {
        Grid { nx: 12, ny: 8, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic }
    }

    struct Family {
        candidates: Vec<Candidate>,
        build: fn(&[f64]) -> Result<Arc<dyn TangentLinear>, Error>,
    }

    impl Corrections for Family {
        fn candidates(&self) -> &[Candidate] {
            &self.candidates
        }

        fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
            (self.build)(corrections)
        }
    }

    fn transition(
        steps: [f64; 2],
        tiles: Option<[usize; 2]>,
        build: fn(&[f64]) -> Result<Arc<dyn TangentLinear>, Error>,
    ) -> Transition {
        let candidate = |step: f64| Candidate {
            name: format!("{step}"),
            unit: "1".into(),
            step,
            sigma_prior: None,
            patterns: tiles.map_or(Vec::new(), |tiles| tile_patterns(&grid(), tiles)),
        };
        let family = Family { candidates: steps.map(candidate).to_vec(), build };
        Transition::new(Arc::new(family), grid().cells()).unwrap()
    }

    /// A tracer in a uniform wind (10, 0) m/s, whose components are the candidates.
    fn winds(tiles: Option<[usize; 2]>) -> Transition {
        transition([0.05, 0.05], tiles, |r| {
            let wind = Wind::Uniform { u_m_per_s: 10.0 + r[0], v_m_per_s: r[1] };
            let tendency = Advection::new(grid(), &wind, AdvectionScheme::FourthOrderCentred).unwrap();
            Ok(Arc::new(Stepped::new(tendency, STEP, TimeScheme::Rk4).unwrap()))
        })
    }

    /// Nonlinear shallow water, with gravity and the Coriolis parameter as candidates.
    fn water(tiles: Option<[usize; 2]>) -> Transition {
        transition([0.01, 1e-7], tiles, |r| {
            let parameters = ShallowWaterParameters {
                gravity_m_per_s2: 9.8 + r[0],
                coriolis_per_s: 1e-4 + r[1],
                ..Default::default()
            };
            let tendency = ShallowWater::new(grid(), parameters, VectorInvariant::Energy).unwrap();
            Ok(Arc::new(Stepped::new(tendency, Duration::from_seconds(300), TimeScheme::Rk4).unwrap()))
        })
    }

    fn random_state(transition: &Transition, seed: u64) -> State {
        let layout = transition.corrected.layout();
        let mut values = standard_normals(&mut stream(seed, "state"), layout.len());
        if layout.variables.len() == 3 {
            values[..layout.grid.cells()].iter_mut().for_each(|h| *h = 1000.0 + 10.0 * *h);
        }
        State::from_values(layout, values)
    }

    fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
        let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>().sqrt();
        norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
    }

    /// Derivative of the forecast by an amplitude, by differences of whole forecasts.
    fn difference(transition: &Transition, r: &[f64], k: usize, step: f64, x: &State) -> Vec<f64> {
        let forecast_with = |sign: f64| {
            let (mut moved, mut own, mut state) = (r.to_vec(), transition.clone(), x.clone());
            moved[k] += sign * step;
            own.set(&moved).unwrap();
            forecast::forecast(&*own.corrected.model(), &mut state, STEPS).unwrap();
            state
        };
        let (above, below) = (forecast_with(1.0), forecast_with(-1.0));
        above.values().iter().zip(below.values()).map(|(above, below)| (above - below) / (2.0 * step)).collect()
    }

    /// With the same amplitude in all tiles the model is the one that is corrected everywhere, and the tiles' columns sum to
    /// its column, the derivative of the whole forecast.
    #[test]
    fn tiles_that_are_all_corrected_alike_are_the_whole() {
        for (whole, tiles, r) in [
            (winds(None), winds(Some([3, 2])), [1.5, -1.0]),
            (water(None), water(Some([3, 2])), [0.3, 1e-5]),
            (winds(None), winds(Some([1, 1])), [1.5, -1.0]),
        ] {
            let (mut whole, mut tiles, x) = (whole.clone(), tiles.clone(), random_state(&whole, 1));
            let n = tiles.amplitudes.len() / 2;
            whole.set(&r).unwrap();
            tiles.set(&(0..2 * n).map(|k| r[k / n]).collect::<Vec<_>>()).unwrap();
            let forecast_by = |transition: &Transition| {
                let mut state = x.clone();
                forecast::forecast(&*transition.corrected.model(), &mut state, STEPS).unwrap();
                state.values().to_vec()
            };
            assert!(relative_difference(&forecast_by(&tiles), &forecast_by(&whole)) < 1e-13);
            let (of_whole, of_tiles) = (whole.columns(&x, STEPS).unwrap(), tiles.columns(&x, STEPS).unwrap());
            for candidate in 0..2 {
                let mut sum = vec![0.0; x.values().len()];
                for k in 0..n {
                    let column = of_tiles.column(candidate * n + k);
                    sum.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += value);
                }
                let column = of_whole.column(candidate);
                assert!(relative_difference(&sum, &column) < 1e-11);
                let step = whole.family.candidates()[candidate].step;
                let expected = difference(&whole, &r, candidate, step, &x);
                assert!(relative_difference(&column, &expected) < 1e-5);
            }
        }
    }

    /// At no correction the columns are exact; where the correction varies in space a part of second order is left out.
    #[test]
    fn a_column_is_the_derivative_of_the_corrected_forecast() {
        for (mut tiles, size) in [(winds(Some([3, 2])), 1.0), (water(Some([3, 2])), 0.1)] {
            let x = random_state(&tiles, 2);
            let n = tiles.amplitudes.len();
            let steps: Vec<f64> = tiles.amplitudes.iter().map(|it| tiles.candidate(it).step).collect();
            let varied: Vec<f64> = (0..n).map(|k| size * steps[k] / steps[0] * ((k % 3) as f64 - 1.0)).collect();
            for (r, tolerance) in [(vec![0.0; n], 1e-5), (varied, 0.03)] {
                tiles.set(&r).unwrap();
                let columns = tiles.columns(&x, STEPS).unwrap();
                for (k, &step) in steps.iter().enumerate() {
                    let off = relative_difference(&columns.column(k), &difference(&tiles, &r, k, step, &x));
                    assert!(off < tolerance, "{k}: {off}");
                }
            }
        }
    }

    #[test]
    fn the_tangent_linear_is_the_derivative_of_a_step() {
        let mut water = water(Some([3, 2]));
        water
            .set(&(0..12).map(|k| if k < 6 { 0.2 * k as f64 } else { 1e-5 * (k % 2) as f64 }).collect::<Vec<_>>())
            .unwrap();
        let model = water.corrected.model();
        let (x, change) = (random_state(&water, 3), random_state(&water, 4));
        let change: Vec<f64> = change.values().iter().map(|value| (value % 10.0) * 1e-2).collect();
        let mut expected = change.clone();
        model.step_tl(&x, &mut expected);
        let error = |size: f64| {
            let with = |sign: f64| {
                let mut state = x.clone();
                state.values_mut().iter_mut().zip(&change).for_each(|(value, change)| *value += sign * size * change);
                model.step(&mut state);
                state
            };
            let (above, below) = (with(1.0), with(-1.0));
            let differences = above.values().iter().zip(below.values());
            let found: Vec<f64> = differences.map(|(above, below)| (above - below) / (2.0 * size)).collect();
            relative_difference(&found, &expected)
        };
        // Central differences have an error of second order.
        let slope = (error(100.0) / error(10.0)).log10();
        assert!((slope - 2.0).abs() < 0.1, "{slope}");
    }
}
