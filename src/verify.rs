//! Verification: only here do estimate and truth meet.

use crate::diagnostics::{DiagnosticSums, Diagnostics};
use crate::outcome::Outcome;
use crate::smoothed::{EarlierTruths, SmoothedScorecard};
use crate::statistics::root_interval;
use crate::summary::{Intervals, MethodScores, ObservationCounts, PerVariable};
use isobar_assim::Estimate;
use isobar_assim::block_angular::PartitionReport;
use isobar_model::{Layout, State};
use isobar_obs::{Calibration, ObservationWindow};
use serde::{Deserialize, Serialize};

/// The truth of one cycle.
#[derive(Clone, Copy)]
pub struct TrueValues<'a> {
    /// The state.
    pub state: &'a State,
    /// The calibration parameters, in the order of [`Calibration`].
    pub calibration: &'a [f64],
}

/// The scores of one method: mean squares, summed over cycles.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Scorecard {
    cycles: usize,
    error_analysis: Sums,
    error_background: Sums,
    spread_analysis: Option<Sums>,
    spread_background: Option<Sums>,
    bias_error: Option<f64>,
    bias_spread: Option<f64>,
    chi2: Option<f64>,
    observations: usize,
    partition: Option<PartitionReport>,
    /// The errors of each cycle: analysis, background, biases.
    series: Vec<CycleErrors>,
    diagnostics: DiagnosticSums,
    smoothed: Option<SmoothedScorecard>,
}

/// What a run has come to so far.
#[derive(Clone, Debug, Default)]
pub struct Scores {
    /// The scores of each method.
    pub totals: Vec<Scorecard>,
    /// The observations of all cycles.
    pub observations: ObservationCounts,
    /// What smoothed estimates are compared with.
    pub earlier_truths: EarlierTruths,
}

/// Mean squares by variable number, summed over cycles.
pub(crate) type Sums = Vec<f64>;

/// Mean square errors of a cycle: analysis, background, biases.
type CycleErrors = (Sums, Sums, Option<f64>);

impl Scorecard {
    /// The scores of one cycle; the biases are scored only if the method estimates or ignores them.
    pub fn of_cycle(
        truth: TrueValues<'_>,
        outcome: &Outcome,
        observed: &ObservationWindow,
        calibration: &Calibration,
        scores_bias: bool,
    ) -> Self {
        let (background, analysis) = (&outcome.background, &outcome.analysis.estimate);
        let layout = truth.state.layout();
        let spread = |estimate: &Estimate| {
            estimate.state_spread.as_ref().map(|spread| mean_squares(layout, spread.iter().copied()))
        };
        let error = |estimate: &Estimate| {
            let errors = estimate.state.values().iter().zip(truth.state.values()).map(|(a, b)| a - b);
            mean_squares(layout, errors)
        };
        let biased = scores_bias && !calibration.is_empty();
        let bias_errors = || analysis.calibration.iter().zip(truth.calibration).map(|(a, b)| a - b);
        let (error_analysis, error_background) = (error(analysis), error(background));
        let bias_error = biased.then(|| mean_square(bias_errors()));
        Self {
            cycles: 1,
            series: vec![(error_analysis.clone(), error_background.clone(), bias_error)],
            error_analysis,
            error_background,
            spread_analysis: spread(analysis),
            spread_background: spread(background),
            bias_error,
            bias_spread: match &analysis.calibration_spread {
                Some(spread) if biased => Some(mean_square(spread.iter().copied())),
                _ => None,
            },
            chi2: outcome.analysis.innovation_chi2,
            observations: outcome.analysis.background_departures.len(),
            partition: outcome.analysis.partition.clone(),
            diagnostics: DiagnosticSums::of_cycle(truth, outcome, observed, calibration, scores_bias),
            smoothed: None,
        }
    }

    /// Takes in the scores of another cycle.
    pub fn add(&mut self, cycle: &Scorecard) {
        if self.cycles == 0 {
            *self = Self { smoothed: self.smoothed.take(), ..cycle.clone() };
            return;
        }
        self.cycles += cycle.cycles;
        self.observations += cycle.observations;
        self.series.extend_from_slice(&cycle.series);
        self.diagnostics.add(&cycle.diagnostics);
        add_sums(&mut self.error_analysis, &cycle.error_analysis);
        add_sums(&mut self.error_background, &cycle.error_background);
        for (own, other) in [
            (&mut self.spread_analysis, &cycle.spread_analysis),
            (&mut self.spread_background, &cycle.spread_background),
        ] {
            if let (Some(own), Some(other)) = (own, other) {
                add_sums(own, other);
            }
        }
        for (own, other) in [
            (&mut self.bias_error, cycle.bias_error),
            (&mut self.bias_spread, cycle.bias_spread),
            (&mut self.chi2, cycle.chi2),
        ] {
            if let (Some(own), Some(other)) = (own, other) {
                *own += other;
            }
        }
        self.partition = match (self.partition.take(), cycle.partition.clone()) {
            (Some(own), Some(other)) => Some(own.worse(other)),
            (own, other) => own.or(other),
        };
    }

    /// Takes in the scores of a smoothed estimate.
    pub fn add_smoothed(&mut self, cycle: &SmoothedScorecard) {
        match &mut self.smoothed {
            Some(own) => own.add(cycle),
            None => self.smoothed = Some(cycle.clone()),
        }
    }

    /// Roots of the mean squares, by name; without cost.
    pub fn scores(&self, layout: &Layout) -> MethodScores {
        let cycles = self.cycles as f64;
        let root = |sum: f64| (sum / cycles).sqrt();
        let named = |sums: &Sums| -> PerVariable { named_roots(layout, sums, self.cycles) };
        MethodScores {
            rmse_analysis: named(&self.error_analysis),
            rmse_background: named(&self.error_background),
            spread_analysis: self.spread_analysis.as_ref().map(named),
            spread_background: self.spread_background.as_ref().map(named),
            bias_rmse: self.bias_error.map(root),
            bias_spread: self.bias_spread.map(root),
            innovation_chi2: self.chi2.filter(|_| self.observations > 0).map(|chi2| chi2 / self.observations as f64),
            partition: self.partition.clone(),
            smoothed: self.smoothed.as_ref().map(|smoothed| smoothed.scores(layout)),
            intervals: (self.cycles > 1).then(|| self.intervals(layout)),
            diagnostics: None,
            stability: None,
            failure: None,
            seconds_per_cycle: 0.0,
            peak_memory_bytes: None,
        }
    }

    /// What the cycles tell beyond errors.
    pub fn diagnostics(&self, layout: &Layout, calibration: &Calibration) -> Diagnostics {
        self.diagnostics.diagnostics(layout, calibration)
    }

    /// How well the errors are known.
    fn intervals(&self, layout: &Layout) -> Intervals {
        let per_variable = |pick: &dyn Fn(&CycleErrors) -> Sums| {
            let series: Vec<Sums> = self.series.iter().map(pick).collect();
            let interval = |number: usize| root_interval(&series.iter().map(|sums| sums[number]).collect::<Vec<_>>());
            let names = layout.variables.iter().map(|variable| variable.name.to_string()).enumerate();
            names.filter_map(|(number, name)| Some((name, interval(number)?))).collect()
        };
        let biases: Option<Vec<f64>> = self.series.iter().map(|cycle| cycle.2).collect();
        Intervals {
            rmse_analysis: per_variable(&|cycle| cycle.0.clone()),
            rmse_background: per_variable(&|cycle| cycle.1.clone()),
            bias_rmse: biases.and_then(|biases| root_interval(&biases)),
        }
    }
}

/// Roots of mean squares that are summed over so many cycles, by the names of the variables.
pub(crate) fn named_roots(layout: &Layout, sums: &Sums, cycles: usize) -> PerVariable {
    let root = |sum: f64| (sum / cycles as f64).sqrt();
    layout.variables.iter().zip(sums).map(|(variable, &sum)| (variable.name.to_string(), root(sum))).collect()
}

/// The mean of squares.
pub(crate) fn mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.map(|value| value * value).sum::<f64>() / count
}

/// The mean of the squares of each variable's values.
pub(crate) fn mean_squares(layout: &Layout, values: impl Iterator<Item = f64>) -> Sums {
    let cells = layout.grid.cells();
    let mut sums = vec![0.0; layout.variables.len()];
    for (index, value) in values.enumerate() {
        sums[index / cells] += value * value;
    }
    sums.iter_mut().for_each(|sum| *sum /= cells as f64);
    sums
}

pub(crate) fn add_sums(own: &mut Sums, other: &Sums) {
    own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
}
