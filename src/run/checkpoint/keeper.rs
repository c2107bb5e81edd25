//! Keeps the journal of a run under way, and writes its checkpoints when they are due.

use super::journal::Journal;
use super::{Checkpoint, Plan, file};
use crate::event::Event;
use crate::options::CheckpointPolicy;
use crate::output::SinkError;
use crate::run::experiment::Experiment;
use crate::scores::RunScores;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Checkpoints take at most one part in this number of the run's time.
const TIME_BETWEEN_PER_TIME_OF_ONE: u32 = 100;

/// The journal and the checkpoints of a run.
#[derive(Debug)]
pub struct Keeper {
    directory: PathBuf,
    plan: Plan,
    policy: CheckpointPolicy,
    journal: Journal,
    /// When and after which cycle the last checkpoint was written, or the run began.
    last: (Instant, usize),
    /// How long the last one took.
    cost: Duration,
}

impl Keeper {
    /// Begins a run whose earlier runs have done this number of cycles.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn start(directory: &Path, plan: Plan, policy: CheckpointPolicy, done: usize) -> Result<Self, SinkError> {
        let journal = Journal::create(directory, &plan)?;
        Ok(Self::new(directory, plan, policy, journal, done))
    }

    /// Continues after the checkpoint of a cycle, when the journal had this number of bytes.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn resume(
        directory: &Path,
        plan: Plan,
        policy: CheckpointPolicy,
        cycle: usize,
        journal_bytes: u64,
    ) -> Result<Self, SinkError> {
        let journal = Journal::resume(directory, journal_bytes)?;
        Ok(Self::new(directory, plan, policy, journal, cycle))
    }

    fn new(directory: &Path, plan: Plan, policy: CheckpointPolicy, journal: Journal, cycle: usize) -> Self {
        let (directory, cost) = (directory.to_path_buf(), Duration::ZERO);
        Self { directory, plan, policy, journal, last: (Instant::now(), cycle), cost }
    }

    /// Takes note of an event.
    ///
    /// # Errors
    /// If the journal cannot be written.
    pub fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.journal.record(event)
    }

    /// Whether a checkpoint is due after a cycle.
    pub fn is_due(&self, cycle: usize) -> bool {
        let (when, last) = self.last;
        let elapsed = when.elapsed();
        let by_cycles = self.policy.cycles.is_some_and(|cycles| cycle - last >= cycles);
        let by_time = self.policy.minutes.is_some_and(|minutes| elapsed.as_secs_f64() >= 60.0 * minutes);
        by_cycles || (by_time && elapsed >= TIME_BETWEEN_PER_TIME_OF_ONE * self.cost)
    }

    /// Writes a checkpoint after a cycle that does not have one yet.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, cycle: usize, experiment: &mut Experiment, scores: &RunScores) -> Result<(), SinkError> {
        let began = Instant::now();
        let journal_bytes = self.journal.sync()?;
        let checkpoint = Checkpoint::of(&self.plan, cycle, journal_bytes, experiment, scores);
        file::write(&self.directory, &checkpoint, experiment)?;
        self.cost = began.elapsed();
        self.last = (Instant::now(), cycle);
        Ok(())
    }
}
