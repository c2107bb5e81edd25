//! Which cycles a run has.

use crate::run::earlier::Earlier;
use crate::scenario::Scenario;
use isobar_model::Time;
use std::ops::RangeInclusive;

/// The cycles of a run, as a part of those since the first of the runs from which it goes on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Valid time of the state before cycle 1.
    pub start: Time,
    /// The last cycle of earlier runs; 0 without any.
    pub done: usize,
    /// The last cycle.
    pub last: usize,
}

impl Span {
    /// The cycles of a run of a scenario, or this number of cycles.
    pub fn new(scenario: &Scenario, count: Option<usize>, earlier: Option<&Earlier>) -> Self {
        let (start, done) = earlier.map_or((scenario.start, 0), |earlier| (earlier.start, earlier.cycles));
        Self { start, done, last: done + count.unwrap_or(scenario.cycle.count) }
    }

    /// Their numbers.
    pub fn cycles(self) -> RangeInclusive<usize> {
        self.done + 1..=self.last
    }
}
