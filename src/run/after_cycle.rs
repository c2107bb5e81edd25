//! What is to be done after a cycle, as all ranks of a run decide it.

use super::checkpoint::Keeper;
use super::error::RunError;
use crate::interrupt;
use crate::outcome::Outcome;
use isobar_assim::Estimate;
use isobar_model::communicator::Communicator;

/// What is to be done after a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AfterCycle {
    /// Whether a checkpoint is written.
    pub keeps: bool,
    /// Whether the run ends.
    pub ends: bool,
}

/// Decides what is to be done after a cycle: rank 0 knows when a checkpoint is due, and each rank may have been asked to end.
///
/// # Errors
/// If a rank has come to other results than rank 0.
pub(super) fn after_cycle(
    communicator: &dyn Communicator,
    cycle: usize,
    keeper: Option<&Keeper>,
    results: &Results,
) -> Result<AfterCycle, RunError> {
    let is_due = keeper.is_some_and(|keeper| keeper.is_due(cycle));
    let flags = [keeper.is_some(), is_due, interrupt::requested()].map(|flag| f64::from(u8::from(flag)));
    let all = communicator.gather_all(&[&flags[..], &[results.digest()]].concat());
    if let Some(rank) = all.iter().position(|of_rank| of_rank[3] != all[0][3]) {
        return Err(RunError::Disagreement { cycle, rank });
    }
    let ends = all.iter().any(|of_rank| of_rank[2] != 0.0);
    if ends {
        interrupt::request_end();
    }
    Ok(AfterCycle { keeps: all[0][0] != 0.0 && (all[0][1] != 0.0 || ends), ends })
}

/// A digest of the results of a rank, by which it is seen whether all have the same.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Results(u64);

impl Results {
    /// Takes up what a method has come to; `None`: it has failed.
    pub fn add(&mut self, outcome: Option<&Outcome>) {
        let Some(Outcome { background, analysis, .. }) = outcome else { return self.mix(u64::MAX) };
        for Estimate { state, calibration, .. } in [background, &analysis.estimate] {
            state.values().iter().chain(calibration).for_each(|value| self.mix(value.to_bits()));
        }
        self.mix(analysis.innovation_chi2.map_or(0, f64::to_bits));
    }

    /// The step of the FNV hash, with words for bytes; the upper half is mixed into the lower, where it would not come by itself.
    fn mix(&mut self, word: u64) {
        let product = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 = product ^ (product >> 32);
    }

    /// As a number that is sent without rounding.
    fn digest(self) -> f64 {
        (self.0 >> 12) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::testing::on_ranks;

    #[test]
    fn ranks_with_other_results_are_found() {
        let after = |faulty: Option<usize>| {
            on_ranks(3, |communicator| {
                let mut results = Results::default();
                results.mix(1);
                results.mix(u64::from(faulty == Some(communicator.rank())));
                after_cycle(&communicator, 4, None, &results).map_err(|error| error.to_string())
            })
        };
        assert_eq!(after(None), vec![Ok(AfterCycle { keeps: false, ends: false }); 3]);
        assert!(after(Some(2)).iter().all(|it| it.as_ref().is_err_and(|error| error.contains("rank 2"))));
    }
}
