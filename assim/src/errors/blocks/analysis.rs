//! The analysis: observations by component, and the solution taken into state, calibration and covariance.
//!
//! The components are eliminated in chunks, and what each of them adds to the factors, −D_k, is taken in at once, so that
//! never all D_k are there together: they would need as much memory as the observed part of Φ.

use super::component::{component_size, set_blocks, update_rows};
use super::factored_covariance::Patch;
use super::solution::{Increments, Solved, SplitRows, augmented};
use super::{BlockErrors, Frame, Residual};
use crate::augmented::Augmented;
use crate::block_angular::{Component, Eliminated, Information, Prior};
use crate::error::Error;
use crate::linalg::cholesky;
use crate::memory::Matrix;
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// Components that are eliminated at a time.
const COMPONENTS: usize = 128;

impl BlockErrors {
    pub(crate) fn split_rows(&self, innovations: &Innovations) -> SplitRows {
        SplitRows::new(innovations, &self.frame.local, &self.frame.shared)
    }

    /// Analyses the innovations, where the first `free` columns of Φ are no factors.
    pub(super) fn update(
        &mut self,
        components: &[Component],
        rows: &SplitRows,
        innovations: &Innovations,
        free: usize,
    ) -> Result<Solved, Error> {
        self.memory.covariance.linked.clear();
        let r = self.factors().columns();
        let prior = Prior { mean: vec![0.0; r], covariance: Mat::identity(r, r) };
        let mut information = Information::new(&prior)?;
        let mut increment = vec![0.0; self.frame.blocks.variables()];
        for (chunk, components) in components.chunks(COMPONENTS).enumerate() {
            let observed = self.eliminate(chunk * COMPONENTS, components, rows, innovations)?;
            information.add(observed.iter().map(|(_, eliminated)| eliminated));
            self.take_in(components, observed, &mut increment);
        }
        let border = information.solve()?;
        self.finish(&border.estimate, border.covariance, increment, border.residual_chi2, free)
    }

    /// Takes in the factors' amplitudes ξ̂ and their covariance S, where β̂_k(ξ = 0) is in the increment and −D_k in Φ.
    pub(super) fn finish(
        &mut self,
        amplitudes: &[f64],
        covariance: Mat<f64>,
        mut of_blocks: Vec<f64>,
        chi2: f64,
        free: usize,
    ) -> Result<Solved, Error> {
        let root = cholesky(covariance, || "the covariance S of the border".into())?;
        if free > 0 {
            return Ok(self.finish_with_free(amplitudes, root.as_ref(), of_blocks, chi2, free));
        }
        // β̂_k + Φ_b ξ̂ = β̂_k(ξ = 0) + (Φ_b − D) ξ̂.
        let of_shared = self.take_in_amplitudes(amplitudes, root.as_ref(), 0, &mut of_blocks);
        Ok(Solved { increments: Increments { of_blocks, of_shared }, chi2, found: None })
    }

    /// The variables of each component, and what is left of its rows without them.
    fn eliminate(
        &self,
        first: usize,
        components: &[Component],
        rows: &SplitRows,
        innovations: &Innovations,
    ) -> Result<Vec<(Vec<usize>, Eliminated)>, Error> {
        let r = self.memory.covariance.factors.columns();
        let mut first_rows = vec![0];
        for (number, component) in components.iter().enumerate() {
            first_rows.push(first_rows[number] + component.observations.len());
        }
        let g = self.observed_factors(components, rows);
        let g = MatRef::from_column_major_slice(&g, first_rows[components.len()], r);
        let eliminate = |(number, component): (usize, &Component)| {
            let g = g.get(first_rows[number]..first_rows[number + 1], ..);
            let parts = (&self.frame.blocks, &self.memory.covariance.own);
            let (variables, block) = update_rows(parts, component, g, rows, innovations);
            let eliminated = block.eliminate(first + number, r).map_err(|error| self.of_component(component, error))?;
            Ok((variables, eliminated))
        };
        components.par_iter().enumerate().map(eliminate).collect()
    }

    /// The failure of a component, whose blocks it names.
    fn of_component(&self, component: &Component, error: Error) -> Error {
        let Error::NotPositiveDefinite { pivot, size, .. } = error else { return error };
        let name = |&block: &usize| self.frame.blocks.describe(block, &self.frame.layout);
        let blocks = match component.blocks.as_slice() {
            [] => "no block".into(),
            [block] => name(block),
            [first, others @ ..] => format!("{} and {} more, which observations link", name(first), others.len()),
        };
        Error::NotPositiveDefinite { matrix: format!("the innovation covariance H P H' + R of {blocks}"), pivot, size }
    }

    /// H Φ_b + G Φ_c for the observations of the components, one component after another, `[observations, r]`.
    ///
    /// Factor by factor, because a column of Φ lies together in memory, and its row does not.
    pub(super) fn observed_factors(&self, components: &[Component], rows: &SplitRows) -> Vec<f64> {
        let observations: Vec<usize> =
            components.iter().flat_map(|component| component.observations.iter().copied()).collect();
        let factors = &self.memory.covariance.factors;
        let (has_parameters, mut result) =
            (factors.has_parameters(), vec![0.0; observations.len() * factors.columns()]);
        result.par_chunks_exact_mut(observations.len().max(1)).enumerate().for_each(|(factor, column)| {
            let shared = factors.shared.col_as_slice(factor);
            for (value, &row) in column.iter_mut().zip(&observations) {
                let of_block = rows.block.row(row).iter();
                *value = of_block.map(|&(variable, weight)| weight * factors.value(variable, factor)).sum::<f64>()
                    + if has_parameters { rows.shared.row_dot(row, shared) } else { 0.0 };
            }
        });
        factors.sum(&mut result);
        result
    }

    /// Φ_b ← Φ_b − D and the new C_k on the variables of the components; β̂_k(ξ = 0) is added to the increment.
    pub(super) fn take_in(
        &mut self,
        components: &[Component],
        observed: Vec<(Vec<usize>, Eliminated)>,
        increment: &mut [f64],
    ) {
        let m = self.frame.layout.len();
        self.memory.covariance.factors.for_each_column(|factor, mut of_state, mut of_local| {
            for (variables, eliminated) in &observed {
                for (&variable, &sensitivity) in variables.iter().zip(eliminated.sensitivity.col_as_slice(factor)) {
                    if variable < m {
                        of_state.subtract(variable, sensitivity);
                    } else {
                        of_local.subtract(variable - m, sensitivity);
                    }
                }
            }
        });
        for (component, (variables, Eliminated { estimate_without_border, covariance, .. })) in
            components.iter().zip(observed)
        {
            for (position, &variable) in variables.iter().enumerate() {
                increment[variable] += estimate_without_border[(position, 0)];
            }
            let parts = (&self.frame.blocks, &mut self.memory.covariance.own);
            set_blocks(parts, component, &variables, covariance.as_ref());
            // Other forecasts than the exact one have no use for what is linked beyond the blocks: that its leading
            // directions join Φ does not change the scores, since the compression after the forecast drops them again.
            if component.blocks.len() > 1 && self.frame.settings.residual == Residual::Exact {
                self.memory.covariance.linked.push(Patch { variables, covariance: Matrix(covariance) });
            }
        }
    }

    /// s ← s + δs.
    pub(crate) fn add_increments(&self, s: &mut Augmented, increments: &Increments) {
        let Frame { local, shared, .. } = &*self.frame;
        s.add(&augmented(&increments.of_blocks, &increments.of_shared, local, shared));
    }

    pub(super) fn component_size(&self, component: &Component) -> usize {
        component_size(&self.frame.blocks, component)
    }
}
