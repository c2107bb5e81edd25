//! The dense (extended) Kalman filter with one observation at a time: no matrix of the size of the observations.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::augmented::{AugmentedState, entries};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::linalg::{for_each_chunk, mirror_lower};
use crate::problem::{Innovations, Problem};
use faer::{Mat, MatMut, MatRef};
use isobar_model::Duration;
use isobar_obs::ObservationWindow;

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
pub struct SerialKalmanFilter {
    augmented: AugmentedState,
}

impl SerialKalmanFilter {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: Problem) -> Result<Self, Error> {
        Ok(Self { augmented: AugmentedState::new(problem)? })
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.augmented.covariance.as_ref()
    }

    /// The increment δ and the normalised innovation squared; P becomes that of the analysis.
    fn take(&mut self, innovations: &Innovations) -> Result<(Vec<f64>, f64), Error> {
        let m = self.augmented.state.values().len();
        let covariance = &mut self.augmented.covariance;
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

impl Assimilator for SerialKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.augmented.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let AugmentedState { problem, state, bias, .. } = &self.augmented;
        let innovations = problem.innovations(observed, state, bias)?;
        let (increment, innovation_chi2) = self.take(&innovations)?;
        self.augmented.add(&increment);
        let estimate = self.augmented.estimate()?;
        Ok(self.augmented.problem.analysis(observed, innovations, estimate, innovation_chi2))
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.augmented.covariance_column(unknown)
    }

    fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.augmented.set_calibration(estimate, covariance)
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        self.augmented.save()
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        self.augmented.restore(saved)
    }

    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        self.augmented.calibration_accuracy()
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.augmented.widen_calibration(covariance);
        Ok(())
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
