//! What to observe next: of observations that could be made at the next analysis, how much each would take off the variance of
//! one functional of what a method estimates.
//!
//! A run has ended with an analysis and its covariance. From there the method forecasts one cycle, and [`Advice`] gives for each
//! candidate what an analysis of it would take off the variance of the functional, whatever its value turns out to be. The
//! functional is a bias, or the mean of a variable in an area, at that time or in a forecast from it:
//!
//! ```text
//! vᵀ s(t + τ),   v(t) = Aᵀ v(t + τ)        A the tangent-linear model along the forecast, φ for biases
//! ```
//!
//! Model errors on the way to t + τ are added to its variance whatever is observed, and are not part of the figures.

mod candidates;
mod functional;

pub use candidates::{Candidate, Kind};
pub use functional::Functional;

use crate::run::experiment::Competitor;
use crate::run::{self, RunError};
use crate::scenario::Scenario;
use crate::text::shown_path;
use candidates::Proposed;
use indexmap::IndexMap;
use isobar_assim::{Advice, Error};
use isobar_model::{ForecastError, Time};
use std::path::{Path, PathBuf};

/// What is asked.
#[derive(Clone, Debug)]
pub struct Request {
    /// The method whose covariance is asked.
    pub method: String,
    /// What is to be known better.
    pub functional: Functional,
    /// How long after the next analysis \[h\].
    pub lead_hours: f64,
    /// Numbers of places in x and y at which a new radiosonde is tried.
    pub grid: [usize; 2],
    /// Standard deviations of a new radiosonde's errors, by variable; empty: the least that a station reports with.
    pub sigmas: IndexMap<String, f64>,
    /// Standard deviation of a comparison of two sensors, and of a test point of one, in the sensors' unit.
    pub comparison_sigma: f64,
}

/// What would tell how much.
#[derive(Clone, Debug)]
pub struct Advised {
    /// The functional, in words.
    pub functional: String,
    /// Its unit, in UDUNITS spelling.
    pub unit: String,
    /// The time of the observations.
    pub time: Time,
    /// The standard deviation of the functional without any of them.
    pub sigma: f64,
    /// The candidates, those that tell the most first.
    pub candidates: Vec<Candidate>,
    /// What there is to know of them.
    pub notes: Vec<String>,
}

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
        "method {name} carries no covariance of its errors from cycle to cycle, so that it cannot say what an observation would tell"
    )]
    NoCovariance {
        /// The method.
        name: String,
    },
    /// The method does not estimate what is asked.
    #[error("method {name} does not estimate {what}")]
    NotEstimated {
        /// The method.
        name: String,
        /// What is asked.
        what: String,
    },
    /// A request that the scenario does not fit.
    #[error("{0}")]
    Request(String),
    /// The method cannot forecast, or its covariance is none.
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

/// Ranks the candidates, from the state in which the run in the directory `from` ended.
///
/// # Errors
/// See [`AdviceError`].
pub fn advise(scenario: &Scenario, from: &Path, request: &Request) -> Result<Advised, AdviceError> {
    let mut experiment = run::reopen(scenario, from, &request.method)?;
    let name = || request.method.clone();
    let Some(Competitor { runner, failure, .. }) = experiment.methods.first() else {
        return Err(AdviceError::Request(format!("there is no method {}", request.method)));
    };
    if let Some(failure) = failure {
        let (cycle, reason) = (failure.cycle, failure.reason.clone());
        return Err(AdviceError::Failed { name: name(), directory: from.to_path_buf(), cycle, reason });
    }
    if runner.method().can().joint_errors.is_none() {
        return Err(AdviceError::NoCovariance { name: name() });
    }
    let mut method = runner.method().boxed_clone();
    let window = experiment.info.window;
    let estimate = method.forecast(window).map_err(|error| AdviceError::Method { name: name(), error })?.estimate;
    let views = method.can();
    let Some(errors) = views.joint_errors else { return Err(AdviceError::NoCovariance { name: name() }) };
    let estimates_biases = views.calibration.is_some();
    // What is observed does not matter, only where and by whom.
    let observed = experiment.observing.observe_checked(Some(&estimate.state), None);
    let observed = &*observed.anchored(&estimate.state);
    let info = &experiment.info;
    let stations = experiment.observing.stations();
    let asked = functional::Asked::new(request, scenario, info, stations, &estimate)?;
    let not_estimated = || AdviceError::NotEstimated { name: name(), what: asked.words.clone() };
    let advice = Advice::new(errors, &asked.combination).ok_or_else(not_estimated)?;
    let Proposed { proposals, notes } =
        candidates::propose(request, info, stations, observed, &estimate, estimates_biases)?;
    let mut candidates = Vec::new();
    for proposal in proposals {
        let reduction =
            advice.reduction(&proposal.rows).map_err(|error| AdviceError::Method { name: name(), error })?;
        candidates.extend(reduction.map(|reduction| proposal.with(reduction, advice.variance())));
    }
    // The order of proposals decides between equals.
    candidates.sort_by(|a, b| b.reduction.total_cmp(&a.reduction));
    Ok(Advised {
        functional: asked.words,
        unit: asked.unit,
        time: observed.time,
        sigma: advice.variance().max(0.0).sqrt(),
        candidates,
        notes,
    })
}
