//! The covariance of innovations, as a dense matrix.

use crate::error::Error;
use crate::linalg::{cholesky, column, entries, entries_mut, solved_lower, squared_norm};
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use isobar_model::vector::axpy;
use rayon::prelude::*;

/// The covariance H P Hᵀ + R of innovations.
pub(crate) struct InnovationCovariance {
    /// P Hᵀ, `[m + p, n]`.
    pub cross: Mat<f64>,
    /// L with L Lᵀ = H P Hᵀ + R, `[n, n]`.
    pub root: Mat<f64>,
}

impl InnovationCovariance {
    /// From the background's P, `[m + p, m + p]`.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`].
    pub fn new(p: MatRef<'_, f64>, d: &Innovations) -> Result<Self, Error> {
        let n = d.len();
        let mut cross = Mat::zeros(p.nrows(), n);
        let mut covariance = Mat::zeros(n, n);
        cross.par_col_iter_mut().zip(covariance.par_col_iter_mut()).enumerate().for_each(|(j, (cross, covariance))| {
            let (cross, covariance) = (entries_mut(cross), entries_mut(covariance));
            d.row(j).for_each(|(column, weight)| axpy(weight, entries(p.col(column)), cross));
            for i in j..n {
                covariance[i] = d.row(i).map(|(column, weight)| weight * cross[column]).sum();
            }
            covariance[j] += d.variance[j];
        });
        let root = cholesky(covariance, || "the innovation covariance H P H' + R".into())?;
        Ok(Self { cross, root })
    }

    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    pub fn normalised_square(&self, departures: &[f64]) -> f64 {
        squared_norm(solved_lower(self.root.as_ref(), column(departures)).col_as_slice(0))
    }
}
