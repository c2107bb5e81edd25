//! The forecast of the covariance with local factors over one cycle.

use super::local_factors::{LocalFactors, add_to_blocks};
use super::{Frame, LocalErrors};
use crate::error::Error;
use crate::errors::blocks::residual;
use crate::filter::Cycle;
use crate::tall_matrix::{Precision, TallMatrix, stored};
use faer::Mat;
use isobar_model::State;
use isobar_model::forecast::forecast_tl;
use std::sync::Arc;

impl LocalErrors {
    /// x ← M(x), F_j ← A F_j, Γ ← A Γ, C_k ← ρ ρ C_k.
    ///
    /// Of the tiles of one colour the factors of one number make one column. What of it leaves a support lands in that of
    /// the next tile of the colour, or in none: then its block diagonal joins the C_k.
    pub(super) fn propagate(&mut self, x: &mut State, cycle: &Cycle<'_>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        let Frame { layout, blocks, colours, supports, settings, shared, .. } = &*frame;
        let (m, p) = (layout.len(), shared.len());
        let r = self.memory.factors.iter().map(LocalFactors::columns).max().unwrap_or(0);
        let border = colours.count * r;
        let mut columns = TallMatrix::zeros(m, border + p, Precision::Double);
        let on_grid = |support: &[usize]| support.partition_point(|&variable| variable < m);
        for ((factors, support), colour) in self.memory.factors.iter().zip(supports).zip(&colours.of_tile) {
            for j in 0..factors.columns() {
                let values = factors.values.col_as_slice(j);
                columns.edit_column(colour * r + j, |column| {
                    support[..on_grid(support)]
                        .iter()
                        .zip(values)
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
            stored!(columns.values_mut(), columns => forecast_tl(cycle.model, x, columns, cycle.steps))?;
            Ok(())
        })?;
        for ((factors, support), colour) in self.memory.factors.iter_mut().zip(supports).zip(&colours.of_tile) {
            for j in 0..factors.columns() {
                let column = columns.column(colour * r + j);
                let values = factors.values.col_as_slice_mut(j);
                support[..on_grid(support)].iter().zip(values).for_each(|(&variable, value)| *value = column[variable]);
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
        let mut values = Mat::zeros(variables.len(), r);
        for j in 0..r {
            let column = columns.column(colour * r + j);
            let rows = values.col_as_slice_mut(j).iter_mut();
            rows.zip(variables).for_each(|(value, &variable)| *value = column[variable]);
        }
        LocalFactors::new(variables.clone(), values)
    }

    /// Adds what a window adds to the covariance, model error and the parameters' drift, and compresses the factors.
    pub(super) fn add_errors(&mut self, cycle: &Cycle<'_>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        let p = cycle.calibration.len();
        let drift = Mat::from_fn(p, p, |i, j| if i == j { cycle.drift(i) } else { 0.0 });
        let kept = cycle.kept().unwrap_or_else(|| vec![1.0; p]);
        self.change_calibration(&kept, drift.as_ref())?;
        if let Some(model_error) = &frame.model_error {
            let factor = cycle.error_factor;
            let own = self.memory.own.values_mut().iter_mut();
            own.zip(model_error.rest.values()).for_each(|(own, rest)| *own += factor * rest);
            for (factors, added) in self.memory.factors.iter_mut().zip(&model_error.factors) {
                let (before, added, root) = (&factors.values, &added.values, factor.sqrt());
                let r = before.ncols();
                let mut joint = Mat::zeros(before.nrows(), r + added.ncols());
                joint.as_mut().get_mut(.., ..r).copy_from(&before.0);
                for j in 0..added.ncols() {
                    let values = joint.col_as_slice_mut(r + j).iter_mut();
                    values.zip(added.col_as_slice(j)).for_each(|(value, added)| *value = root * added);
                }
                factors.values = joint.into();
            }
        }
        self.localize();
        self.compress();
        Ok(())
    }
}
