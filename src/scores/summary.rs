//! The scores of a run, as `summary.json` holds them.

use super::Values;
use super::against::Against;
use super::forecast::ForecastScores;
use super::kinds::{BRIER, Better, MEMORY, Measure, SCORES, kind_of};
use super::warnings::WarningScores;
use crate::scores::diagnostics::Diagnostics;
use crate::scores::stability::Stability;
use crate::scores::statistics::Interval;
use indexmap::IndexMap;
use isobar_assim::EstimatedParameter;
use isobar_assim::block_angular::PartitionReport;
use isobar_model::Layout;
use isobar_obs::{ObservationWindow, Rejection, Report, UnusedObservation};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The scores of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// Number of the last cycle.
    pub cycles: usize,
    /// First cycle that counts for the scores.
    pub scored_from_cycle: usize,
    /// Version of isobar.
    pub version: String,
    /// The observations of all cycles.
    #[serde(default)]
    pub observations: ObservationCounts,
    /// Scores by method.
    pub methods: IndexMap<String, MethodScores>,
    /// What the ranks exchanged, if several computed it together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ranks: Option<Exchanged>,
}

/// What the ranks of a run exchange.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exchanged {
    /// Number of ranks.
    pub count: usize,
    /// Messages that a rank sends in a cycle, of the rank that sends most.
    pub messages_per_cycle: f64,
    /// Their bytes.
    pub bytes_per_cycle: f64,
}

/// The scores of one method over a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MethodScores {
    /// The scores by key.
    #[serde(flatten, with = "by_kind")]
    pub values: Values,
    /// 95 % intervals of errors by key, from the number and the autocorrelation of the cycles (see [`crate::scores::statistics`]).
    /// An error without one is known from too few independent cycles.
    #[serde(default, with = "by_kind")]
    pub intervals: Intervals,
    /// The partition of the cycle with the largest component or, where components are cut, the most to cut; for a method
    /// with blocks.
    pub partition: Option<PartitionReport>,
    /// The number of later cycles whose observations revise the smoothed estimates, for a method with a smoother.
    #[serde(default)]
    pub smoother_lag_cycles: Option<usize>,
    /// The diagnostics beyond errors, over all cycles that count.
    #[serde(default)]
    pub diagnostics: Option<Diagnostics>,
    /// The forecasts ahead, by lead time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forecasts: Option<ForecastScores>,
    /// The warnings of forecasts ahead, in the order of the scenario.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<WarningScores>,
    /// Which bias estimates can be relied on.
    #[serde(default)]
    pub stability: Option<Stability>,
    /// When and why the method failed; it has no scores then but those of cost.
    #[serde(default)]
    pub failure: Option<Failure>,
    /// What the method estimated beside state and calibration in the last cycle, or found out about itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<EstimatedParameter>,
}

impl MethodScores {
    /// Takes the scores of forecasts ahead, and among the scores of the run those at the longest lead time \[h\].
    pub fn with_forecasts(mut self, forecasts: Option<ForecastScores>, longest_hours: f64) -> Self {
        let longest = forecasts.as_ref().and_then(|forecasts| forecasts.at(longest_hours));
        for kind in SCORES {
            let Measure::LongestLead(name) = kind.measure else { continue };
            for (variable, known) in longest.iter().filter_map(|lead| lead.scores.get(name)).flatten() {
                self.values.insert(kind.key(variable), known.value);
                if let Some(interval) = known.interval.filter(|_| kind.better == Better::Less) {
                    self.intervals.insert(kind.key(variable), interval);
                }
            }
        }
        self.forecasts = forecasts;
        self
    }

    /// Takes the scores of warnings, and among the scores of the run their average.
    pub fn with_warnings(mut self, warnings: Vec<WarningScores>) -> Self {
        let briers: Option<Vec<f64>> = warnings.iter().map(|it| Some(it.ahead.brier?.score.value)).collect();
        if let Some(briers) = briers.filter(|it| !it.is_empty()) {
            self.values.insert(BRIER.into(), briers.iter().sum::<f64>() / briers.len() as f64);
        }
        self.warnings = warnings;
        self
    }

    /// The scores that are averaged over runs, with those that its diagnostics hold; empty for a method that failed. Memory is
    /// not among them: it is known only of runs that have the process to themselves.
    pub fn all(&self) -> Values {
        if self.failure.is_some() {
            return Values::new();
        }
        let mut all = self.values.clone();
        all.shift_remove(MEMORY);
        for kind in SCORES {
            if let Measure::Diagnostics(pick) = kind.measure {
                let state = self.diagnostics.iter().flat_map(|it| &it.state);
                all.extend(state.map(|(variable, own)| (kind.key(variable), pick(own))));
            }
        }
        all
    }
}

/// Intervals by the keys of their scores.
pub type Intervals = IndexMap<String, Interval>;

/// Observations, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObservationCounts {
    /// Those that the methods assimilated.
    pub used: usize,
    /// Those that failed quality control, by reason.
    pub rejected: BTreeMap<String, usize>,
    /// Those of passive networks.
    #[serde(default)]
    pub passive: usize,
    /// The same of each type, `network/variable`.
    #[serde(default)]
    pub by_type: BTreeMap<String, TypeCounts>,
    /// The first of those that failed quality control.
    #[serde(default)]
    pub first_rejected: Vec<RejectedObservation>,
}

/// Observations of one type, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TypeCounts {
    /// Those that the methods assimilated.
    pub used: usize,
    /// Those of passive networks.
    #[serde(default)]
    pub passive: usize,
    /// Those that failed quality control, by reason.
    pub rejected: BTreeMap<String, usize>,
}

/// An observation that failed quality control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RejectedObservation {
    /// The cycle with whose observations it came.
    pub cycle: usize,
    /// Its network.
    pub network: String,
    /// Its station, or its place in the swath.
    pub platform: String,
    /// The observed variable.
    pub variable: String,
    /// The variable's unit.
    pub unit: String,
    /// Why it was rejected, in one word.
    pub reason: String,
    /// The value; `None` if it is not finite.
    pub value: Option<f64>,
    /// What reference and neighbours predict, if the value was compared with them.
    pub predicted: Option<f64>,
    /// Value minus prediction, in standard deviations of that difference.
    pub z: Option<f64>,
    /// Number of neighbours that the prediction is from.
    pub neighbours: Option<usize>,
}

/// The most rejected observations that are told one by one; the file of observations has them all.
const MOST_REJECTED: usize = 50;

impl ObservationCounts {
    /// Counts those of a cycle.
    pub fn add(&mut self, window: &ObservationWindow, layout: &Layout) {
        let kind = |report: &Report| report.observation_type().name(layout);
        self.used += window.len();
        for report in &window.reports {
            self.by_type.entry(kind(report)).or_default().used += 1;
        }
        for (_, passive) in window.aside.passive() {
            self.passive += 1;
            self.by_type.entry(kind(&passive.report)).or_default().passive += 1;
        }
        for (observation, rejection) in window.aside.rejected() {
            let reason = rejection.name().to_string();
            let of_type = self.by_type.entry(kind(&observation.report)).or_default();
            *of_type.rejected.entry(reason.clone()).or_default() += 1;
            *self.rejected.entry(reason).or_default() += 1;
            if self.first_rejected.len() < MOST_REJECTED {
                self.first_rejected.push(RejectedObservation::new(window.cycle, observation, rejection, layout));
            }
        }
    }

    /// How many were rejected, and why, in words; `None` if all passed quality control.
    pub fn describe_rejected(&self) -> Option<String> {
        let count: usize = self.rejected.values().sum();
        let reasons: Vec<String> = self.rejected.iter().map(|(name, count)| format!("{count} {name}")).collect();
        (count > 0).then(|| {
            let all = self.used + self.passive + count;
            format!("{count} of {all} observations rejected by quality control: {}", reasons.join(", "))
        })
    }
}

impl RejectedObservation {
    fn new(cycle: usize, observation: &UnusedObservation, rejection: Rejection, layout: &Layout) -> Self {
        let UnusedObservation { report, value, check, .. } = observation;
        let variable = &layout.variables[report.variable];
        Self {
            cycle,
            network: report.network.to_string(),
            platform: report.platform.to_string(),
            variable: variable.name.to_string(),
            unit: variable.unit.to_string(),
            reason: rejection.name().to_string(),
            value: Some(*value).filter(|value| value.is_finite()),
            predicted: check.map(|check| check.predicted),
            z: check.map(|check| check.z),
            neighbours: check.map(|check| check.neighbours),
        }
    }
}

/// The end of a method before that of the run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// The cycle in which it failed.
    pub cycle: usize,
    /// Why, in words that can be shown on a terminal.
    pub reason: String,
}

impl Summary {
    /// Whether the methods were compared with a truth, as far as their scores show it: where none has any, it is not said.
    pub fn has_truth(&self) -> bool {
        let against = |against: Against| {
            let of_kind = |key: &String| kind_of(key).is_some_and(|kind| kind.against == against);
            self.methods.values().any(|scores| scores.values.keys().any(of_kind))
        };
        against(Against::Truth) || !against(Against::Used)
    }

    /// The methods that failed, by name.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &Failure)> {
        self.methods.iter().filter_map(|(name, scores)| Some((name.as_str(), scores.failure.as_ref()?)))
    }
}

/// Values by key as files hold them: those of a kind together, `"rmse_analysis": { "h": 3.8, "u": 1.5 }`.
mod by_kind {
    use crate::scores::kind;
    use indexmap::IndexMap;
    use serde::de::IgnoredAny;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize)]
    #[serde(untagged)]
    enum Written<'a, T> {
        Single(&'a T),
        PerVariable(IndexMap<&'a str, &'a T>),
    }

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Read<T> {
        Single(T),
        PerVariable(IndexMap<String, T>),
        /// A score that the method does not have, or no score at all.
        Other(IgnoredAny),
    }

    pub fn serialize<T: Serialize, S: Serializer>(values: &IndexMap<String, T>, to: S) -> Result<S::Ok, S::Error> {
        let mut kinds: IndexMap<&str, Written<'_, T>> = IndexMap::new();
        for (key, value) in values {
            let Some((name, variable)) = key.split_once('.') else {
                kinds.insert(key, Written::Single(value));
                continue;
            };
            let of_kind = kinds.entry(name).or_insert_with(|| Written::PerVariable(IndexMap::new()));
            if let Written::PerVariable(variables) = of_kind {
                variables.insert(variable, value);
            }
        }
        kinds.serialize(to)
    }

    pub fn deserialize<'de, T, D>(from: D) -> Result<IndexMap<String, T>, D::Error>
    where
        T: Deserialize<'de>,
        D: Deserializer<'de>,
    {
        let mut values = IndexMap::new();
        let all = Option::<IndexMap<String, Read<T>>>::deserialize(from)?.unwrap_or_default();
        for (name, of_kind) in all {
            let Some(kind) = kind(&name) else { continue };
            match of_kind {
                Read::Single(value) if !kind.per_variable => drop(values.insert(name, value)),
                Read::PerVariable(variables) if kind.per_variable => {
                    values.extend(variables.into_iter().map(|(variable, value)| (kind.key(&variable), value)));
                }
                _ => {}
            }
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_are_written_by_kind_and_those_of_earlier_runs_are_read() {
        let values = [("rmse_analysis.h", 2.5), ("rmse_analysis.u", 1.0), ("bias_rmse", 0.5)];
        let values: Values = values.iter().map(|&(key, value)| (key.to_string(), value)).collect();
        let intervals = Intervals::from([("rmse_analysis.h".to_string(), Interval { low: 2.0, high: 3.0 })]);
        let scores = MethodScores { values, intervals, ..MethodScores::default() };
        let json = serde_json::to_value(&scores).unwrap();
        assert_eq!(json["rmse_analysis"], serde_json::json!({ "h": 2.5, "u": 1.0 }));
        assert_eq!(json["intervals"]["rmse_analysis"]["h"]["high"], 3.0);
        assert_eq!(serde_json::from_value::<MethodScores>(json).unwrap(), scores);
        let earlier = r#"{ "rmse_analysis": { "h": 2.5, "u": 1 }, "rmse_background": {}, "spread_analysis": null,
            "bias_rmse": 0.5, "bias_spread": null, "partition": null, "smoothed": { "lag_cycles": 2, "rmse": { "h": 1 } },
            "intervals": { "rmse_analysis": { "h": { "low": 2, "high": 3 } }, "rmse_background": {}, "bias_rmse": null },
            "failure": null, "peak_memory_bytes": null }"#;
        assert_eq!(serde_json::from_str::<MethodScores>(earlier).unwrap(), scores);
        let failed = r#"{ "partition": null, "intervals": null, "seconds_per_cycle": 2, "peak_memory_bytes": 12 }"#;
        let failed: MethodScores = serde_json::from_str(failed).unwrap();
        assert_eq!((failed.values["peak_memory_bytes"], failed.intervals.len()), (12.0, 0));
    }
}
