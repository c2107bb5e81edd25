//! The forecast of the factored covariance over one cycle.

use super::block_diagonal::BlockDiagonal;
use super::coarse_grid::CoarseGrid;
use super::compression::{Joining, Kept, join_and_compress};
use super::factored_covariance::FactoredCovariance;
use super::factors::Factors;
use super::grid_blocks::Blocks;
use super::{BiasCoupling, BlockErrors, ModelError, Residual, residual};
use crate::error::Error;
use crate::filter::Cycle;
use crate::linalg::{add_symmetric_product, cholesky, mirror_lower, product};
use crate::memory::Matrix;
use crate::propagator::propagator;
use crate::tall_matrix::{Precision, TallMatrix};
use faer::{Mat, MatRef};
use isobar_model::State;
use rayon::prelude::*;
use std::collections::VecDeque;

impl BlockErrors {
    /// Forecasts state, factors and blocks.
    pub(crate) fn propagate(&mut self, x: &mut State, cycle: &Cycle<'_>) -> Result<(), Error> {
        self.drop_past();
        let (frame, m) = (&*self.frame, x.values().len());
        let super::Memory { covariance, random, .. } = &mut self.memory;
        if frame.settings.residual == Residual::Exact {
            let a = propagator(cycle.model, x, cycle.steps)?;
            let a = MatRef::from_column_major_slice(&a, m, m);
            covariance.own = propagate_blocks(a, covariance, &frame.blocks);
            covariance.linked.clear();
            propagate_factors(a, &mut covariance.factors);
            return Ok(());
        }
        let FactoredCovariance { own, factors, .. } = covariance;
        let (columns, grid) = (&mut factors.state, (&frame.blocks, &*frame.layout));
        let r = columns.columns();
        residual::forecast((own, columns), grid, frame.settings.residual.probes(), random, |columns| {
            CoarseGrid::forecast(self.coarse.as_deref(), cycle, x, columns, r)
        })
    }

    /// Adds what a window adds to the covariance: model error and the parameters' drift.
    pub(crate) fn add_errors(&mut self, cycle: &Cycle<'_>) -> Result<(), Error> {
        let (frame, m) = (&*self.frame, self.frame.layout.len());
        let covariance = &mut self.memory.covariance;
        let drift = |numbers: &[usize]| -> Vec<f64> {
            let parameters = &cycle.calibration.parameters;
            numbers.iter().map(|&number| parameters[number].drift.added_sigma(cycle.window)).collect()
        };
        let adapted = frame.model_error.as_ref().filter(|_| cycle.error_factor != 1.0);
        let adapted = adapted.map(|model_error| model_error.times(cycle.error_factor));
        let model_error = adapted.as_ref().or(frame.model_error.as_ref());
        if let Some(model_error) = model_error {
            covariance.own.add(&model_error.blocks);
        }
        for (number, sigma) in drift(&frame.local).iter().enumerate() {
            covariance.own.edit(&frame.blocks, m + number, |mut matrix, position| {
                matrix[(position, position)] += sigma * sigma;
            });
        }
        let drift = drift(&frame.shared);
        if frame.settings.bias_coupling == BiasCoupling::Drop {
            return drop_coupling(covariance, &drift, &frame.blocks);
        }
        let joining = Joining { model_error: model_error.map(ModelError::further), drift: &drift };
        let kept = Kept { at_most: frame.settings.factors, retained: frame.settings.retained_energy };
        join_and_compress(covariance, &joining, kept, &frame.scales, &frame.blocks);
        Ok(())
    }
}

/// The blocks of the forecast, `Σ_j A_kj C_j A_kjᵀ`, with the local parameters persisting.
///
/// `a` is the propagator of the state's m values; `analysed` holds the analysis' C_j.
fn propagate_blocks(a: MatRef<'_, f64>, analysed: &FactoredCovariance, blocks: &Blocks) -> BlockDiagonal {
    let m = a.nrows();
    let patches = analysed.patches(blocks);
    // A C, `[m, block variables]`: the covariance of the forecast state with the analysed block variables.
    let products: Vec<Mat<f64>> = patches
        .par_iter()
        .map(|(variables, covariance)| {
            let on_grid = on_grid(variables, m);
            let columns = Mat::from_fn(m, on_grid, |i, j| a[(i, variables[j])]);
            product(columns.as_ref(), covariance.get(..on_grid, ..))
        })
        .collect();
    let mut crossed = Mat::zeros(m, blocks.variables());
    let mut local_covariances = Vec::new();
    for ((variables, covariance), product) in patches.iter().zip(&products) {
        for (position, &variable) in variables.iter().enumerate() {
            crossed.col_as_slice_mut(variable).copy_from_slice(product.col_as_slice(position));
        }
        let locals = on_grid(variables, m)..variables.len();
        for (i, j) in locals.clone().flat_map(|i| locals.clone().map(move |j| (i, j))) {
            local_covariances.push((variables[i], variables[j], covariance[(i, j)]));
        }
    }
    let mut forecast = BlockDiagonal::zeros(blocks);
    forecast.for_each_block(blocks, |block, mut covariance| {
        let variables = blocks.members(block);
        let (on_grid, size) = (on_grid(variables, m), variables.len());
        let left = Mat::from_fn(on_grid, m, |i, j| crossed[(variables[i], j)]);
        let right = Mat::from_fn(on_grid, m, |i, j| a[(variables[i], j)]);
        let grid_part = covariance.as_mut().get_mut(..on_grid, ..on_grid);
        add_symmetric_product(grid_part, 1.0, left.as_ref(), right.transpose());
        for local in on_grid..size {
            for i in 0..on_grid {
                covariance[(local, i)] = crossed[(variables[i], variables[local])];
            }
        }
        mirror_lower(covariance);
    });
    for (row, column, value) in local_covariances {
        let ((block, i), (other, j)) = (blocks.place(row), blocks.place(column));
        if block == other {
            forecast.block_mut(blocks, block)[(i, j)] = value;
        }
    }
    forecast
}

/// Φ_b ← A Φ_b on the state's values; local parameters persist.
fn propagate_factors(a: MatRef<'_, f64>, factors: &mut Factors) {
    let mut scratch = Vec::new();
    let propagated = product(a, factors.state.part(0, factors.state.rows(), 0, &mut scratch));
    for column in 0..factors.columns() {
        factors.state.edit_column(column, |values| values.copy_from_slice(propagated.col_as_slice(column)));
    }
}

/// The printed formulae: of the covariance that the blocks have through the factors only the block diagonal stays, and
/// none with the shared parameters, whose random walks are added.
///
/// # Errors
/// If the shared parameters' covariance is not positive definite.
fn drop_coupling(covariance: &mut FactoredCovariance, drift: &[f64], blocks: &Blocks) -> Result<(), Error> {
    let FactoredCovariance { own, factors, .. } = covariance;
    own.add_factors(blocks, 1.0, factors);
    let mut shared = product(factors.shared.as_ref(), factors.shared.transpose());
    for (i, sigma) in drift.iter().enumerate() {
        shared[(i, i)] += sigma * sigma;
    }
    *factors = Factors {
        state: factors.state.zeros_like(drift.len(), factors.state.precision()),
        local: TallMatrix::zeros(factors.local.rows(), drift.len(), Precision::Double),
        shared: Matrix(cholesky(shared, || "the covariance of the shared calibration parameters".into())?),
        past: VecDeque::new(),
    };
    Ok(())
}

/// How many of the ascending variables are values of the state.
fn on_grid(variables: &[usize], m: usize) -> usize {
    variables.partition_point(|&variable| variable < m)
}
