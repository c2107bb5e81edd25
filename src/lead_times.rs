//! When forecasts ahead start, and at which lead times they are looked at.

use serde::{Deserialize, Serialize};

/// When forecasts ahead start, and at which lead times they are looked at, in cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeadTimes {
    /// How far a forecast goes.
    pub longest_cycles: usize,
    /// Lead times are multiples of this; so is the longest.
    pub every_cycles: usize,
    /// The number of cycles from one start to the next.
    pub from_every_cycles: usize,
}

impl LeadTimes {
    /// The lead times from 0, the analysis itself, to the longest.
    pub fn kept(&self) -> impl Iterator<Item = usize> {
        (0..=self.longest_cycles).step_by(self.every_cycles)
    }

    /// Whether there is a forecast from the analysis of a cycle, if the first of them starts from cycle `first`.
    pub fn starts_from(&self, cycle: usize, first: usize) -> bool {
        cycle.checked_sub(first).is_some_and(|after| after.is_multiple_of(self.from_every_cycles))
    }

    /// The first start after cycle `done`, if the first of all is from cycle `first`.
    pub fn first_start(&self, first: usize, done: usize) -> usize {
        let after = (done + 1).saturating_sub(first);
        first + after.next_multiple_of(self.from_every_cycles)
    }

    /// The last start from cycle `first` on whose forecast reaches the longest lead time within a run of `cycles`; `first` if
    /// there is none.
    pub fn last_complete_start(&self, first: usize, cycles: usize) -> usize {
        let after = cycles.saturating_sub(self.longest_cycles).saturating_sub(first);
        first + after / self.from_every_cycles * self.from_every_cycles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_and_lead_times_are_multiples_from_the_first_on() {
        let times = LeadTimes { longest_cycles: 6, every_cycles: 2, from_every_cycles: 4 };
        assert_eq!(times.kept().collect::<Vec<_>>(), [0, 2, 4, 6]);
        assert_eq!((1..15).filter(|&cycle| times.starts_from(cycle, 3)).collect::<Vec<_>>(), [3, 7, 11]);
        assert_eq!([20, 17, 16, 9, 5].map(|cycles| times.last_complete_start(3, cycles)), [11, 11, 7, 3, 3]);
        assert_eq!([0, 2, 3, 6, 7].map(|done| times.first_start(3, done)), [3, 3, 7, 7, 11]);
    }
}
