//! The measures of one method over the cycles of a run, and what they come to.

use super::Values;
use super::against::Against;
use super::forecast::ForecastSums;
use super::kinds::{Better, Measure, SCORES, ScoreKind, kind_of};
use super::measures::{Sum, Verified};
use super::summary::{Intervals, MethodScores, ObservationCounts};
use super::truths::{EarlierTruths, TrueValues, Truth};
use super::warnings::WarningSums;
use crate::outcome::Outcome;
use crate::scores::diagnostics::DiagnosticSums;
use crate::scores::statistics::{mean, root_interval};
use indexmap::IndexMap;
use isobar_assim::Estimate;
use isobar_assim::block_angular::PartitionReport;
use isobar_model::Layout;
use isobar_obs::{Calibration, ObservationWindow};
use serde::{Deserialize, Serialize};

/// The scores of one method, of one cycle or of several.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Scorecard {
    /// By key (see [`Values`]), the measure of each cycle that has it, in the order of the cycles.
    measured: IndexMap<String, Vec<Sum>>,
    partition: Option<PartitionReport>,
    diagnostics: DiagnosticSums,
    /// Of forecasts ahead, which are not those of a cycle and have no part in [`Scorecard::add`].
    pub forecasts: ForecastSums,
    /// Of their warnings, likewise.
    pub warnings: WarningSums,
}

/// The scores of a run so far.
#[derive(Clone, Debug, Default)]
pub struct RunScores {
    /// The scores of each method.
    pub totals: Vec<Scorecard>,
    /// The observations of all cycles.
    pub observations: ObservationCounts,
    /// The truths with which smoothed estimates are compared.
    pub earlier_truths: EarlierTruths,
}

impl Scorecard {
    /// The scores of one cycle, those against the truth if there is one; the biases are scored only if the method estimates or
    /// ignores them, corrections of the model if their truth is known.
    pub fn of_cycle(
        truth: Option<TrueValues<'_>>,
        outcome: &Outcome,
        observed: &ObservationWindow,
        calibration: &Calibration,
        scores_bias: bool,
        corrections: Option<Sum>,
    ) -> Self {
        let analysis = &outcome.analysis;
        let verified = Verified {
            layout: analysis.estimate.state.layout(),
            truth: truth.map(Truth::from),
            scored_parameters: if scores_bias { calibration.len() } else { 0 },
            background: Some(&outcome.background),
            analysis: Some(&analysis.estimate),
            departures: Some((observed, outcome)),
            smoothed: None,
            corrections,
        };
        Self {
            measured: measured(&verified),
            partition: analysis.partition.clone(),
            diagnostics: DiagnosticSums::of_cycle(truth, outcome, observed, calibration, scores_bias),
            forecasts: ForecastSums::default(),
            warnings: WarningSums::default(),
        }
    }

    /// The scores of the smoothed estimate of an earlier cycle: without its truth the claims alone.
    pub fn of_smoothed(truths: &EarlierTruths, cycles_ago: usize, estimate: &Estimate, scores_bias: bool) -> Self {
        let verified = Verified {
            layout: estimate.state.layout(),
            truth: truths.ago(cycles_ago),
            scored_parameters: if scores_bias { estimate.calibration.len() } else { 0 },
            background: None,
            analysis: None,
            departures: None,
            smoothed: Some(estimate),
            corrections: None,
        };
        Self { measured: measured(&verified), ..Self::default() }
    }

    /// Adds the scores of another cycle.
    pub fn add(&mut self, cycle: &Self) {
        for (key, sums) in &cycle.measured {
            self.measured.entry(key.clone()).or_default().extend_from_slice(sums);
        }
        self.diagnostics.add(&cycle.diagnostics);
        self.partition = match (self.partition.take(), cycle.partition.clone()) {
            (Some(so_far), Some(other)) => Some(so_far.worse(other)),
            (so_far, other) => so_far.or(other),
        };
    }

    /// The averages over the cycles.
    pub fn values(&self) -> Values {
        let measured = self.measured.iter();
        measured.filter_map(|(key, sums)| Some((key.clone(), average(kind_of(key)?, sums)?))).collect()
    }

    /// The scores of a whole run, without cost and stability.
    pub fn scores(&self, layout: &Layout, calibration: &Calibration) -> MethodScores {
        MethodScores {
            values: self.values(),
            partition: self.partition.clone(),
            intervals: self.intervals(),
            diagnostics: Some(self.diagnostics.diagnostics(layout, calibration)),
            ..MethodScores::default()
        }
    }

    /// How well the errors are known.
    fn intervals(&self) -> Intervals {
        let interval = |(key, sums): (&String, &Vec<Sum>)| {
            let kind = kind_of(key).filter(|kind| kind.better == Better::Less)?;
            let filled = sums.iter().filter(|sum| sum.weight > 0.0);
            let of_cycles: Vec<f64> = filled.map(|sum| sum.total / sum.weight).collect();
            let interval = match kind.measure {
                Measure::RootMean(_) => root_interval(&of_cycles),
                _ => mean(&of_cycles).and_then(|mean| mean.interval()),
            };
            Some((key.clone(), interval?))
        };
        self.measured.iter().filter_map(interval).collect()
    }
}

/// Everything that can be measured of these estimates.
fn measured(verified: &Verified<'_>) -> IndexMap<String, Vec<Sum>> {
    let mut all = IndexMap::new();
    for kind in SCORES {
        let (Measure::RootMean(measure) | Measure::Mean(measure)) = kind.measure else { continue };
        if kind.against == Against::Used && verified.truth.is_some() {
            continue;
        }
        let names = verified.layout.variables.iter().map(|variable| variable.name);
        let keys: Vec<String> =
            if kind.per_variable { names.map(|name| kind.key(name)).collect() } else { vec![kind.key("")] };
        let sums = measure(verified).into_iter().flatten().map(|sum| vec![sum]);
        all.extend(keys.into_iter().zip(sums));
    }
    all
}

/// `None` if there is nothing to average, such as no observations.
fn average(kind: &ScoreKind, sums: &[Sum]) -> Option<f64> {
    let total: f64 = sums.iter().map(|sum| sum.total).sum();
    let weight: f64 = sums.iter().map(|sum| sum.weight).sum();
    let is_root = matches!(kind.measure, Measure::RootMean(_));
    (weight > 0.0).then(|| if is_root { (total / weight).sqrt() } else { total / weight })
}
