//! Why there is no advice.

use crate::run::RunError;
use crate::text::shown_path;
use isobar_assim::Error;
use isobar_model::ForecastError;
use std::path::PathBuf;

/// Why there is no advice.
#[derive(Debug, thiserror::Error)]
pub enum AdviceError {
    /// The run's state cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The method failed in the run.
    #[error("method {name} failed in cycle {cycle} of the run in {}: {reason}", shown_path(directory))]
    Failed {
        /// The method.
        name: String,
        /// The run.
        directory: PathBuf,
        /// When.
        cycle: usize,
        /// Why.
        reason: String,
    },
    /// The method has no covariance.
    #[error(
        "method {name} carries no covariance of its errors from cycle to cycle, so that it cannot say how much an observation would help"
    )]
    NoCovariance {
        /// The method.
        name: String,
    },
    /// The method does not estimate the functional.
    #[error("method {name} does not estimate {what}")]
    NotEstimated {
        /// The method.
        name: String,
        /// The functional, in words.
        what: String,
    },
    /// A request that the scenario does not fit.
    #[error("{0}")]
    Request(String),
    /// The method cannot forecast, or its covariance is not positive definite.
    #[error("method {name}: {error}")]
    Method {
        /// The method.
        name: String,
        /// Why.
        error: Error,
    },
    /// The forecast of the functional leaves the finite numbers.
    #[error("the forecast from the next analysis: {0}")]
    Forecast(#[from] ForecastError),
}
