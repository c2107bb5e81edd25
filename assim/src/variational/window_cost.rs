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
