//! Forecast of the factored covariance over one cycle.

use super::blocks::Blocks;
use super::factored_covariance::{FactoredCovariance, Patch};
use crate::error::Error;
use crate::linalg::{add_product, add_symmetric_product, cholesky, mirror_lower, product};
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// The blocks of the forecast, `Σ_j A_kj C_j A_kjᵀ`, with the local parameters persisting: a patch for each block.
///
/// `a` is the propagator of the state's m values; `patches` hold the analysis' C_j.
pub(super) fn propagate_blocks(a: MatRef<'_, f64>, patches: &[Patch], blocks: &Blocks) -> Vec<Patch> {
    let m = a.nrows();
    // A C, `[m, block variables]`: the covariance of the forecast state with the analysed block variables.
    let products: Vec<Mat<f64>> = patches
        .par_iter()
        .map(|patch| {
            let on_grid = on_grid(&patch.variables, m);
            let columns = Mat::from_fn(m, on_grid, |i, j| a[(i, patch.variables[j])]);
            product(columns.as_ref(), patch.covariance.as_ref().get(..on_grid, ..))
        })
        .collect();
    let mut crossed = Mat::zeros(m, blocks.variables());
    let mut local_covariances = Vec::new();
    for (patch, product) in patches.iter().zip(&products) {
        for (position, &variable) in patch.variables.iter().enumerate() {
            crossed.col_as_slice_mut(variable).copy_from_slice(product.col_as_slice(position));
        }
        let locals = on_grid(&patch.variables, m)..patch.variables.len();
        for (i, j) in locals.clone().flat_map(|i| locals.clone().map(move |j| (i, j))) {
            local_covariances.push((patch.variables[i], patch.variables[j], patch.covariance[(i, j)]));
        }
    }
    let mut forecast: Vec<Patch> = blocks
        .members
        .par_iter()
        .map(|variables| {
            let (on_grid, size) = (on_grid(variables, m), variables.len());
            let mut covariance = Mat::zeros(size, size);
            let left = Mat::from_fn(on_grid, m, |i, j| crossed[(variables[i], j)]);
            let right = Mat::from_fn(on_grid, m, |i, j| a[(variables[i], j)]);
            let grid_part = covariance.as_mut().get_mut(..on_grid, ..on_grid);
            add_symmetric_product(grid_part, 1.0, left.as_ref(), right.transpose());
            for local in on_grid..size {
                for i in 0..on_grid {
                    covariance[(local, i)] = crossed[(variables[i], variables[local])];
                }
            }
            mirror_lower(covariance.as_mut());
            Patch { variables: variables.clone(), covariance }
        })
        .collect();
    for (row, column, value) in local_covariances {
        let ((block, i), (other, j)) = (blocks.place[row], blocks.place[column]);
        if block == other {
            forecast[block].covariance[(i, j)] = value;
        }
    }
    forecast
}

/// Φ_b ← A Φ_b on the state's values; local parameters persist.
pub(super) fn propagate_factors(a: MatRef<'_, f64>, factors: &mut Mat<f64>) {
    let propagated = product(a, factors.as_ref().get(..a.nrows(), ..));
    factors.as_mut().get_mut(..a.nrows(), ..).copy_from(propagated);
}

/// The printed formulae: of the covariance that the blocks have through the factors only the block diagonal stays, and
/// none with the shared parameters, whose random walks are added.
///
/// # Errors
/// If the shared parameters' covariance is not positive definite.
pub(super) fn drop_coupling(covariance: &mut FactoredCovariance, drift: &[f64], blocks: &Blocks) -> Result<(), Error> {
    add_block_diagonal(&mut covariance.patches, covariance.block_factors.as_ref(), blocks);
    covariance.block_factors = Mat::zeros(covariance.block_factors.nrows(), drift.len());
    let mut shared = product(covariance.shared_factors.as_ref(), covariance.shared_factors.transpose());
    for (i, sigma) in drift.iter().enumerate() {
        shared[(i, i)] += sigma * sigma;
    }
    covariance.shared_factors = cholesky(shared, || "the covariance of the shared calibration parameters".into())?;
    Ok(())
}

/// C_k += F_k F_kᵀ, where the patches are those of the blocks.
pub(super) fn add_block_diagonal(patches: &mut [Patch], factors: MatRef<'_, f64>, blocks: &Blocks) {
    debug_assert_eq!(patches.len(), blocks.members.len());
    patches.par_iter_mut().for_each(|patch| {
        let rows = Mat::from_fn(patch.variables.len(), factors.ncols(), |i, j| factors[(patch.variables[i], j)]);
        add_product(patch.covariance.as_mut(), 1.0, rows.as_ref(), rows.transpose());
    });
}

/// How many of the ascending variables are values of the state.
fn on_grid(variables: &[usize], m: usize) -> usize {
    variables.partition_point(|&variable| variable < m)
}
