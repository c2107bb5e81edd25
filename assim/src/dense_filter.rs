//! A dense Kalman filter: the augmented state in its cycle, and an analysis.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::augmented::AugmentedState;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::fixed_lag::{FixedLag, Whitened};
use crate::problem::{Innovations, Problem};
use faer::{Mat, MatRef};
use isobar_model::Duration;
use isobar_obs::ObservationWindow;
use std::marker::PhantomData;

/// What the dense filters differ in.
pub(crate) trait DenseAnalysis: Send {
    /// The increment `[m + p]` of (x, c), with m values of the state, and the normalised innovation squared; the covariance
    /// becomes the analysis's.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]: H P Hᵀ + R is not.
    fn take(covariance: &mut Mat<f64>, m: usize, innovations: &Innovations) -> Result<(Vec<f64>, f64), Error>;
}

/// A Kalman filter on the augmented state s = (x, c) with the whole covariance, and an analysis:
/// [`KalmanFilter`](crate::kalman::KalmanFilter), [`SerialKalmanFilter`](crate::serial_kalman::SerialKalmanFilter).
pub struct DenseFilter<A> {
    pub(crate) augmented: AugmentedState,
    analysis: PhantomData<A>,
}

impl<A> DenseFilter<A> {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: Problem) -> Result<Self, Error> {
        Ok(Self { augmented: AugmentedState::new(problem)?, analysis: PhantomData })
    }

    /// The filter with a fixed-lag smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if it does not fit into the memory limit beside the filter.
    pub fn smoothing(self, lag: usize) -> Result<Self, Error> {
        Ok(Self { augmented: self.augmented.smoothing(lag)?, ..self })
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.augmented.covariance.as_ref()
    }
}

impl<A: DenseAnalysis> Assimilator for DenseFilter<A> {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.augmented.forecast(window)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let AugmentedState { problem, state, bias, covariance, smoother, .. } = &mut self.augmented;
        let (innovations, m) = (problem.innovations(observed, state, bias)?, state.values().len());
        let for_smoother =
            smoother.as_ref().map(|_| Whitened::new(covariance.as_ref(), m, &innovations)).transpose()?;
        let (increment, innovation_chi2) = A::take(covariance, m, &innovations)?;
        self.augmented.add(&increment);
        self.augmented.smooth(for_smoother);
        let estimate = self.augmented.estimate()?;
        self.augmented.problem.resolved_analysis(observed, innovations, estimate, innovation_chi2)
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.augmented.covariance_column(unknown)
    }

    fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.augmented.set_calibration(estimate, covariance)
    }

    fn smoother_lag(&self) -> Option<usize> {
        self.augmented.smoother.as_ref().map(FixedLag::lag)
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        self.augmented.smoothed(analyses_ago)
    }

    fn set_error_factor(&mut self, factor: f64) -> Result<(), Error> {
        self.augmented.model_error_factor = factor;
        Ok(())
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
