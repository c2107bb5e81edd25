//! The dense (extended) Kalman filter on the augmented state s = (x, c): the reference for every other method.

use crate::augmented::entries;
use crate::dense_filter::{DenseAnalysis, DenseFilter};
use crate::error::Error;
use crate::linalg::{
    add_product, add_symmetric_product, cholesky, column, product, solve_lower_transposed, solved_lower, squared_norm,
};
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use isobar_obs::Jacobian;

/// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`; analysis in gain form,
/// `K = P Hᵀ (H P Hᵀ + R)⁻¹`, with the covariance in Joseph's form `(I − K H) P (I − K H)ᵀ + K R Kᵀ`.
pub type KalmanFilter = DenseFilter<AllAtOnce>;

/// The analysis of the [`KalmanFilter`].
pub struct AllAtOnce;

impl DenseAnalysis for AllAtOnce {
    fn take(covariance: &mut Mat<f64>, m: usize, innovations: &Innovations) -> Result<(Vec<f64>, f64), Error> {
        let innovation = InnovationCovariance::new(covariance.as_ref(), innovations, m)?;
        let innovation_chi2 = innovation.normalised_square(&innovations.departures);
        let Innovations { departures, jacobian, variance } = innovations;
        let InnovationCovariance { cross, root } = innovation;
        let mut transposed_gain = solved_lower(root.as_ref(), cross.transpose().to_owned());
        solve_lower_transposed(root.as_ref(), transposed_gain.as_mut());
        let gain = transposed_gain.transpose();
        let increment = product(gain, column(departures).as_ref());
        update_covariance(covariance, m, cross, gain, jacobian, variance);
        Ok((increment.col_as_slice(0).to_vec(), innovation_chi2))
    }
}

/// Joseph's form in two rank-n steps: P ← P − K (H P), then P ← P − (P Hᵀ) Kᵀ + K R Kᵀ.
fn update_covariance(
    p: &mut Mat<f64>,
    m: usize,
    cross: Mat<f64>,
    gain: MatRef<'_, f64>,
    jacobian: &Jacobian,
    variance: &[f64],
) {
    add_product(p.as_mut(), -1.0, gain, cross.transpose());
    // p is now (I − K H) P; left is −(I − K H) P Hᵀ + K R.
    let mut left = Mat::zeros(p.nrows(), variance.len());
    for (row, &variance) in variance.iter().enumerate() {
        let target = left.col_as_slice_mut(row);
        for (column, weight) in entries(jacobian, row, m) {
            for (value, p) in target.iter_mut().zip(p.col_as_slice(column)) {
                *value -= weight * p;
            }
        }
        for (i, value) in target.iter_mut().enumerate() {
            *value += variance * gain[(i, row)];
        }
    }
    add_symmetric_product(p.as_mut(), 1.0, left.as_ref(), gain.transpose());
}

/// dᵀ (H P Hᵀ + R)⁻¹ d; the state has `m` values.
pub(crate) fn normalised_innovation_squared(
    covariance: MatRef<'_, f64>,
    innovations: &Innovations,
    m: usize,
) -> Result<f64, Error> {
    Ok(InnovationCovariance::new(covariance, innovations, m)?.normalised_square(&innovations.departures))
}

/// The covariance H P Hᵀ + R of the innovations.
pub(crate) struct InnovationCovariance {
    /// P Hᵀ, `[m + p, n]`.
    pub cross: Mat<f64>,
    /// The Cholesky factor of H P Hᵀ + R, `[n, n]`.
    pub root: Mat<f64>,
}

impl InnovationCovariance {
    /// From the background's P, `[m + p, m + p]`; the state has `m` values.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`].
    pub fn new(covariance: MatRef<'_, f64>, innovations: &Innovations, m: usize) -> Result<Self, Error> {
        let cross = cross_covariance(covariance, &innovations.jacobian, m);
        let root = innovation_root(cross.as_ref(), &innovations.jacobian, &innovations.variance, m)?;
        Ok(Self { cross, root })
    }

    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    fn normalised_square(&self, departures: &[f64]) -> f64 {
        squared_norm(solved_lower(self.root.as_ref(), column(departures)).col_as_slice(0))
    }
}

/// P Hᵀ for a symmetric P, `[m + p, n]`.
fn cross_covariance(covariance: MatRef<'_, f64>, jacobian: &Jacobian, m: usize) -> Mat<f64> {
    let mut cross = Mat::zeros(covariance.nrows(), jacobian.rows());
    for row in 0..jacobian.rows() {
        for (column, weight) in entries(jacobian, row, m) {
            let source = covariance.col(column).try_as_col_major().expect("columns are contiguous").as_slice();
            for (value, source) in cross.col_as_slice_mut(row).iter_mut().zip(source) {
                *value += weight * source;
            }
        }
    }
    cross
}

/// The Cholesky factor of H P Hᵀ + R, from P Hᵀ.
///
/// # Errors
/// [`Error::NotPositiveDefinite`].
fn innovation_root(cross: MatRef<'_, f64>, jacobian: &Jacobian, variance: &[f64], m: usize) -> Result<Mat<f64>, Error> {
    let n = variance.len();
    let innovation_covariance = Mat::from_fn(n, n, |i, j| {
        let covariance: f64 = entries(jacobian, i, m).map(|(column, weight)| weight * cross[(column, j)]).sum();
        covariance + if i == j { variance[i] } else { 0.0 }
    });
    cholesky(innovation_covariance, || "the innovation covariance H P H' + R".into())
}
