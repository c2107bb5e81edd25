//! The quadratic cost of 4D-Var, along the trajectory of a window.

use super::control_space::ControlSpace;
use crate::appropriate_time::Times;
use crate::problem::Innovations;
use isobar_model::vector::add;
use isobar_model::{Adjoint, ColumnsMut, State, forecast};
use rayon::prelude::*;

/// The quadratic problem of an outer loop; a control vector is (χ, β), a vector of whitened observations has one part for
/// each cycle. All operators take several vectors at once, which the models propagate together.
pub(super) struct Cost<'a> {
    pub model: &'a dyn Adjoint,
    pub control: &'a ControlSpace<'a>,
    /// States of each cycle, from its first step to its end.
    pub trajectory: &'a [Vec<State>],
    pub innovations: &'a [Innovations],
    /// The times of each cycle's observations.
    pub times: &'a [Times],
}

impl Cost<'_> {
    /// R^-½ (H M δx_0 + G δc) of several increments: `columns` holds the δx_0 one after another.
    pub fn observe(&self, mut columns: Vec<f64>, biases: &[Vec<f64>]) -> Vec<Vec<Vec<f64>>> {
        let m = self.control.state_values();
        let mut result: Vec<Vec<Vec<f64>>> = vec![Vec::with_capacity(self.trajectory.len()); biases.len()];
        for ((cycle, own), times) in self.trajectory.iter().zip(self.innovations).zip(self.times) {
            let (mut done, mut seen) = (0, vec![vec![0.0; own.len()]; biases.len()]);
            for &stop in times.stops() {
                if stop > done {
                    self.model.steps_tl(&cycle[done], ColumnsMut::Double(&mut columns), stop - done);
                }
                done = stop;
                for (row, weight) in times.weights(stop) {
                    for (dx, dy) in columns.chunks_exact(m).zip(&mut seen) {
                        dy[row] += weight * own.jacobian.state.row_dot(row, dx);
                    }
                }
            }
            for ((dc, mut dy), result) in biases.iter().zip(seen).zip(&mut result) {
                own.jacobian.calibration.multiply_add(dc, &mut dy);
                result.push(own.whiten(dy));
            }
        }
        result
    }

    /// Kᵀ of several vectors of whitened observations.
    pub fn multiply_transposed(&self, whitened: &[Vec<Vec<f64>>]) -> Vec<Vec<f64>> {
        let (columns, biases) = self.back(whitened);
        let m = self.control.state_values();
        columns.par_chunks_exact(m).zip(&biases).map(|(dx, dc)| self.control.controls(dx, dc)).collect()
    }

    /// (Mᵀ Hᵀ R^-½ y, Gᵀ R^-½ y) of several vectors of whitened observations: the states one after another, and the biases.
    fn back(&self, whitened: &[Vec<Vec<f64>>]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let m = self.control.state_values();
        let mut columns = vec![0.0; m * whitened.len()];
        let mut biases = vec![vec![0.0; self.control.parameters()]; whitened.len()];
        for (number, (cycle, own)) in self.trajectory.iter().zip(self.innovations).enumerate().rev() {
            let times = &self.times[number];
            let weighted: Vec<Vec<f64>> = whitened.iter().map(|values| own.whiten(values[number].clone())).collect();
            for (dy, dc) in weighted.iter().zip(&mut biases) {
                own.jacobian.calibration.transpose_multiply_add(dy, dc);
            }
            let before = [0].iter().chain(times.stops());
            for (&stop, &before) in times.stops().iter().rev().zip(before.rev().skip(1)) {
                for (row, weight) in times.weights(stop) {
                    for (dy, dx) in weighted.iter().zip(columns.chunks_exact_mut(m)) {
                        own.jacobian.state.row(row).iter().for_each(|&(at, entry)| dx[at] += weight * dy[row] * entry);
                    }
                }
                if stop > before {
                    forecast::backward_ad(self.model, &cycle[before..=stop], &mut columns);
                }
            }
        }
        (columns, biases)
    }

    /// (I + KᵀK) v.
    pub fn hessian(&self, control: &[f64]) -> Vec<f64> {
        let (dx, dc) = self.control.increments(control);
        let mut image = self.multiply_transposed(&self.observe(dx, &[dc])).swap_remove(0);
        add(&mut image, control);
        image
    }

    /// K_x K_xᵀ of several vectors of whitened observations, those of a window one after another; of the state alone.
    pub fn multiply_state(&self, vectors: &[&[f64]]) -> Vec<Vec<f64>> {
        let m = self.control.state_values();
        let no_biases = vec![vec![0.0; self.control.parameters()]; vectors.len()];
        let split = |vector: &&[f64]| -> Vec<Vec<f64>> {
            let mut rest = *vector;
            let mut of_cycle = |own: &Innovations| rest.split_off(..own.len()).expect("all cycles' rows").to_vec();
            self.innovations.iter().map(&mut of_cycle).collect()
        };
        let (mut columns, _) = self.back(&vectors.iter().map(split).collect::<Vec<_>>());
        columns.par_chunks_exact_mut(m).for_each(|dx| {
            dx.copy_from_slice(&self.control.state_increment(&self.control.state_control(dx)));
        });
        self.observe(columns, &no_biases).into_iter().map(|parts| parts.concat()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::{Sum, White};
    use faer::Mat;
    use isobar_model::initial::{RandomConfig, random_balanced};
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::vector::{axpy, dot};
    use isobar_model::{
        Boundary, Duration, Forced, Forcing, Grid, ShallowWater, ShallowWaterParameters, Source, Stepped, Time,
        TimeFunction, TimeScheme, VectorInvariant,
    };
    use isobar_obs::{Jacobian, SparseRows};
    use std::sync::Arc;

    /// Kᵀ of the whitened departures is minus the gradient of ½ Σ |R^-½ (y − H M(x_0 + √s U χ))|² of the nonlinear model with a
    /// forcing that changes from step to step: the Taylor remainder falls with ε².
    #[test]
    fn the_gradient_is_that_of_the_cost_with_a_forcing() {
        let grid = Grid { nx: 8, ny: 9, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Channel };
        let parameters = ShallowWaterParameters {
            gravity_m_per_s2: 9.81,
            coriolis_per_s: 1e-4,
            ..ShallowWaterParameters::default()
        };
        let water = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).unwrap();
        let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 20.0, length_scale_m: 3e5 };
        let start = random_balanced(&water, &config, &mut stream(1, "start")).unwrap();
        let start = start.valid_at(Time::from_seconds(1_000_000));
        let (period, highest_at) = (Duration::from_seconds(4000), Duration::from_seconds(300));
        let pattern = standard_normals(&mut stream(2, "pattern"), 72).iter().map(|value| 0.05 * value).collect();
        let source = Source { variable: 0, pattern, function: TimeFunction::Sinusoid { period, highest_at } };
        let plain = Stepped::new(water, Duration::from_seconds(200), TimeScheme::Rk4).unwrap();
        let model = Forced::of(Arc::new(plain), &Arc::new(Forcing { sources: vec![source] })).unwrap();
        let (layout, steps, cycles) = (model.layout().clone(), 5, 3);
        let m = layout.len();
        let covariance = Sum::new(m, (0..3).map(|it| Box::new(White::new(&layout, it, 2.0)) as _).collect());
        let control = ControlSpace::new(&covariance, 0.5, &Mat::zeros(0, 0)).unwrap();
        let along = |x: &State| -> Vec<Vec<State>> {
            let mut all: Vec<Vec<State>> = Vec::new();
            for _ in 0..cycles {
                let from = all.last().map_or(x, |cycle| &cycle[steps]);
                all.push(forecast::trajectory(&*model, from, steps).unwrap());
            }
            all
        };
        // Every fifth value at the end of each cycle.
        let rows: Vec<usize> = (0..m).step_by(5).collect();
        let observations: Vec<Vec<f64>> =
            (0..cycles).map(|cycle| standard_normals(&mut stream(cycle as u64, "observations"), rows.len())).collect();
        let departures = |trajectory: &[Vec<State>]| -> Vec<Vec<f64>> {
            let of_cycle = |(states, own): (&Vec<State>, &Vec<f64>)| {
                let end = states[steps].values();
                rows.iter().zip(own).map(|(&index, value)| 3.0 * value - (end[index] - start.values()[index])).collect()
            };
            trajectory.iter().zip(&observations).map(of_cycle).collect()
        };
        let trajectory = along(&start);
        let innovations: Vec<Innovations> = departures(&trajectory)
            .into_iter()
            .map(|departures| {
                let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
                rows.iter().for_each(|&index| state.push_row([(index, 1.0)]));
                rows.iter().for_each(|_| calibration.push_row([]));
                let variance = vec![4.0; rows.len()];
                Innovations { departures, jacobian: Jacobian { state, calibration }, variance, state_values: m }
            })
            .collect();
        let times: Vec<Times> = (0..cycles).map(|_| Times::at_end(rows.len(), steps)).collect();
        let cost = Cost {
            model: &*model,
            control: &control,
            trajectory: &trajectory,
            innovations: &innovations,
            times: &times,
        };
        let whitened = innovations.iter().map(|own| own.whiten(own.departures.clone())).collect();
        let downhill = cost.multiply_transposed(&[whitened]).swap_remove(0);
        let half_square = |trajectory: &[Vec<State>]| -> f64 {
            departures(trajectory).iter().flatten().map(|departure| departure * departure / 4.0).sum::<f64>() / 2.0
        };
        let direction = standard_normals(&mut stream(9, "direction"), downhill.len());
        let (before, slope) = (half_square(&trajectory), -dot(&downhill, &direction));
        let remainder = |epsilon: f64| {
            let mut moved = start.clone();
            axpy(epsilon, &control.state_increment(&direction), moved.values_mut());
            half_square(&along(&moved)) - before - epsilon * slope
        };
        let remainders = [1e-1, 1e-2, 1e-3].map(remainder);
        for pair in remainders.windows(2) {
            let order = (pair[0] / pair[1]).log10();
            assert!((order - 2.0).abs() < 0.05, "{remainders:?}");
        }
    }
}
