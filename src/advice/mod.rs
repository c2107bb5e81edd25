//! What to observe next: how much each observation that could be made at the next analysis would reduce the variance of one
//! functional of a method's estimates.
//!
//! A run has ended with an analysis and its covariance. From there the method forecasts one cycle, and [`Advice`] gives for each
//! candidate how much an analysis of it would reduce the variance of the functional, whatever its value turns out to be. The
//! functional is a bias, or the mean of a variable in an area, at that time or in a forecast from it:
//!
//! ```text
//! vᵀ s(t + τ),   v(t) = Aᵀ v(t + τ)        A the tangent-linear model along the forecast, φ for biases
//! ```
//!
//! Model errors on the way to t + τ are added to its variance whatever is observed, and are not part of the figures.

mod advised;
mod candidates;
mod error;
mod functional;
mod request;
mod table;

pub use advised::Advised;
pub use candidates::{Candidate, Kind};
pub use error::AdviceError;
pub use functional::Functional;
pub use request::Request;
pub use table::tables;

use crate::run;
use crate::run::experiment::Competitor;
use crate::scenario::Scenario;
use candidates::Proposed;
use isobar_assim::Advice;
use std::path::Path;

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
    let observed = experiment.observing.observe_checked(Some((&estimate.state).into()), None);
    let observed = &*observed.anchored(&estimate.state);
    let info = &experiment.info;
    let stations = experiment.observing.stations();
    let asked = functional::Asked::new(&request.functional, request.lead_hours, scenario, info, stations, &estimate)?;
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
