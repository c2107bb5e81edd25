//! What a method made of one cycle, for those who judge it: the monitors, the scores, the sinks.

use crate::readings::Readings;
use crate::verdict::Verdict;
use isobar_assim::{Analysis, Estimate};
use isobar_obs::ObservationType;
use serde::{Deserialize, Serialize};

/// What a method made of one cycle.
pub struct Outcome {
    /// The estimate before the observations.
    pub background: Estimate,
    /// The analysis.
    pub analysis: Analysis,
    /// The estimates of earlier cycles that it has revised for the last time, the earliest first; at the end of the run all
    /// that are left, and the analysis itself.
    pub smoothed: Vec<Smoothed>,
    /// How the observations that the method did not see depart from its estimates.
    pub unused: UnusedDepartures,
    /// The observations without the biases that the method has found; `None` if it estimates none.
    pub readings: Option<Readings>,
    /// What each type of observations did, if that was asked for.
    pub influence: Option<Influence>,
    /// The verdicts on its biases that are the first, or others than in the cycle before.
    pub verdicts: Vec<Verdict>,
    /// Wall-clock seconds that it took.
    pub seconds: f64,
}

/// Departures of the observations that no method sees, in their order; `None` where there is none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UnusedDepartures {
    /// y − h(background).
    pub background: Vec<Option<f64>>,
    /// y − h(analysis).
    pub analysis: Vec<Option<f64>>,
}

/// The estimate of an earlier cycle, given all observations so far.
pub struct Smoothed {
    /// How many cycles ago.
    pub cycles_ago: usize,
    /// The estimate.
    pub estimate: Estimate,
}

/// What each type of observations did in an analysis.
#[derive(Clone, Debug, PartialEq)]
pub struct Influence {
    /// The types, in the order of their first observations.
    pub types: Vec<TypeInfluence>,
}

/// What the observations of one type did.
#[derive(Clone, Debug, PartialEq)]
pub struct TypeInfluence {
    /// The type.
    pub observation_type: ObservationType,
    /// K d_t: the state's increment from the innovations of this type, those of all others being zero.
    pub increment: Vec<f64>,
    /// The type's part of tr(H K), the degrees of freedom for signal.
    pub signal: f64,
}

impl Outcome {
    /// The memory of estimates and departures \[bytes\].
    pub fn bytes(&self) -> i64 {
        let of_estimate = |it: &Estimate| {
            let spreads = [&it.state_spread, &it.calibration_spread].into_iter().flatten();
            it.state.values().len() + it.calibration.len() + spreads.map(Vec::len).sum::<usize>()
        };
        let Analysis { estimate, background_departures, analysis_departures, .. } = &self.analysis;
        let departures = background_departures.len() + analysis_departures.len();
        let smoothed = self.smoothed.iter().map(|it| of_estimate(&it.estimate)).sum::<usize>();
        let numbers = of_estimate(&self.background) + of_estimate(estimate) + smoothed + departures;
        (numbers * size_of::<f64>()) as i64
    }
}
