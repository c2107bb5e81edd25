//! Verification of smoothed estimates: each is of an earlier cycle, and meets the truth of that cycle.

use crate::summary::{PerVariable, SmoothedScores};
use crate::verify::{Sums, TrueValues, add_sums, mean_square, mean_squares, named_roots};
use isobar_assim::Estimate;
use isobar_model::Layout;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The truths of the last cycles, as far back as estimates are smoothed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EarlierTruths {
    /// State and calibration, the newest last.
    cycles: VecDeque<(Vec<f64>, Vec<f64>)>,
}

impl EarlierTruths {
    /// Takes in the truth of a cycle; no more than that of so many before it is kept. `None`: not even its own.
    pub fn add(&mut self, truth: TrueValues<'_>, before: Option<usize>) {
        let Some(before) = before else { return };
        self.cycles.push_back((truth.state.values().to_vec(), truth.calibration.to_vec()));
        while self.cycles.len() > before + 1 {
            self.cycles.pop_front();
        }
    }

    /// State and calibration so many cycles ago.
    fn ago(&self, cycles: usize) -> Option<(&[f64], &[f64])> {
        let (state, calibration) = self.cycles.get(self.cycles.len().checked_sub(cycles + 1)?)?;
        Some((state, calibration))
    }

    /// Whether it is of states and calibrations of these lengths.
    pub fn fits(&self, values: usize, parameters: usize) -> bool {
        self.cycles.iter().all(|(state, calibration)| state.len() == values && calibration.len() == parameters)
    }
}

/// The scores of smoothed estimates: mean squares, summed over cycles.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SmoothedScorecard {
    cycles: usize,
    lag_cycles: usize,
    error: Sums,
    spread: Option<Sums>,
    bias_error: Option<f64>,
    bias_spread: Option<f64>,
}

impl SmoothedScorecard {
    /// The scores of the estimate of the cycle so many ago; `None` if its truth is not known any more.
    pub fn of_cycle(
        truths: &EarlierTruths,
        cycles_ago: usize,
        estimate: &Estimate,
        lag_cycles: usize,
        scores_bias: bool,
    ) -> Option<Self> {
        let (state, calibration) = truths.ago(cycles_ago)?;
        let layout = estimate.state.layout();
        let biased = scores_bias && !calibration.is_empty();
        let spread = |it: &Vec<f64>| mean_squares(layout, it.iter().copied());
        Some(Self {
            cycles: 1,
            lag_cycles,
            error: mean_squares(layout, estimate.state.values().iter().zip(state).map(|(a, b)| a - b)),
            spread: estimate.state_spread.as_ref().map(spread),
            bias_error: biased.then(|| mean_square(estimate.calibration.iter().zip(calibration).map(|(a, b)| a - b))),
            bias_spread: match &estimate.calibration_spread {
                Some(spread) if biased => Some(mean_square(spread.iter().copied())),
                _ => None,
            },
        })
    }

    /// Takes in the scores of another cycle.
    pub fn add(&mut self, cycle: &Self) {
        self.cycles += cycle.cycles;
        add_sums(&mut self.error, &cycle.error);
        if let (Some(own), Some(other)) = (&mut self.spread, &cycle.spread) {
            add_sums(own, other);
        }
        for (own, other) in [(&mut self.bias_error, cycle.bias_error), (&mut self.bias_spread, cycle.bias_spread)] {
            if let (Some(own), Some(other)) = (own, other) {
                *own += other;
            }
        }
    }

    /// Roots of the mean squares, by name.
    pub fn scores(&self, layout: &Layout) -> SmoothedScores {
        let root = |sum: f64| (sum / self.cycles as f64).sqrt();
        let named = |sums: &Sums| -> PerVariable { named_roots(layout, sums, self.cycles) };
        SmoothedScores {
            lag_cycles: self.lag_cycles,
            rmse: named(&self.error),
            spread: self.spread.as_ref().map(named),
            bias_rmse: self.bias_error.map(root),
            bias_spread: self.bias_spread.map(root),
        }
    }
}
