//! Forecast of the factored covariance over one cycle with the propagator as a matrix, and the printed formulae's loss.

use super::block_diagonal::BlockDiagonal;
use super::blocks::Blocks;
use super::factored_covariance::FactoredCovariance;
use super::factors::Factors;
use crate::error::Error;
use crate::linalg::{add_symmetric_product, cholesky, mirror_lower, product};
use crate::tall_matrix::{Precision, TallMatrix};
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// The blocks of the forecast, `Σ_j A_kj C_j A_kjᵀ`, with the local parameters persisting.
///
/// `a` is the propagator of the state's m values; `analysed` holds the analysis' C_j.
pub(super) fn propagate_blocks(a: MatRef<'_, f64>, analysed: &FactoredCovariance, blocks: &Blocks) -> BlockDiagonal {
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
pub(super) fn propagate_factors(a: MatRef<'_, f64>, factors: &mut Factors) {
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
pub(super) fn drop_coupling(covariance: &mut FactoredCovariance, drift: &[f64], blocks: &Blocks) -> Result<(), Error> {
    let FactoredCovariance { own, factors, .. } = covariance;
    own.add_factors(blocks, 1.0, factors);
    let mut shared = product(factors.shared.as_ref(), factors.shared.transpose());
    for (i, sigma) in drift.iter().enumerate() {
        shared[(i, i)] += sigma * sigma;
    }
    *factors = Factors {
        state: TallMatrix::zeros(factors.state.rows(), drift.len(), factors.state.precision()),
        local: TallMatrix::zeros(factors.local.rows(), drift.len(), Precision::Double),
        shared: cholesky(shared, || "the covariance of the shared calibration parameters".into())?,
    };
    Ok(())
}

/// How many of the ascending variables are values of the state.
fn on_grid(variables: &[usize], m: usize) -> usize {
    variables.partition_point(|&variable| variable < m)
}
