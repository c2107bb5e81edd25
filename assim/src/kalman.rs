//! The dense (extended) Kalman filter on the augmented state s = (x, c): the reference for every other method.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::augmented::{AugmentedState, entries};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::linalg::{
    add_product, add_symmetric_product, cholesky, column, product, solve_lower, solve_lower_transposed, squared_norm,
};
use crate::problem::Problem;
use faer::{Mat, MatRef};
use isobar_model::Duration;
use isobar_obs::{BlockAngular, ObservationWindow};

/// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`; analysis in gain form,
/// `K = P Hᵀ (H P Hᵀ + R)⁻¹`, with the covariance in Joseph's form `(I − K H) P (I − K H)ᵀ + K R Kᵀ`.
pub struct KalmanFilter {
    augmented: AugmentedState,
}

impl KalmanFilter {
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
}

impl Assimilator for KalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.augmented.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let AugmentedState { problem, state, bias, covariance, .. } = &self.augmented;
        let innovations = problem.innovations(observed, state, bias)?;
        let (departures, jacobian, variance) = (&innovations.departures, &innovations.jacobian, &innovations.variance);
        let m = state.values().len();
        let cross = cross_covariance(covariance.as_ref(), jacobian, m);
        let root = cholesky(innovation_covariance(cross.as_ref(), jacobian, variance, m), || {
            "the innovation covariance H P H' + R".into()
        })?;
        let mut whitened = column(departures);
        solve_lower(root.as_ref(), whitened.as_mut());
        let innovation_chi2 = squared_norm(whitened.col_as_slice(0));
        let mut transposed_gain = cross.transpose().to_owned();
        solve_lower(root.as_ref(), transposed_gain.as_mut());
        solve_lower_transposed(root.as_ref(), transposed_gain.as_mut());
        let gain = transposed_gain.transpose();
        let increment = product(gain, column(departures).as_ref());
        self.augmented.add(increment.col_as_slice(0));
        self.update_covariance(cross, gain, jacobian, variance);
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

impl KalmanFilter {
    /// Joseph's form in two rank-n steps: P ← P − K (H P), then P ← P − (P Hᵀ) Kᵀ + K R Kᵀ.
    fn update_covariance(&mut self, cross: Mat<f64>, gain: MatRef<'_, f64>, jacobian: &BlockAngular, variance: &[f64]) {
        let m = self.augmented.state.values().len();
        let mut p = std::mem::replace(&mut self.augmented.covariance, Mat::zeros(0, 0));
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
        self.augmented.covariance = p;
    }
}

/// P Hᵀ for a symmetric P, `[m + p, n]`.
fn cross_covariance(covariance: MatRef<'_, f64>, jacobian: &BlockAngular, m: usize) -> Mat<f64> {
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

/// H P Hᵀ + R from P Hᵀ.
fn innovation_covariance(cross: MatRef<'_, f64>, jacobian: &BlockAngular, variance: &[f64], m: usize) -> Mat<f64> {
    let n = variance.len();
    Mat::from_fn(n, n, |i, j| {
        let covariance: f64 = entries(jacobian, i, m).map(|(column, weight)| weight * cross[(column, j)]).sum();
        covariance + if i == j { variance[i] } else { 0.0 }
    })
}
