//! Covariances B and Q as operators U Uᵀ: never formed as matrices unless a method asks for one.

mod balanced;
mod correlation_function;
mod homogeneous_filter;
mod leading_factors;
mod localized_ensemble;
mod spectrum;
mod sum;
mod taper;
mod univariate;
mod white;

pub use balanced::{Balanced, BalancedParameters};
pub use correlation_function::CorrelationFunction;
pub use leading_factors::leading_factors;
pub(crate) use leading_factors::{OVERSAMPLING, leading_columns, skip_draws};
pub use localized_ensemble::LocalizedEnsemble;
pub use spectrum::Spectrum;
pub use sum::Sum;
pub use taper::gaspari_cohn;
pub(crate) use taper::{WIDEST, is_wide};
pub use univariate::Univariate;
pub use white::White;

use crate::linalg::mirror_lower;
use faer::prelude::ReborrowMut;
use faer::{Mat, MatMut};
use isobar_model::Layout;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// A covariance of increments in the form U Uᵀ, with χ ~ N(0, I) as control vector: δx = U χ.
pub trait Covariance: Send + Sync {
    /// Number of values of an increment.
    fn len(&self) -> usize;

    /// Whether increments have no values.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length of the control vector χ.
    fn control_len(&self) -> usize;

    /// The cell of the grid where each value of the control vector stands; `None` if U is no local operator.
    fn control_cells(&self) -> Option<Vec<usize>> {
        None
    }

    /// Its spectrum with each value divided by its scale; `None` if it takes the whole matrix to know it.
    fn spectrum(&self, _scales: &[f64]) -> Option<Spectrum> {
        None
    }

    /// δx += U χ.
    fn root_add(&self, control: &[f64], increment: &mut [f64]);

    /// χ += Uᵀ δx.
    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]);

    /// y += U Uᵀ δx; provided by way of the control vector.
    fn multiply_add(&self, increment: &[f64], result: &mut [f64]) {
        let mut control = vec![0.0; self.control_len()];
        self.root_transpose_add(increment, &mut control);
        self.root_add(&control, result);
    }

    /// The covariance (U Uᵀ)ᵢⱼ of two values.
    ///
    /// As provided it applies Uᵀ to two unit vectors, which costs as much as two whole increments; an operator that
    /// knows its entries says them at once. A filter asks for those of every block.
    fn covariance(&self, first: usize, second: usize) -> f64 {
        let row = |index: usize| {
            let mut unit = vec![0.0; self.len()];
            unit[index] = 1.0;
            let mut control = vec![0.0; self.control_len()];
            self.root_transpose_add(&unit, &mut control);
            control
        };
        row(first).iter().zip(row(second)).map(|(first, second)| first * second).sum()
    }
}

/// U Uᵀ δx.
pub fn multiply(covariance: &dyn Covariance, increment: &[f64]) -> Vec<f64> {
    let mut result = vec![0.0; covariance.len()];
    covariance.multiply_add(increment, &mut result);
    result
}

/// A draw from N(0, U Uᵀ).
pub fn randomize(covariance: &dyn Covariance, stream: &mut ChaCha8Rng) -> Vec<f64> {
    let control = isobar_model::random::standard_normals(stream, covariance.control_len());
    let mut increment = vec![0.0; covariance.len()];
    covariance.root_add(&control, &mut increment);
    increment
}

/// The covariance of the values at `indices` among each other, `[n, n]`.
pub fn block(covariance: &dyn Covariance, indices: &[usize]) -> Mat<f64> {
    let mut block = Mat::zeros(indices.len(), indices.len());
    fill_block(block.as_mut(), covariance, indices, 1.0);
    block
}

/// Fills a matrix `[n, n]` with the covariance of the values at `indices` among each other, multiplied by a factor.
fn fill_block(mut target: MatMut<'_, f64>, covariance: &dyn Covariance, indices: &[usize], factor: f64) {
    target.rb_mut().par_col_iter_mut().enumerate().for_each(|(j, mut column)| {
        for (i, &row) in indices.iter().enumerate().skip(j) {
            column[i] = factor * covariance.covariance(row, indices[j]);
        }
    });
    mirror_lower(target);
}

/// The standard deviation of each variable in the middle of the domain, for every value of the state; 1 where it is 0.
pub fn middle_deviations(covariance: &dyn Covariance, layout: &Layout) -> Vec<f64> {
    let (cells, grid) = (layout.grid.cells(), &layout.grid);
    let middle = grid.ny / 2 * grid.nx + grid.nx / 2;
    let scale = |variable: usize| {
        let variance = covariance.covariance(variable * cells + middle, variable * cells + middle);
        if variance > 0.0 { variance.sqrt() } else { 1.0 }
    };
    (0..layout.variables.len()).flat_map(|variable| std::iter::repeat_n(scale(variable), cells)).collect()
}

/// The standard deviation of every value.
pub fn standard_deviations(covariance: &dyn Covariance) -> Vec<f64> {
    (0..covariance.len()).into_par_iter().map(|index| covariance.covariance(index, index).sqrt()).collect()
}

/// The whole covariance matrix, `[len, len]`; for small grids.
pub fn dense(covariance: &dyn Covariance) -> Mat<f64> {
    let mut dense = Mat::zeros(covariance.len(), covariance.len());
    fill_dense(dense.as_mut(), covariance, 1.0);
    dense
}

/// Fills a matrix `[len, len]` with the whole covariance, multiplied by a factor.
pub(crate) fn fill_dense(target: MatMut<'_, f64>, covariance: &dyn Covariance, factor: f64) {
    fill_block(target, covariance, &(0..covariance.len()).collect::<Vec<_>>(), factor);
}
