//! Covariances B and Q as operators U Uᵀ: never formed as matrices unless a method asks for one.

mod balanced;
mod gaussian_filter;
mod leading_factors;
mod sum;
mod univariate;
mod white;

pub use balanced::{Balanced, BalancedParameters};
pub use leading_factors::leading_factors;
pub(crate) use leading_factors::principal_rotation;
pub use sum::Sum;
pub use univariate::Univariate;
pub use white::White;

use crate::linalg::add_symmetric_product;
use faer::{Mat, MatRef};
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

    /// δx += U χ.
    fn root_add(&self, control: &[f64], increment: &mut [f64]);

    /// χ += Uᵀ δx.
    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]);
}

/// U Uᵀ δx.
pub fn multiply(covariance: &dyn Covariance, increment: &[f64]) -> Vec<f64> {
    let mut control = vec![0.0; covariance.control_len()];
    covariance.root_transpose_add(increment, &mut control);
    let mut result = vec![0.0; covariance.len()];
    covariance.root_add(&control, &mut result);
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
    let roots: Vec<Vec<f64>> = indices
        .par_iter()
        .map(|&index| {
            let mut unit = vec![0.0; covariance.len()];
            unit[index] = 1.0;
            let mut control = vec![0.0; covariance.control_len()];
            covariance.root_transpose_add(&unit, &mut control);
            control
        })
        .collect();
    let controls = covariance.control_len();
    let flat: Vec<f64> = roots.concat();
    let root = MatRef::from_column_major_slice(&flat, controls, indices.len());
    let mut result = Mat::zeros(indices.len(), indices.len());
    add_symmetric_product(result.as_mut(), 1.0, root.transpose(), root);
    result
}

/// The whole covariance matrix, `[len, len]`; for small grids.
pub fn dense(covariance: &dyn Covariance) -> Mat<f64> {
    block(covariance, &(0..covariance.len()).collect::<Vec<_>>())
}
