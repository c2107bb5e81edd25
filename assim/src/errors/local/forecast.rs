//! The forecast of the covariance with local factors over one cycle.

use super::local_factors::{LocalFactors, add_to_blocks};
use super::recombination::Recombination;
use super::{Frame, LocalErrors};
use crate::error::Error;
use crate::errors::blocks::{CoarseGrid, residual};
use crate::filter::Cycle;
use crate::tall_matrix::{Precision, TallMatrix};
use faer::Mat;
use isobar_model::State;
use std::sync::Arc;

impl LocalErrors {
    /// x ← M(x), F_j ← A F_j, Γ ← A Γ, C_k ← ρ ρ C_k.
    ///
    /// Of the tiles of one colour the factors of one number make one column. What of it leaves a support lands in that of
    /// the next tile of the colour, or in none: then its block diagonal joins the C_k.
    pub(super) fn propagate(&mut self, x: &mut State, cycle: &Cycle<'_>) -> Result<(), Error> {
        self.drop_past();
        let frame = Arc::clone(&self.frame);
        let Frame { layout, blocks, colours, supports, settings, shared, .. } = &*frame;
        let (m, p) = (layout.len(), shared.len());
        let r = self.memory.factors.iter().map(LocalFactors::columns).max().unwrap_or(0);
        let border = colours.count * r;
        let mut columns = TallMatrix::zeros(m, border + p, settings.factor_precision);
        let on_grid = |support: &[usize]| support.partition_point(|&variable| variable < m);
        for ((factors, support), colour) in self.memory.factors.iter().zip(supports).zip(&colours.of_tile) {
            for j in 0..factors.columns() {
                let values = factors.column(j);
                columns.edit_column(colour * r + j, |column| {
                    support[..on_grid(support)]
                        .iter()
                        .zip(&*values)
                        .for_each(|(&variable, value)| column[variable] = *value);
                });
            }
        }
        for j in 0..p {
            columns.edit_column(border + j, |column| {
                column.copy_from_slice(&self.memory.sensitivity.col_as_slice(j)[..m]);
            });
        }
        let super::Memory { own, random, .. } = &mut self.memory;
        let probes = settings.residual.probes();
        residual::forecast((own, &mut columns), (blocks, layout), probes, random, |columns| {
            CoarseGrid::forecast(self.coarse.as_deref(), cycle, x, columns, border + p)
        })?;
        for ((factors, support), colour) in self.memory.factors.iter_mut().zip(supports).zip(&colours.of_tile) {
            for j in 0..factors.columns() {
                let column = columns.column(colour * r + j);
                factors.edit_column(j, |values| {
                    let rows = support[..on_grid(support)].iter().zip(values);
                    rows.for_each(|(&variable, value)| *value = column[variable]);
                });
            }
        }
        for j in 0..p {
            self.memory.sensitivity.col_as_slice_mut(j)[..m].copy_from_slice(&columns.column(border + j));
        }
        let lost: Vec<LocalFactors> = (0..colours.count).map(|colour| self.lost(&columns, colour, r)).collect();
        add_to_blocks(&mut self.memory.own, blocks, 1.0, &lost);
        Ok(())
    }

    /// The rows of a colour's columns that are in no support of it.
    fn lost(&self, columns: &TallMatrix, colour: usize, r: usize) -> LocalFactors {
        let variables = &self.frame.uncovered[colour];
        LocalFactors::filled(variables.clone(), r, Precision::Double, |j, rows| {
            let column = columns.column(colour * r + j);
            rows.iter_mut().zip(variables).for_each(|(value, &variable)| *value = column[variable]);
        })
    }

    /// Adds what a window adds to the covariance, model error and the parameters' drift, and compresses the factors.
    pub(super) fn add_errors(&mut self, cycle: &Cycle<'_>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        let p = cycle.calibration.len();
        let drift = Mat::from_fn(p, p, |i, j| if i == j { cycle.drift(i) } else { 0.0 });
        let kept = cycle.kept().unwrap_or_else(|| vec![1.0; p]);
        self.change_calibration(&kept, drift.as_ref())?;
        let before: Vec<usize> = self.memory.factors.iter().map(LocalFactors::columns).collect();
        if let Some(model_error) = &frame.model_error {
            let factor = cycle.error_factor;
            let own = self.memory.own.values_mut().iter_mut();
            own.zip(model_error.rest.values()).for_each(|(own, rest)| *own += factor * rest);
            for (factors, added) in self.memory.factors.iter_mut().zip(&model_error.factors) {
                *factors = factors.joined(added, factor.sqrt());
            }
        }
        let mut recombination = self.memory.past.is_some().then(|| {
            let joined: Vec<usize> = self.memory.factors.iter().map(LocalFactors::columns).collect();
            Recombination::joined(&before, &joined)
        });
        let mut left = vec![0.0; frame.blocks.variables()];
        self.reduce(recombination.as_mut(), &mut left);
        self.localize(recombination.as_mut(), &mut left);
        self.compress(recombination, left);
        Ok(())
    }
}
