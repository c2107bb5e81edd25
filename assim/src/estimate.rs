//! What methods return: estimates, backgrounds and analyses.

use crate::block_angular::PartitionReport;
use crate::error::Error;
use crate::spread::standard_deviations;
use isobar_model::{Duration, State};
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};

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
    /// estimated; `part` names the part of the covariance that a variance belongs to, if it has parts.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if the matrix is no longer a covariance.
    pub(crate) fn with_variances(
        state: State,
        calibration: Vec<f64>,
        estimated: &Calibration,
        variances: &[f64],
        covariance: &str,
        part: impl Fn(usize) -> Option<String>,
    ) -> Result<Self, Error> {
        let m = state.values().len();
        let spread = standard_deviations(variances, covariance, |i| {
            let value = if i < m { state.layout().describe(i) } else { estimated.parameters[i - m].name.clone() };
            part(i).map_or(value.clone(), |part| format!("{value} in {part}"))
        })?;
        Ok(Self::with_spread(state, calibration, spread))
    }
}

/// A forecast, from which the analysis of the observations at its end starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Background {
    /// The estimate before the observations.
    pub estimate: Estimate,
    /// The length of the forecast.
    pub window: Duration,
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
    /// the method's covariances are right; `None` for a method without them, or where it could not be
    /// computed.
    pub innovation_chi2: Option<f64>,
    /// How the observations linked blocks, for a method with blocks.
    pub partition: Option<PartitionReport>,
    /// Why the analysis is not what the method stands for, such as a minimisation that has not converged; usually nothing.
    pub warnings: Vec<String>,
}
