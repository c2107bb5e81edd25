//! State and calibration whose errors are taken to be uncorrelated with each other: what the methods with a static
//! covariance of the state share.

use crate::assimilator::Estimate;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::error::Error;
use crate::problem::Problem;
use crate::saved::{Matrix, restore_bias, restore_state};
use crate::spread::standard_deviations;
use faer::Mat;
use isobar_model::{Duration, State, forecast};
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};

/// An estimate of (x, c) with the covariance of the calibration's errors alone.
#[derive(Clone)]
pub(crate) struct CalibratedState {
    /// The parameters that are estimated, c.
    calibration: Calibration,
    pub state: State,
    /// All parameters of the experiment.
    pub bias: Vec<f64>,
    /// P_c, `[p, p]`.
    pub bias_covariance: Mat<f64>,
}

/// What a checkpoint holds of it.
#[derive(Serialize, Deserialize)]
pub(crate) struct SavedCalibratedState {
    state: Vec<f64>,
    bias: Vec<f64>,
    bias_covariance: Matrix,
}

impl CalibratedState {
    /// The background, with the parameters' priors.
    pub fn new(problem: &Problem) -> Self {
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        let bias_covariance = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        let (state, bias) = (problem.background.clone(), vec![0.0; problem.calibration.len()]);
        Self { calibration, state, bias, bias_covariance }
    }

    /// p, the number of parameters that are estimated.
    pub fn parameters(&self) -> usize {
        self.calibration.len()
    }

    /// P_c, unless nothing is estimated.
    pub fn accuracy(&self) -> Option<CalibrationAccuracy> {
        (self.parameters() > 0).then(|| CalibrationAccuracy::new(self.bias_covariance.clone(), self.parameters()))
    }

    /// Forecasts the state; the parameters persist but for their random walks.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn forecast(&mut self, problem: &Problem, window: Duration) -> Result<(), Error> {
        forecast::forecast(&*problem.model, &mut self.state, problem.steps(window)?)?;
        self.drift(window);
        Ok(())
    }

    /// Adds the parameters' random walks over a time to P_c.
    pub fn drift(&mut self, time: Duration) {
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            self.bias_covariance[(i, i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * time.days();
        }
    }

    /// x ← x + δx, c ← c + δc.
    pub fn add(&mut self, state_increment: &[f64], bias_increment: &[f64]) {
        self.state.values_mut().iter_mut().zip(state_increment).for_each(|(value, change)| *value += change);
        self.bias.iter_mut().zip(bias_increment).for_each(|(value, change)| *value += change);
    }

    /// The estimate as it stands, with a spread of the state if the method claims one.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if P_c has lost its meaning.
    pub fn estimate(&self, state_spread: Option<Vec<f64>>) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.parameters()).map(|i| self.bias_covariance[(i, i)]).collect();
        let spread = standard_deviations(&variances, "the covariance of the calibration parameters", |i| {
            self.calibration.parameters[i].name.clone()
        })?;
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread,
            calibration_spread: (!self.calibration.is_empty()).then_some(spread),
        })
    }

    pub fn saved(&self) -> SavedCalibratedState {
        SavedCalibratedState {
            state: self.state.values().to_vec(),
            bias: self.bias.clone(),
            bias_covariance: (&self.bias_covariance).into(),
        }
    }

    /// Takes back what [`CalibratedState::saved`] gave.
    ///
    /// # Errors
    /// [`Error::Saved`] if it is of another experiment.
    pub fn restore(&mut self, saved: SavedCalibratedState) -> Result<(), Error> {
        restore_state(&mut self.state, &saved.state)?;
        restore_bias(&mut self.bias, &saved.bias)?;
        let p = self.parameters();
        self.bias_covariance = saved.bias_covariance.restored(p, Some(p), "the covariance of the calibration")?;
        Ok(())
    }
}
