//! Checkpoints: a run that ends before its time goes on where it was, to the same bits.
//!
//! The working directory of a run (see [`OutputDirectory`](crate::sink::OutputDirectory)) holds, beside the outputs in the
//! making,
//!
//! - the [`journal`]: every event of the run, appended as it happens. The outputs are functions of the events, so that a
//!   resumed run makes them anew from the journal: none of them needs to be found in a consistent state.
//! - the two newest checkpoints ([`mod@file`]): the memory of truth, observing systems and methods after a cycle, the scores so
//!   far, and the length of the journal then. What the journal holds beyond that is cut off.
//!
//! A checkpoint is due after a number of minutes or of cycles, but never so soon that checkpoints take more than a hundredth
//! of the time.

mod entry;
pub mod file;
pub mod journal;
mod keeper;
mod plan;

pub use keeper::Keeper;
pub use plan::{Plan, PlannedRun};

use crate::experiment::{Competitor, Experiment};
use crate::run::cycle::SavedRunner;
use crate::run::reference::Reference;
use crate::run::truth::SavedTruth;
use crate::sink::directory::checkpoints;
use crate::smoothed::EarlierTruths;
use crate::summary::{Failure, ObservationCounts};
use crate::text::clean;
use crate::verify::{Scorecard, Scores};
use isobar_obs::SavedSystem;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Everything about a run after a cycle but for the methods' own memory, which follows in the file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Of which run.
    pub plan: Plan,
    /// After which cycle.
    pub cycle: usize,
    /// Length of the journal then \[bytes\].
    pub journal_bytes: u64,
    truth: SavedTruth,
    reference: Option<Vec<f64>>,
    observing: SavedSystem,
    observations: ObservationCounts,
    earlier_truths: EarlierTruths,
    methods: Vec<SavedCompetitor>,
}

/// What is kept of a method beside its own memory.
#[derive(Debug, Serialize, Deserialize)]
struct SavedCompetitor {
    /// `None` once it has failed.
    runner: Option<SavedRunner>,
    failure: Option<Failure>,
    total: Scorecard,
}

impl Checkpoint {
    /// The state of an experiment after a cycle, and the memory of each method; empty for one that has failed.
    fn of(
        plan: &Plan,
        cycle: usize,
        journal_bytes: u64,
        experiment: &mut Experiment,
        scores: &Scores,
    ) -> Result<(Self, Vec<Vec<u8>>), isobar_assim::Error> {
        let mut memories = Vec::new();
        let mut methods = Vec::new();
        for (Competitor { runner, failure, .. }, total) in experiment.methods.iter().zip(&scores.totals) {
            let (memory, saved) = match failure {
                None => runner.save().map(|(memory, saved)| (memory, Some(saved)))?,
                Some(_) => (Vec::new(), None),
            };
            memories.push(memory);
            methods.push(SavedCompetitor { runner: saved, failure: failure.clone(), total: total.clone() });
        }
        let checkpoint = Self {
            plan: plan.clone(),
            cycle,
            journal_bytes,
            truth: experiment.truth.save(),
            reference: experiment.reference.as_ref().map(Reference::save),
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
    pub fn restore(self, memories: &[Vec<u8>], experiment: &mut Experiment) -> Result<Scores, String> {
        let count = experiment.methods.len();
        let fits = self.observing.cycle() == self.cycle && (1..=experiment.info.cycles).contains(&self.cycle);
        let fits = fits && self.methods.len() == count && memories.len() == count;
        let fits = fits && self.earlier_truths.fits(experiment.info.layout.len(), experiment.info.calibration.len());
        let reference_fits = match (&mut experiment.reference, &self.reference) {
            (Some(reference), Some(saved)) => reference.restore(saved),
            (reference, saved) => reference.is_none() && saved.is_none(),
        };
        if !fits || !reference_fits || !experiment.truth.restore(&self.truth) {
            return Err("it is not one of this experiment".into());
        }
        experiment.observing.restore(&self.observing).map_err(|error| error.to_string())?;
        let mut totals = Vec::with_capacity(count);
        for ((competitor, saved), memory) in experiment.methods.iter_mut().zip(self.methods).zip(memories) {
            if let Some(runner) = &saved.runner {
                competitor
                    .runner
                    .restore(memory, runner, &experiment.info.layout)
                    .map_err(|error| error.to_string())?;
            }
            if saved.runner.is_some() == saved.failure.is_some() {
                return Err("a method has neither memory nor a failure".into());
            }
            competitor.failure = saved.failure;
            totals.push(saved.total);
        }
        Ok(Scores { totals, observations: self.observations, earlier_truths: self.earlier_truths })
    }
}

/// The newest checkpoint that can be used, and those that cannot.
pub struct Newest {
    /// The checkpoint.
    pub checkpoint: Checkpoint,
    /// The methods' memories.
    pub memories: Vec<Vec<u8>>,
    /// The newer ones, and why they cannot be used.
    pub damaged: Vec<(PathBuf, String)>,
}

/// Finds the newest checkpoint of a run in its working directory.
///
/// # Errors
/// In words, if none can be used.
pub fn newest(working: &Path, plan: &Plan) -> Result<Newest, String> {
    let mut damaged = Vec::new();
    for (_, path) in checkpoints(working) {
        match file::read(&path).and_then(|(checkpoint, memories)| match plan.difference(&checkpoint.plan) {
            None => Ok((checkpoint, memories)),
            Some(difference) => Err(difference.to_string()),
        }) {
            Ok((checkpoint, memories)) => return Ok(Newest { checkpoint, memories, damaged }),
            Err(reason) => damaged.push((path, reason)),
        }
    }
    let reasons = damaged
        .iter()
        .map(|(path, reason)| format!("{}: {reason}", clean(&path.file_name().unwrap_or_default().to_string_lossy())));
    Err(format!("no checkpoint can be used ({})", reasons.collect::<Vec<_>>().join("; ")))
}
