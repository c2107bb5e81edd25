//! Checkpoints: an interrupted run continues where it was, to the same bits.
//!
//! The working directory of a run (see [`OutputDirectory`](crate::output::OutputDirectory)) holds, beside the outputs in the
//! making,
//!
//! - the [`journal`]: every event of the run, appended as it happens. The outputs are functions of the events, so that a
//!   resumed run makes them anew from the journal: none of them needs to be found in a consistent state.
//! - the two newest checkpoints ([`mod@file`]): the memory of truth, observing systems and methods after a cycle, the scores so
//!   far, and the length of the journal then. What the journal holds beyond that is cut off.
//!
//! A checkpoint is due after a number of minutes or of cycles, but never so soon that checkpoints take more than a hundredth
//! of the time.

pub mod file;
pub mod journal;
mod keeper;
mod plan;
pub mod saved;

pub use file::{Newest, newest};
pub use keeper::Keeper;
pub use plan::{Plan, PlannedRun};

use crate::run::experiment::Experiment;
use crate::scores::{EarlierTruths, ObservationCounts, RunScores, Scorecard};
use crate::sealed::Memories;
use saved::Saved;
use serde::{Deserialize, Serialize};
use std::io::{Read, Seek};

/// Everything about a run after a cycle but for the methods' own memory, which follows in the file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Of which run.
    pub plan: Plan,
    /// Length of the journal then \[bytes\].
    pub journal_bytes: u64,
    /// Truth, observing systems and methods.
    pub saved: Saved,
    observations: ObservationCounts,
    earlier_truths: EarlierTruths,
    /// Of the methods, in their order.
    totals: Vec<Scorecard>,
}

impl Checkpoint {
    /// The state of an experiment after a cycle.
    fn of(plan: &Plan, cycle: usize, journal_bytes: u64, experiment: &mut Experiment, scores: &RunScores) -> Self {
        let RunScores { totals, observations, earlier_truths } = scores.clone();
        let saved = Saved::of(cycle, experiment);
        Self { plan: plan.clone(), journal_bytes, saved, observations, earlier_truths, totals }
    }

    /// Sets an experiment that has just been built to this state; gives back the scores so far.
    ///
    /// # Errors
    /// In words, if it is the state of another experiment.
    pub fn restore<F: Read + Seek>(
        self,
        memories: &mut Memories<F>,
        experiment: &mut Experiment,
    ) -> Result<RunScores, String> {
        let Self { saved, observations, earlier_truths, totals, .. } = self;
        let fits = earlier_truths.fits(experiment.info.layout.len(), experiment.info.calibration.len());
        let count = experiment.methods.len();
        let is_of_run = saved.cycle > experiment.info.done;
        if !fits || !is_of_run || totals.len() != count || saved.methods.len() != count {
            return Err("it is not one of this experiment".into());
        }
        saved.restore(memories, experiment)?;
        Ok(RunScores { totals, observations, earlier_truths })
    }
}
