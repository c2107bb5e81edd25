//! The scores of a run, as `summary.json` holds them.

use crate::diagnostics::Diagnostics;
use crate::stability::Stability;
use crate::statistics::Interval;
use indexmap::IndexMap;
use isobar_assim::EstimatedParameter;
use isobar_assim::block_angular::PartitionReport;
use isobar_model::Layout;
use isobar_obs::{ObservationWindow, Report};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A figure for each variable, by name.
pub type PerVariable = IndexMap<String, f64>;

/// The scores of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// Number of cycles.
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
}

/// The scores of one method, over one cycle or over all that count.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MethodScores {
    /// Root-mean-square error of the analysis, per variable, in its unit.
    pub rmse_analysis: PerVariable,
    /// Root-mean-square error of the background.
    pub rmse_background: PerVariable,
    /// Root-mean-square claimed standard deviation of the analysis, where the method has one.
    pub spread_analysis: Option<PerVariable>,
    /// Root-mean-square claimed standard deviation of the background, where the method has one.
    pub spread_background: Option<PerVariable>,
    /// Root-mean-square error of the bias parameters, each in its unit; `None` without parameters.
    pub bias_rmse: Option<f64>,
    /// Root-mean-square claimed standard deviation of the bias parameters.
    pub bias_spread: Option<f64>,
    /// Normalised innovation squared per observation; 1 if the claimed covariances are right.
    pub innovation_chi2: Option<f64>,
    /// The partition of the cycle with the largest component or, where components are cut, the most to cut; for a method
    /// with blocks.
    pub partition: Option<PartitionReport>,
    /// The scores of the estimates that later observations have revised, for a method with a smoother.
    #[serde(default)]
    pub smoothed: Option<SmoothedScores>,
    /// How well the errors are known, over more than one cycle.
    #[serde(default)]
    pub intervals: Option<Intervals>,
    /// What the run tells beyond errors, over all cycles that count.
    #[serde(default)]
    pub diagnostics: Option<Diagnostics>,
    /// Which bias estimates can be relied on, over a whole run.
    #[serde(default)]
    pub stability: Option<Stability>,
    /// When and why the method failed; it has no scores then.
    #[serde(default)]
    pub failure: Option<Failure>,
    /// What the method estimated beside state and calibration in the last cycle, or found out about itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<EstimatedParameter>,
    /// Wall-clock seconds per cycle, forecast and analysis.
    pub seconds_per_cycle: f64,
    /// The most memory that the method held at one time; `None` if other runs went on in the same process.
    pub peak_memory_bytes: Option<u64>,
}

/// The scores of smoothed estimates, of the same cycles as those of the analyses: each as the observations of the following
/// `lag_cycles` cycles have it, or of all there are at the end of the run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SmoothedScores {
    /// The number of later cycles whose observations revise an estimate.
    pub lag_cycles: usize,
    /// Root-mean-square error, per variable, in its unit.
    pub rmse: PerVariable,
    /// Root-mean-square claimed standard deviation.
    pub spread: Option<PerVariable>,
    /// Root-mean-square error of the bias parameters, each in its unit.
    pub bias_rmse: Option<f64>,
    /// Root-mean-square claimed standard deviation of the bias parameters.
    pub bias_spread: Option<f64>,
}

/// Observations, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObservationCounts {
    /// Those that methods were given.
    pub used: usize,
    /// Those that failed quality control, by reason.
    pub rejected: BTreeMap<String, usize>,
    /// The same of each type, `network/variable`.
    #[serde(default)]
    pub by_type: BTreeMap<String, TypeCounts>,
}

/// Observations of one type, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TypeCounts {
    /// Those that methods were given.
    pub used: usize,
    /// Those that failed quality control, by reason.
    pub rejected: BTreeMap<String, usize>,
}

impl ObservationCounts {
    /// Counts those of a cycle.
    pub fn add(&mut self, window: &ObservationWindow, layout: &Layout) {
        let kind = |report: &Report| format!("{}/{}", report.network, layout.variables[report.variable].name);
        self.used += window.len();
        for report in &window.reports {
            self.by_type.entry(kind(report)).or_default().used += 1;
        }
        for rejected in &window.rejected {
            let reason = rejected.rejection.name().to_string();
            let own = self.by_type.entry(kind(&rejected.report)).or_default();
            *own.rejected.entry(reason.clone()).or_default() += 1;
            *self.rejected.entry(reason).or_default() += 1;
        }
    }

    /// How many were rejected, and why, in words; `None` if none was.
    pub fn describe_rejected(&self) -> Option<String> {
        let count: usize = self.rejected.values().sum();
        let reasons: Vec<String> = self.rejected.iter().map(|(name, count)| format!("{count} {name}")).collect();
        (count > 0).then(|| {
            format!("{count} of {} observations rejected by quality control: {}", self.used + count, reasons.join(", "))
        })
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
    /// The methods that failed, by name.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &Failure)> {
        self.methods.iter().filter_map(|(name, scores)| Some((name.as_str(), scores.failure.as_ref()?)))
    }
}

/// 95 % intervals of root-mean-square errors, from the number and the autocorrelation of the cycles
/// (see [`crate::statistics`]); a score that is not there is known from too few independent cycles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Intervals {
    /// Of the analysis, per variable.
    pub rmse_analysis: IndexMap<String, Interval>,
    /// Of the background, per variable.
    pub rmse_background: IndexMap<String, Interval>,
    /// Of the bias parameters.
    pub bias_rmse: Option<Interval>,
}
