//! State and calibration whose errors are taken to be uncorrelated with each other: what the methods with a static
//! covariance of the state share.

use crate::assimilator::{CalibrationAdjustment, WidenCalibration};
use crate::augmented::Augmented;
use crate::calibration_accuracy::{CalibrationAccuracy, CalibrationErrors};
use crate::calibration_drift::drift;
use crate::error::Error;
use crate::estimate::Estimate;
use crate::memory::{Matrix, require};
use crate::problem::{Problem, steps};
use crate::spread::standard_deviations;
use faer::{Mat, MatRef};
use isobar_model::vector::add;
use isobar_model::{Duration, Model, forecast};
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};

/// An estimate of s = (x, c) with the covariance of the calibration's errors alone.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct CalibratedState {
    /// The parameters that are estimated, c.
    calibration: Calibration,
    pub s: Augmented,
    /// P_c, `[p, p]`.
    pub bias_covariance: Matrix,
}

impl CalibratedState {
    /// The background, with the parameters' priors.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the covariance of the parameters does not fit into the memory limit.
    pub fn new<M: ?Sized>(problem: &Problem<M>) -> Result<Self, Error> {
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        problem.require_memory((p as f64).powi(2), || format!("the covariance of {p} biases"))?;
        let bias_covariance = Matrix(Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j)));
        Ok(Self { calibration, s: Augmented::background(problem), bias_covariance })
    }

    /// p, the number of parameters that are estimated.
    pub fn parameters(&self) -> usize {
        self.calibration.len()
    }

    /// Forecasts the state and the parameters.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn forecast(&mut self, model: &dyn Model, window: Duration) -> Result<(), Error> {
        forecast::forecast(model, &mut self.s.state, steps(model, window)?)?;
        self.drift(window);
        Ok(())
    }

    /// Forecasts the parameters: c ← φ c, P_c ← φ P_c φ + Q_c.
    pub fn drift(&mut self, time: Duration) {
        let kept = drift(&self.calibration, time, self.bias_covariance.as_mut());
        self.s.decay(&kept);
    }

    /// x ← x + δx, c ← c + δc.
    pub fn add(&mut self, state_increment: &[f64], bias_increment: &[f64]) {
        add(self.s.state.values_mut(), state_increment);
        add(&mut self.s.bias[..bias_increment.len()], bias_increment);
    }

    /// The estimate as it stands, with a spread of the state if the method claims one.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if P_c is no longer a covariance.
    pub fn estimate(&self, state_spread: Option<Vec<f64>>) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.parameters()).map(|i| self.bias_covariance[(i, i)]).collect();
        let spread = standard_deviations(&variances, "the covariance of the calibration parameters", |i| {
            self.calibration.parameters[i].name.clone()
        })?;
        Ok(Estimate {
            state: self.s.state.clone(),
            calibration: self.s.bias.clone(),
            state_spread,
            calibration_spread: (!self.calibration.is_empty()).then_some(spread),
        })
    }

    /// Its view of P_c, unless nothing is estimated.
    pub fn view(&self) -> Option<&dyn CalibrationErrors> {
        (self.parameters() > 0).then_some(self)
    }

    /// P_c to be changed, unless nothing is estimated.
    pub fn adjustment(&mut self) -> Option<CalibrationAdjustment<'_>> {
        (self.parameters() > 0).then_some(CalibrationAdjustment::Widen(self))
    }

    /// Fails if `self` is of another experiment than `like`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require_like(&self, like: &CalibratedState) -> Result<(), Error> {
        self.s.require_like(&like.s)?;
        let p = like.parameters();
        let fits = self.calibration == like.calibration && self.bias_covariance.has_shape(p, p);
        require(fits, "the covariance of the calibration")
    }
}

impl CalibrationErrors for CalibratedState {
    fn calibration_accuracy(&self) -> CalibrationAccuracy {
        CalibrationAccuracy::new(self.bias_covariance.0.clone(), self.parameters())
    }
}

impl WidenCalibration for CalibratedState {
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        *self.bias_covariance += covariance;
        Ok(())
    }
}
