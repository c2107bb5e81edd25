//! The dense (extended) Kalman filter with one observation at a time: no matrix of the size of the observations.

use crate::augmented::entries;
use crate::dense_filter::{DenseAnalysis, DenseFilter};
use crate::error::Error;
use crate::linalg::{for_each_chunk, mirror_lower};
use crate::problem::Innovations;
use faer::{Mat, MatMut};

/// The Kalman filter of [`crate::kalman`], whose analysis takes one observation after the other: where their errors are
/// uncorrelated, each is a scalar measurement of what the ones before have left (Bierman 1977, Factorization Methods for
/// Discrete Sequential Estimation, chapter II; Maybeck 1979, Stochastic Models, Estimation and Control 1, section 5.3).
/// With the row h of H, the variance r, and P and δ as they stand,
///
/// ```text
/// v = P h        α = hᵀ v + r        δ ← δ + v (d − hᵀ δ)/α        P ← P − v vᵀ/α
/// ```
///
/// The α are the squared pivots of H P Hᵀ + R in LDLᵀ form, so Σ (d − hᵀ δ)²/α is the normalised innovation squared. Each
/// observation costs one sweep over half of P, n (m + p)² in all; nothing is cubic in n. One linearisation, about the
/// background, serves all observations of a cycle: the analysis is that of [`crate::kalman`] to rounding.
///
/// The downdate of one triangle keeps P symmetric, and α > hᵀ v keeps it positive as far as the rounding of its entries
/// allows: to r = 10⁻¹⁴ hᵀ P h in tests, where Joseph's form in two steps (Bierman's stabilised update) is already lost.
pub type SerialKalmanFilter = DenseFilter<OneByOne>;

/// The analysis of the [`SerialKalmanFilter`].
pub struct OneByOne;

impl DenseAnalysis for OneByOne {
    fn take(covariance: &mut Mat<f64>, m: usize, innovations: &Innovations) -> Result<(Vec<f64>, f64), Error> {
        let mut increment = vec![0.0; covariance.nrows()];
        let mut chi2 = 0.0;
        let (n, mut h) = (innovations.departures.len(), Vec::new());
        for (row, (&departure, &variance)) in innovations.departures.iter().zip(&innovations.variance).enumerate() {
            h.clear();
            h.extend(entries(&innovations.jacobian, row, m));
            let v = multiply_lower(covariance, &h);
            let alpha = dot(&h, &v) + variance;
            if !(alpha > 0.0 && alpha.is_finite()) {
                let matrix = "the innovation covariance H P H' + R".into();
                return Err(Error::NotPositiveDefinite { matrix, pivot: row, size: n });
            }
            let innovation = departure - dot(&h, &increment);
            increment.iter_mut().zip(&v).for_each(|(value, v)| *value += v * (innovation / alpha));
            chi2 += innovation * innovation / alpha;
            downdate_lower(covariance.as_mut(), &v, alpha);
        }
        mirror_lower(covariance.as_mut());
        Ok((increment, chi2))
    }
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
            let factor = v[j] / alpha;
            column[j..].iter_mut().zip(&v[j..]).for_each(|(p, v)| *p -= v * factor);
        }
    });
}

/// hᵀ x.
fn dot(h: &[(usize, f64)], x: &[f64]) -> f64 {
    h.iter().map(|&(index, weight)| weight * x[index]).sum()
}
