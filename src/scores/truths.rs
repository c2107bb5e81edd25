//! The truth of a cycle, and the truths of the cycles before it, which smoothed estimates meet.

use isobar_model::State;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The truth of one cycle.
#[derive(Clone, Copy)]
pub struct TrueValues<'a> {
    /// The state.
    pub state: &'a State,
    /// The calibration parameters, in the order of [`isobar_obs::Calibration`]; nothing for those of recorded observations.
    pub calibration: &'a [Option<f64>],
}

/// The truth, as estimates of the same time are compared with it.
#[derive(Clone, Copy)]
pub struct Truth<'a> {
    /// The true state, in the order of [`State::values`].
    pub state: &'a [f64],
    /// The true calibration parameters, where they are known.
    pub calibration: &'a [Option<f64>],
}

impl<'a> From<TrueValues<'a>> for Truth<'a> {
    fn from(truth: TrueValues<'a>) -> Self {
        Self { state: truth.state.values(), calibration: truth.calibration }
    }
}

/// The truths of the last cycles, as far back as estimates are smoothed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EarlierTruths {
    /// State and calibration, the newest last.
    cycles: VecDeque<(Vec<f64>, Vec<Option<f64>>)>,
}

impl EarlierTruths {
    /// Adds the truth of a cycle and keeps this number of cycles before it; with `None` no truth is kept at all.
    pub fn add(&mut self, truth: TrueValues<'_>, before: Option<usize>) {
        let Some(before) = before else { return };
        self.cycles.push_back((truth.state.values().to_vec(), truth.calibration.to_vec()));
        while self.cycles.len() > before + 1 {
            self.cycles.pop_front();
        }
    }

    /// State and calibration a number of cycles ago.
    pub(super) fn ago(&self, cycles: usize) -> Option<Truth<'_>> {
        let (state, calibration) = self.cycles.get(self.cycles.len().checked_sub(cycles + 1)?)?;
        Some(Truth { state, calibration })
    }

    /// Whether all states and calibrations have these lengths.
    pub fn fits(&self, values: usize, parameters: usize) -> bool {
        self.cycles.iter().all(|(state, calibration)| state.len() == values && calibration.len() == parameters)
    }
}
