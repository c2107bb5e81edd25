//! What every method is: it forecasts an estimate, and analyses observations.

use crate::block_angular::PartitionReport;
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::spread::standard_deviations;
use crate::structure::Structure;
use faer::MatRef;
use isobar_model::{Duration, State};
use isobar_obs::{Calibration, ObservationWindow};
use serde::{Deserialize, Serialize};

/// How a method treats the observations' biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasTreatment {
    /// The calibration parameters are estimated with the state.
    Estimate,
    /// Biased observations are taken as they are.
    Ignore,
    /// The method is given observations from which the true biases have been removed.
    Known,
}

/// State and calibration as a method believes them to be, with the standard deviations it claims.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The state.
    pub state: State,
    /// The calibration parameters, in the order of [`Calibration`].
    pub calibration: Vec<f64>,
    /// Claimed standard deviation of each value of the state, where the method has one.
    pub state_spread: Option<Vec<f64>>,
    /// Claimed standard deviation of each calibration parameter, where the method has one.
    pub calibration_spread: Option<Vec<f64>>,
}

impl Estimate {
    /// With the standard deviations of the state and of the parameters that are estimated, `[m + p]`.
    pub(crate) fn with_spread(state: State, calibration: Vec<f64>, mut spread: Vec<f64>) -> Self {
        let of_parameters = spread.split_off(state.values().len());
        let calibration_spread = (!of_parameters.is_empty()).then_some(of_parameters);
        Self { state, calibration, state_spread: Some(spread), calibration_spread }
    }

    /// With variances `[m + p]`, the diagonal of a covariance of this name, of the state and of the parameters that are
    /// estimated.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if the covariance has lost its meaning.
    pub(crate) fn with_variances(
        state: State,
        calibration: Vec<f64>,
        estimated: &Calibration,
        variances: &[f64],
        covariance: &str,
    ) -> Result<Self, Error> {
        let m = state.values().len();
        let spread = standard_deviations(variances, covariance, |i| match i < m {
            true => state.layout().describe(i),
            false => estimated.parameters[i - m].name.clone(),
        })?;
        Ok(Self::with_spread(state, calibration, spread))
    }
}

/// What an analysis did with the observations of one cycle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Analysis {
    /// State and calibration after it.
    pub estimate: Estimate,
    /// y − h(background), one per observation.
    pub background_departures: Vec<f64>,
    /// y − h(analysis), one per observation.
    pub analysis_departures: Vec<f64>,
    /// Normalised innovation squared dᵀ (H P Hᵀ + R)⁻¹ d, with expectation equal to the number of observations if
    /// the method's covariances are right; `None` for a method without them.
    pub innovation_chi2: Option<f64>,
    /// How the observations linked blocks, for a method with blocks.
    pub partition: Option<PartitionReport>,
}

/// A data-assimilation method in its cycle.
pub trait Assimilator: Send {
    /// Forecasts over one cycle; the result is the background.
    ///
    /// # Errors
    /// A value that is not finite, or a covariance that is not positive.
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error>;

    /// Analyses the observations, which are valid at the time to which the last forecast led.
    ///
    /// # Errors
    /// As [`Assimilator::forecast`].
    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error>;

    /// The method to which this one adds something. What is asked of this one, by the methods that follow and return nothing
    /// of their own, is asked of that.
    fn inner(&self) -> Option<&dyn Assimilator> {
        None
    }

    /// The method's inner structure after the analysis of `observed`, with at most so many common factors; `None` for a
    /// method without blocks. Nothing else depends on it: it is for viewers, and is computed when they ask.
    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Option<Structure> {
        self.inner()?.structure(observed, factors)
    }

    /// The covariances of one unknown's error with all others as the method has them now, found without the whole matrix;
    /// `None` for a method that carries no covariance, or does not estimate the unknown. Nothing else depends on it.
    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.inner()?.covariance_column(unknown)
    }

    /// What the method has estimated beside state and calibration in the last analysis; most methods nothing.
    fn parameters(&self) -> Vec<EstimatedParameter> {
        self.inner().map_or_else(Vec::new, |inner| inner.parameters())
    }

    /// How many analyses before the newest are revised by it, for a method with a fixed-lag smoother.
    fn smoother_lag(&self) -> Option<usize> {
        self.inner()?.smoother_lag()
    }

    /// State and calibration at the analysis so many before the newest, given all observations so far; `None` if there was
    /// none, or it is beyond [`Assimilator::smoother_lag`]. That of the newest one is its own.
    ///
    /// # Errors
    /// A covariance that is not positive.
    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        self.inner().map_or(Ok(None), |inner| inner.smoothed(analyses_ago))
    }

    /// Takes over a calibration, `[p]` with covariance `[p, p]`, whose errors are independent of the state's, in place of
    /// what the method believed of it.
    ///
    /// # Errors
    /// [`Error::Setting`] if the method cannot; a covariance that is not positive definite.
    fn set_calibration(&mut self, _estimate: &[f64], _covariance: MatRef<'_, f64>) -> Result<(), Error> {
        Err(Error::Setting("this method cannot start from another calibration than the parameters' priors".into()))
    }

    /// What the method claims to know of the calibration parameters, and of the state's means with them; `None` for one
    /// that does not estimate them.
    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        self.inner()?.calibration_accuracy()
    }

    /// Adds an independent error with this covariance, `[p, p]`, to those of the calibration parameters: a sensor that has
    /// been recalibrated is known that much worse, [`Calibrated`](crate::Calibrated).
    ///
    /// # Errors
    /// [`Error::Setting`] for a method that has no covariance to add it to.
    fn widen_calibration(&mut self, _covariance: MatRef<'_, f64>) -> Result<(), Error> {
        Err(Error::Setting("the method has no covariance of biases, which a recalibration could change".into()))
    }

    /// Multiplies, from now on, the covariance that the problem gives it: of the model error Q for a filter, of the background
    /// error B for a method with a static one, [`Adaptive`](crate::Adaptive). It is no part of [`Assimilator::save`].
    ///
    /// # Errors
    /// [`Error::Setting`] for a method that has none, or cannot.
    fn set_error_factor(&mut self, _factor: f64) -> Result<(), Error> {
        Err(Error::Setting("the method has no covariance of its own errors that could be adapted".into()))
    }

    /// All that the next cycles depend on and that problem and settings do not say: estimates, covariances, places in
    /// random streams.
    ///
    /// # Errors
    /// [`Error::Saved`].
    fn save(&self) -> Result<Vec<u8>, Error>;

    /// Takes back what [`Assimilator::save`] gave, of a method with the same problem and settings; the cycles that follow
    /// are then the same to the bit.
    ///
    /// # Errors
    /// [`Error::Saved`] if it does not fit; the method must then not be used any more.
    fn restore(&mut self, saved: &[u8]) -> Result<(), Error>;
}
