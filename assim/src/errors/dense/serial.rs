//! The analysis of the dense Kalman filter with one observation at a time: no matrix of the size of the observations. The
//! equations are those of [`KalmanFilter`](super::KalmanFilter).
//!
//! P is updated once for every [`DELAYED`] observations instead of once for each: in between, the pending downdates `w wᵀ`,
//! w = v/√α, are subtracted from each product with P instead, `P h − Σ w (wᵀ h)`.

use crate::error::Error;
use crate::linalg::{add_lower_product, entries, entries_mut, mirror_lower};
use crate::problem::Innovations;
use faer::Mat;
use isobar_model::vector::{axpy, scale, sparse_dot};

/// Observations whose downdates of P are applied together.
pub(super) const DELAYED: usize = 64;

/// Takes the observations into P; returns K d, `[m + p]`, and dᵀ (H P Hᵀ + R)⁻¹ d.
///
/// # Errors
/// [`Error::NotPositiveDefinite`]: H P Hᵀ + R is not.
pub(super) fn analyse(p: &mut Mat<f64>, d: &Innovations) -> Result<(Vec<f64>, f64), Error> {
    let (mut increment, mut chi2, mut h) = (vec![0.0; p.nrows()], 0.0, Vec::new());
    let mut w = Mat::zeros(p.nrows(), DELAYED.min(d.len()));
    for first in (0..d.len()).step_by(DELAYED) {
        let count = DELAYED.min(d.len() - first);
        for number in 0..count {
            let row = first + number;
            h.clear();
            h.extend(d.row(row));
            let (earlier, own) = w.as_mut().get_mut(.., ..number + 1).split_at_col_mut(number);
            let v = entries_mut(own.col_mut(0));
            multiply_lower(p, &h, v);
            for w in earlier.as_ref().col_iter() {
                let w = entries(w);
                axpy(-sparse_dot(&h, w), w, v);
            }
            let alpha = sparse_dot(&h, v) + d.variance[row];
            if !(alpha > 0.0 && alpha.is_finite()) {
                let matrix = "the innovation covariance H P H' + R".into();
                return Err(Error::NotPositiveDefinite { matrix, pivot: row, size: d.len() });
            }
            let innovation = d.departures[row] - sparse_dot(&h, &increment);
            axpy(innovation / alpha, v, &mut increment);
            chi2 += innovation * innovation / alpha;
            scale(v, alpha.sqrt().recip());
        }
        let w = w.as_ref().get(.., ..count);
        add_lower_product(p.as_mut(), -1.0, w, w.transpose());
    }
    mirror_lower(p.as_mut());
    Ok((increment, chi2))
}

/// v = P h for a symmetric P, whose lower triangle is read.
fn multiply_lower(p: &Mat<f64>, h: &[(usize, f64)], v: &mut [f64]) {
    v.fill(0.0);
    for &(j, weight) in h {
        (0..j).for_each(|i| v[i] += weight * p[(j, i)]);
        axpy(weight, &p.col_as_slice(j)[j..], &mut v[j..]);
    }
}
