//! The analysis of the dense Kalman filter with one observation at a time: no matrix of the size of the observations. The
//! equations are those of [`KalmanFilter`](super::dense::KalmanFilter).

use crate::error::Error;
use crate::linalg::{for_each_chunk, mirror_lower};
use crate::problem::Innovations;
use faer::{Mat, MatMut};
use isobar_model::vector::{axpy, sparse_dot};

/// Takes the observations into P; returns K d, `[m + p]`, and dᵀ (H P Hᵀ + R)⁻¹ d.
///
/// # Errors
/// [`Error::NotPositiveDefinite`]: H P Hᵀ + R is not.
pub(super) fn analyse(p: &mut Mat<f64>, d: &Innovations) -> Result<(Vec<f64>, f64), Error> {
    let (mut increment, mut chi2, mut h) = (vec![0.0; p.nrows()], 0.0, Vec::new());
    for row in 0..d.len() {
        h.clear();
        h.extend(d.row(row));
        let v = multiply_lower(p, &h);
        let alpha = sparse_dot(&h, &v) + d.variance[row];
        if !(alpha > 0.0 && alpha.is_finite()) {
            let matrix = "the innovation covariance H P H' + R".into();
            return Err(Error::NotPositiveDefinite { matrix, pivot: row, size: d.len() });
        }
        let innovation = d.departures[row] - sparse_dot(&h, &increment);
        axpy(innovation / alpha, &v, &mut increment);
        chi2 += innovation * innovation / alpha;
        downdate_lower(p.as_mut(), &v, alpha);
    }
    mirror_lower(p.as_mut());
    Ok((increment, chi2))
}

/// P h for a symmetric P, whose lower triangle is read.
fn multiply_lower(p: &Mat<f64>, h: &[(usize, f64)]) -> Vec<f64> {
    (0..p.nrows()).map(|i| h.iter().map(|&(j, weight)| weight * p[(i.max(j), i.min(j))]).sum()).collect()
}

/// P ← P − v vᵀ/α in the lower triangle.
fn downdate_lower(p: MatMut<'_, f64>, v: &[f64], alpha: f64) {
    for_each_chunk(p, 0, &|first, chunk| {
        for (j, column) in (first..).zip(chunk.col_iter_mut()) {
            let column = column.try_as_col_major_mut().expect("columns are contiguous").as_slice_mut();
            axpy(-(v[j] / alpha), &v[j..], &mut column[j..]);
        }
    });
}
