//! The covariance of (b, c) in the form blkdiag(C_1 … C_K, 0) + Φ Φᵀ.

use crate::linalg::product;
use faer::Mat;

/// The block-diagonal part's covariance of some variables.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    /// Numbers of the block variables.
    pub variables: Vec<usize>,
    /// C_k, `[variables, variables]`.
    pub covariance: Mat<f64>,
}

/// Cov(b, c): patches that together hold every block variable once, and common factors.
#[derive(Clone, Debug)]
pub(super) struct FactoredCovariance {
    /// C_1 … C_K.
    pub patches: Vec<Patch>,
    /// Φ_b, `[block variables, r]`.
    pub block_factors: Mat<f64>,
    /// Φ_c, `[shared parameters, r]`.
    pub shared_factors: Mat<f64>,
}

impl FactoredCovariance {
    /// The variances of the block variables.
    pub fn block_variances(&self) -> Vec<f64> {
        let mut variances = squared_rows(&self.block_factors);
        for patch in &self.patches {
            for (position, &variable) in patch.variables.iter().enumerate() {
                variances[variable] += patch.covariance[(position, position)];
            }
        }
        variances
    }

    /// The variances of the shared parameters.
    pub fn shared_variances(&self) -> Vec<f64> {
        squared_rows(&self.shared_factors)
    }

    /// The whole matrix, `[block variables + shared parameters]²`, for tests and queries on small problems.
    pub fn dense(&self) -> Mat<f64> {
        let (b, c) = (self.block_factors.nrows(), self.shared_factors.nrows());
        let factors = Mat::from_fn(b + c, self.block_factors.ncols(), |i, j| {
            if i < b { self.block_factors[(i, j)] } else { self.shared_factors[(i - b, j)] }
        });
        let mut dense = product(factors.as_ref(), factors.transpose());
        for patch in &self.patches {
            for (j, &column) in patch.variables.iter().enumerate() {
                for (i, &row) in patch.variables.iter().enumerate() {
                    dense[(row, column)] += patch.covariance[(i, j)];
                }
            }
        }
        dense
    }
}

/// Σ_j Φ_ij² for each row i.
fn squared_rows(factors: &Mat<f64>) -> Vec<f64> {
    let mut sums = vec![0.0; factors.nrows()];
    for j in 0..factors.ncols() {
        for (sum, value) in sums.iter_mut().zip(factors.col_as_slice(j)) {
            *sum += value * value;
        }
    }
    sums
}
