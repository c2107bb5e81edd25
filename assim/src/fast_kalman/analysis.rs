//! The analysis: observations by component, and the solution taken into state, calibration and covariance.

use super::FastKalmanFilter;
use super::factored_covariance::Patch;
use crate::block_angular::{Block, Component, PartitionReport, Solution, UpdateRows};
use crate::error::Error;
use crate::linalg::{cholesky, column, product};
use crate::problem::Innovations;
use faer::Mat;
use isobar_obs::SparseRows;

/// The Jacobians by block variables b and shared parameters c.
pub(super) struct SplitRows {
    pub block: SparseRows,
    pub shared: SparseRows,
}

impl FastKalmanFilter {
    pub(super) fn split_rows(&self, innovations: &Innovations) -> SplitRows {
        let m = self.state.values().len();
        let mut position = vec![(false, 0); self.problem.calibration.len()];
        self.local.iter().enumerate().for_each(|(i, &number)| position[number] = (true, m + i));
        self.shared.iter().enumerate().for_each(|(i, &number)| position[number] = (false, i));
        let (mut block, mut shared) = (SparseRows::new(), SparseRows::new());
        for row in 0..innovations.departures.len() {
            let calibration = innovations.jacobian.calibration.row(row);
            let of = |local: bool| {
                let position = &position;
                calibration
                    .iter()
                    .filter(move |entry| position[entry.0].0 == local)
                    .map(|entry| (position[entry.0].1, entry.1))
            };
            block.push_row(innovations.jacobian.state.row(row).iter().copied().chain(of(true)));
            shared.push_row(of(false));
        }
        SplitRows { block, shared }
    }

    /// The rows of a component in covariance form, and its variables.
    pub(super) fn update_rows(
        &self,
        component: &Component,
        rows: &SplitRows,
        innovations: &Innovations,
    ) -> (Vec<usize>, Block) {
        let members = component.blocks.iter().flat_map(|&block| &self.blocks.members[block]);
        let mut variables: Vec<usize> = members.copied().collect();
        // Ascending: the state's values first, then the local parameters.
        variables.sort_unstable();
        let locate = |variable: usize| variables.binary_search(&variable).expect("the component holds the variable");
        let (size, n, r) = (variables.len(), component.observations.len(), self.covariance.block_factors.ncols());
        let mut prior = Mat::<f64>::zeros(size, size);
        for &block in &component.blocks {
            let patch = &self.covariance.patches[block];
            let positions: Vec<usize> = patch.variables.iter().map(|&variable| locate(variable)).collect();
            for (j, &column) in positions.iter().enumerate() {
                for (i, &row) in positions.iter().enumerate() {
                    prior[(row, column)] = patch.covariance[(i, j)];
                }
            }
        }
        let mut cross = Mat::<f64>::zeros(size, n);
        let mut g = Mat::<f64>::zeros(n, r);
        for (column, &row) in component.observations.iter().enumerate() {
            for &(variable, weight) in rows.block.row(row) {
                let source = prior.col_as_slice(locate(variable));
                for (value, source) in cross.col_as_slice_mut(column).iter_mut().zip(source) {
                    *value += weight * source;
                }
            }
            for factor in 0..r {
                g[(column, factor)] = rows.block.row_dot(row, self.covariance.block_factors.col_as_slice(factor))
                    + rows.shared.row_dot(row, self.covariance.shared_factors.col_as_slice(factor));
            }
        }
        let innovation = Mat::from_fn(n, n, |i, j| {
            let row = component.observations[i];
            let covariance: f64 =
                rows.block.row(row).iter().map(|&(variable, weight)| weight * cross[(locate(variable), j)]).sum();
            covariance + if i == j { innovations.variance[row] } else { 0.0 }
        });
        let d = component.observations.iter().map(|&row| innovations.departures[row]).collect();
        (variables, Block::Update(UpdateRows { prior, cross, innovation, g, d }))
    }

    /// Takes the solution into state, calibration and covariance.
    pub(super) fn apply(
        &mut self,
        components: &[Component],
        variables: Vec<Vec<usize>>,
        solution: Solution,
    ) -> Result<(), Error> {
        let amplitudes = column(&solution.border);
        let mut block_increment = product(self.covariance.block_factors.as_ref(), amplitudes.as_ref());
        let shared_increment = product(self.covariance.shared_factors.as_ref(), amplitudes.as_ref());
        let mut observed = vec![false; self.blocks.members.len()];
        let mut patches = Vec::with_capacity(self.blocks.members.len());
        for ((component, variables), block) in components.iter().zip(variables).zip(solution.blocks) {
            component.blocks.iter().for_each(|&block| observed[block] = true);
            for (position, &variable) in variables.iter().enumerate() {
                block_increment[(variable, 0)] += block.estimate[position];
            }
            for factor in 0..block.sensitivity.ncols() {
                let target = self.covariance.block_factors.col_as_slice_mut(factor);
                for (&variable, sensitivity) in variables.iter().zip(block.sensitivity.col_as_slice(factor)) {
                    target[variable] -= sensitivity;
                }
            }
            patches.push(Patch { variables, covariance: block.covariance });
        }
        let before = std::mem::take(&mut self.covariance.patches);
        patches.extend(before.into_iter().zip(&observed).filter(|(_, observed)| !**observed).map(|(patch, _)| patch));
        self.covariance.patches = patches;
        let root = cholesky(solution.border_covariance, || "the covariance S of the border".into())?;
        for factors in [&mut self.covariance.block_factors, &mut self.covariance.shared_factors] {
            *factors = product(factors.as_ref(), root.as_ref());
        }
        let m = self.state.values().len();
        let increments = block_increment.col_as_slice(0);
        self.state.values_mut().iter_mut().zip(increments).for_each(|(value, change)| *value += change);
        for (&number, change) in self.local.iter().zip(&increments[m..]) {
            self.bias[number] += change;
        }
        for (&number, change) in self.shared.iter().zip(shared_increment.col_as_slice(0)) {
            self.bias[number] += change;
        }
        Ok(())
    }

    fn component_size(&self, component: &Component) -> usize {
        component.blocks.iter().map(|&block| self.blocks.members[block].len()).sum()
    }

    pub(super) fn check_component(&self, component: &Component) -> Result<(), Error> {
        let (size, n) = (self.component_size(component) as u64, component.observations.len() as u64);
        let needed_bytes = 8 * (2 * size * size + 3 * size * n + 2 * n * n);
        if needed_bytes > self.problem.memory_limit_bytes {
            return Err(Error::TooLarge {
                what: format!(
                    "the component of {} blocks ({size} variables) that {n} observations link",
                    component.blocks.len()
                ),
                needed_bytes,
                limit_bytes: self.problem.memory_limit_bytes,
            });
        }
        Ok(())
    }

    pub(super) fn report(&self, components: &[Component]) -> PartitionReport {
        let largest = components.iter().max_by_key(|component| self.component_size(component));
        let observed: usize = components.iter().map(|component| component.blocks.len()).sum();
        PartitionReport {
            blocks: self.blocks.members.len(),
            components: components.len(),
            merged_components: components.iter().filter(|component| component.blocks.len() > 1).count(),
            largest_component_blocks: largest.map_or(0, |component| component.blocks.len()),
            largest_component_variables: largest.map_or(0, |component| self.component_size(component)),
            unobserved_blocks: self.blocks.members.len() - observed,
            border: self.covariance.block_factors.ncols(),
        }
    }
}
