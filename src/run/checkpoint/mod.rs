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

pub use file::{Newest, newest};
pub use keeper::Keeper;
pub use plan::{Plan, PlannedRun};

use crate::run::ahead::Ahead;
use crate::run::cycle::Progress;
use crate::run::experiment::{Competitor, Experiment};
use crate::run::truth::{SavedTruth, Truth};
use crate::scores::{EarlierTruths, Failure, ObservationCounts, RunScores, Scorecard};
use isobar_model::State;
use isobar_obs::SavedSystem;
use serde::{Deserialize, Serialize};

/// Everything about a run after a cycle but for the methods' own memory, which follows in the file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Of which run.
    pub plan: Plan,
    /// After which cycle.
    pub cycle: usize,
    /// Length of the journal then \[bytes\].
    pub journal_bytes: u64,
    truth: Option<SavedTruth>,
    reference: Option<State>,
    observing: SavedSystem,
    observations: ObservationCounts,
    earlier_truths: EarlierTruths,
    methods: Vec<SavedCompetitor>,
}

/// What is kept of a method beside its own memory.
#[derive(Debug, Serialize, Deserialize)]
struct SavedCompetitor {
    /// `None` once it has failed.
    progress: Option<Progress>,
    failure: Option<Failure>,
    total: Scorecard,
    ahead: Ahead,
}

impl Checkpoint {
    /// The state of an experiment after a cycle, and the memory of each method; empty for one that has failed.
    fn of(
        plan: &Plan,
        cycle: usize,
        journal_bytes: u64,
        experiment: &mut Experiment,
        scores: &RunScores,
    ) -> Result<(Self, Vec<Vec<u8>>), isobar_assim::Error> {
        let mut memories = Vec::new();
        let mut methods = Vec::new();
        for (Competitor { runner, failure, ahead, .. }, total) in experiment.methods.iter().zip(&scores.totals) {
            let progress = failure.is_none().then(|| runner.progress().clone());
            memories.push(if failure.is_none() { runner.save()? } else { Vec::new() });
            methods.push(SavedCompetitor {
                progress,
                failure: failure.clone(),
                total: total.clone(),
                ahead: ahead.clone(),
            });
        }
        let checkpoint = Self {
            plan: plan.clone(),
            cycle,
            journal_bytes,
            truth: experiment.truth.as_ref().map(Truth::save),
            reference: experiment.reference.as_ref().map(|reference| reference.state().clone()),
            observing: experiment.observing.save(),
            observations: scores.observations.clone(),
            earlier_truths: scores.earlier_truths.clone(),
            methods,
        };
        Ok((checkpoint, memories))
    }

    /// Sets an experiment that has just been built to this state; gives back the scores so far.
    ///
    /// # Errors
    /// In words, if it is the state of another experiment.
    pub fn restore(self, memories: &[Vec<u8>], experiment: &mut Experiment) -> Result<RunScores, String> {
        let count = experiment.methods.len();
        let fits = self.observing.cycle() == self.cycle && (1..=experiment.info.cycles).contains(&self.cycle);
        let fits = fits && self.methods.len() == count && memories.len() == count;
        let fits = fits && self.earlier_truths.fits(experiment.info.layout.len(), experiment.info.calibration.len());
        let fits = fits && self.methods.iter().all(|it| it.ahead.fits(self.cycle, &experiment.info));
        let reference_fits = match (&mut experiment.reference, self.reference) {
            (Some(reference), Some(saved)) => reference.restore(saved),
            (reference, saved) => reference.is_none() && saved.is_none(),
        };
        let truth_fits = match (&mut experiment.truth, self.truth) {
            (Some(truth), Some(saved)) => truth.restore(saved),
            (truth, saved) => truth.is_none() && saved.is_none(),
        };
        if !fits || !reference_fits || !truth_fits {
            return Err("it is not one of this experiment".into());
        }
        experiment.observing.restore(&self.observing).map_err(|error| error.to_string())?;
        let mut totals = Vec::with_capacity(count);
        for ((competitor, saved), memory) in experiment.methods.iter_mut().zip(self.methods).zip(memories) {
            if saved.progress.is_some() == saved.failure.is_some() {
                return Err("a method has neither memory nor a failure".into());
            }
            if let Some(progress) = saved.progress {
                let restored = competitor.runner.restore(memory, progress, &experiment.info.layout);
                restored.map_err(|error| error.to_string())?;
            }
            competitor.ahead = saved.ahead;
            competitor.failure = saved.failure;
            totals.push(saved.total);
        }
        Ok(RunScores { totals, observations: self.observations, earlier_truths: self.earlier_truths })
    }
}
