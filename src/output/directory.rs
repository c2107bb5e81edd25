//! The directory of a run's outputs: either complete under its final name, or not there at all.
//!
//! Beside the final directory `NAME` stands the working directory `.NAME.partial` until the run is complete:
//!
//! | in it | what |
//! |---|---|
//! | `lock` | locked by the process that works here |
//! | `outputs/` | the outputs in the making, which become `NAME` by being renamed |
//! | `complete` | there once the outputs are complete and durable |
//! | `replaced/` | for a moment: the outputs of an earlier run that they replace |
//! | `journal`, `checkpoint-…` | what it takes to resume the run (see [`crate::run::checkpoint`]) |
//! | `batch.json` | what it takes to continue a batch of runs, whose complete runs are in `outputs/` |
//!
//! Where there is `complete` but no `outputs/`, these have become `NAME`. So an end at any moment leaves one of the stages in
//! [`Stage`], and nothing complete is lost.

pub use crate::output::destination::{Existing, SEEDS_FILE, SUMMARY_FILE, SWEEP_FILE};
pub use crate::output::working::{CHECKPOINT_PREFIX, checkpoints};

use crate::output::destination::RUNS_DEPTH;
use crate::output::kept_runs::KeptRuns;
use crate::output::working::{self, WorkingDirectory};
use crate::output::{SinkError, contents, destination};
use crate::place::parent_of;
use crate::safe_file::{self, sync_directory};
use crate::shell::command;
use crate::text::shown_path;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The file in the working directory that says what a batch of runs was asked to do.
pub const BATCH_FILE: &str = "batch.json";

/// The journal of a run in its working directory, which begins with the run's plan.
pub const JOURNAL_FILE: &str = "journal";

/// What the mark of complete outputs holds if they replace others.
const OVERWRITES: &[u8] = b"overwrite";

const OUTPUTS: &str = "outputs";
const REPLACED: &str = "replaced";
const COMPLETE: &str = "complete";

/// How far the run got that worked in a working directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// There is no working directory.
    Absent,
    /// It was interrupted.
    Interrupted,
    /// Its outputs are complete, but do not have their final name.
    Complete,
    /// Its outputs have their final name, but something was left to be done.
    Published,
}

/// How far the run got that was to end in `destination`.
///
/// # Errors
/// If the working directory is not one that isobar made for this user.
pub fn stage(destination: &Path) -> Result<Stage, SinkError> {
    working::examine(destination)?;
    let working = working::path(destination)?;
    Ok(if working.exists() { stage_of(&working) } else { Stage::Absent })
}

fn stage_of(working: &Path) -> Stage {
    if !working.join(COMPLETE).exists() {
        Stage::Interrupted
    } else if working.join(OUTPUTS).exists() {
        Stage::Complete
    } else {
        Stage::Published
    }
}

/// Whether complete outputs hold a file, whether or not they have their final name yet.
///
/// # Errors
/// If the destination does not end in a name.
pub fn holds(destination: &Path, file: &str) -> Result<bool, SinkError> {
    let unnamed = working::path(destination)?.join(OUTPUTS);
    let outputs = if unnamed.exists() { &unnamed } else { destination };
    Ok(outputs.join(file).is_file())
}

/// Removes a working directory in which nothing is left to be gone on with.
pub fn tidy(destination: &Path) {
    // If another process uses it, that is not so.
    drop(OutputDirectory::lock(destination.to_path_buf(), Existing::Refuse));
}

/// A directory in which outputs are written beside the final one.
///
/// [`OutputDirectory::complete`] gives it its final name; dropped without that, it is removed with all that it holds, unless
/// it holds a checkpoint, complete runs of a batch, or complete outputs.
#[derive(Debug)]
pub struct OutputDirectory {
    working: WorkingDirectory,
    outputs: PathBuf,
    destination: PathBuf,
    existing: Existing,
}

impl OutputDirectory {
    /// Creates the working directory of a run whose outputs' final place is `destination`; missing parents are created.
    ///
    /// # Errors
    /// If `destination` exists and may not be replaced, if a run is under way there or was interrupted, or if nothing can
    /// be written beside it. A directory of several runs is never replaced by that of one.
    pub fn create(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        if existing == Existing::Overwrite {
            destination::check_single(&destination)?;
        }
        Self::create_any(destination, existing)
    }

    /// The same for a batch of runs.
    ///
    /// # Errors
    /// As [`OutputDirectory::create`], but the directory of other runs may be replaced.
    pub fn create_batch(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        Self::create_any(destination.into(), existing)
    }

    fn create_any(destination: PathBuf, existing: Existing) -> Result<Self, SinkError> {
        let working = working::path(&destination)?;
        destination::check(&destination, existing)?;
        let parent = parent_of(&destination);
        let cannot = |error: io::Error| SinkError {
            path: destination.clone(),
            reason: format!("no directory can be made there, choose another --out: {error}"),
        };
        fs::create_dir_all(parent).map_err(cannot)?;
        let directory = Self::lock(destination, existing)?;
        if existing == Existing::Refuse {
            directory.refuse_to_discard()?;
        }
        directory.put_back()?;
        // What was put back, or has come to be there since.
        destination::check(&directory.destination, existing)?;
        if directory.stage() == Stage::Published {
            // The mark last: until then replaced outputs are not taken for some to be put back.
            directory.working.clear(&[COMPLETE])?;
        }
        // Without these nothing is taken for a run to be gone on with, whenever this one ends.
        let mark = directory.working.path().join(COMPLETE);
        let kept = checkpoints(&working).into_iter().map(|(_, path)| path);
        for path in [mark, working.join(BATCH_FILE)].into_iter().chain(kept).filter(|path| path.exists()) {
            fs::remove_file(&path).map_err(|error| failure(&path, "cannot be removed", &error))?;
        }
        directory.working.clear(&[OUTPUTS])?;
        directory.empty_outputs()?;
        Ok(directory)
    }

    /// Refuses to discard what can be gone on with.
    fn refuse_to_discard(&self) -> Result<(), SinkError> {
        let kept = if self.stage() == Stage::Complete {
            "a run is complete there but for the name of its outputs: `{}` gives it to them".to_string()
        } else if let Some((cycle, _)) = checkpoints(self.working.path()).first() {
            format!("a run was interrupted there and is kept up to cycle {cycle}: `{{}}` continues it")
        } else if self.keeps_batch() {
            let kept = KeptRuns::of(&self.outputs);
            format!("a batch was interrupted there; {kept} are kept: `{{}}` runs the others")
        } else {
            return Ok(());
        };
        let reason = kept.replace("{}", &command("isobar resume", &[&self.destination])) + ", --overwrite discards it";
        Err(SinkError { path: self.destination.clone(), reason })
    }

    /// Opens the directory of an interrupted run again. Its outputs are made anew.
    ///
    /// # Errors
    /// If there is none, or a run is under way there.
    pub fn resume(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working::path(&destination)?;
        if checkpoints(&working).is_empty() {
            let reason = if destination.join(SUMMARY_FILE).is_file() {
                "the run is complete".into()
            } else {
                format!(
                    "there is no checkpoint in {}, so nothing of it is kept: begin the run anew",
                    shown_path(&working)
                )
            };
            return Err(SinkError { path: destination, reason });
        }
        let directory = Self::lock(destination, existing)?;
        if directory.stage() != Stage::Interrupted {
            let reason = "the run is complete".into();
            return Err(SinkError { path: directory.destination.clone(), reason });
        }
        directory.put_back()?;
        directory.empty_outputs()?;
        Ok(directory)
    }

    /// Opens the directory of an interrupted batch again, with its complete runs and those that have a checkpoint.
    ///
    /// # Errors
    /// If there is none, or it is under way.
    pub fn resume_batch(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working::path(&destination)?;
        if !working.join(BATCH_FILE).is_file() {
            return Err(SinkError { path: destination, reason: "no batch was interrupted there".into() });
        }
        let directory = Self::lock(destination, existing)?;
        if directory.stage() != Stage::Interrupted {
            let reason = "the batch is complete".into();
            return Err(SinkError { path: directory.destination.clone(), reason });
        }
        directory.put_back()?;
        working::clear_runs(&directory.outputs, RUNS_DEPTH, &|run| !checkpoints(run).is_empty())?;
        Ok(directory)
    }

    /// Opens the directory of a run, or batch, that is complete but for what comes after that. It is to be published, if it
    /// has not been, and cleared away.
    ///
    /// # Errors
    /// If there is none, or another process is about to do this.
    pub fn finish(destination: impl Into<PathBuf>) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working::path(&destination)?;
        let mut directory = Self::lock(destination, Existing::Refuse)?;
        if directory.stage() == Stage::Interrupted {
            let reason = "there is nothing to be finished".into();
            return Err(SinkError { path: directory.destination.clone(), reason });
        }
        let mark = safe_file::read(&working.join(COMPLETE), OVERWRITES.len() as u64).unwrap_or_default();
        if mark == OVERWRITES {
            directory.existing = Existing::Overwrite;
        }
        Ok(directory)
    }

    fn lock(destination: PathBuf, existing: Existing) -> Result<Self, SinkError> {
        let working = WorkingDirectory::lock(&destination)?;
        let outputs = working.path().join(OUTPUTS);
        Ok(Self { working, outputs, destination, existing })
    }

    /// How far the run got.
    pub fn stage(&self) -> Stage {
        stage_of(self.working.path())
    }

    /// Whether there is a batch to continue.
    fn keeps_batch(&self) -> bool {
        self.working.path().join(BATCH_FILE).is_file() && !KeptRuns::of(&self.outputs).is_empty()
    }

    /// Outputs that were about to be replaced go back to their place, if they have not been replaced.
    fn put_back(&self) -> Result<(), SinkError> {
        let replaced = self.working.path().join(REPLACED);
        if !replaced.exists() || self.stage() == Stage::Published {
            return Ok(());
        }
        if fs::symlink_metadata(&self.destination).is_ok() {
            let reason = format!("the outputs of an earlier run are in {}: move them away", shown_path(&replaced));
            return Err(SinkError { path: self.destination.clone(), reason });
        }
        fs::rename(&replaced, &self.destination).map_err(|error| failure(&replaced, "cannot be put back", &error))
    }

    /// Leaves no outputs of an earlier attempt. The directory itself stays: where it is missing, it has become the destination.
    fn empty_outputs(&self) -> Result<(), SinkError> {
        match fs::create_dir(&self.outputs) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => working::clear(&self.outputs, &|_| false),
            made => made.map_err(|error| failure(&self.outputs, "cannot be created", &error)),
        }
    }

    /// Where outputs are written until they are complete.
    pub fn path(&self) -> &Path {
        &self.outputs
    }

    /// Where journal and checkpoints are.
    pub fn working(&self) -> &Path {
        self.working.path()
    }

    /// Where the outputs will be when complete.
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Moves the outputs to their final name, and removes those that were there before.
    ///
    /// # Errors
    /// As [`OutputDirectory::publish`] and [`OutputDirectory::clear_away`].
    pub fn complete(self) -> Result<(), SinkError> {
        self.publish()?;
        self.clear_away()
    }

    /// Moves the outputs to their final name. Those that were there before are kept until all is cleared away.
    ///
    /// # Errors
    /// If the destination has meanwhile come to be something that may not be replaced, or if it cannot be renamed; what
    /// was there before is then there again, and the outputs are kept, so that this can be done later.
    pub fn publish(&self) -> Result<(), SinkError> {
        let Self { working, outputs, destination, existing } = self;
        if self.stage() == Stage::Published {
            return Ok(());
        }
        let replaced = working.path().join(REPLACED);
        if !replaced.exists() {
            // Runs of a batch that have failed for good may have left checkpoints.
            working::clear_runs(outputs, RUNS_DEPTH, &|_| false)?;
            self.mark_complete().map_err(|error| failure(destination, "the outputs cannot be stored", &error))?;
        }
        destination::check(destination, *existing)?;
        let exists = fs::symlink_metadata(destination).is_ok();
        if exists {
            let moved = fs::rename(destination, &replaced);
            moved.map_err(|error| failure(destination, "cannot move the old outputs away", &error))?;
        }
        // Once more: by now nobody finds the old outputs under their name to put something beside them.
        let checked = if exists { contents::check(&replaced) } else { Ok(()) };
        let renamed = checked.and_then(|()| {
            fs::rename(outputs, destination)
                .map_err(|error| failure(destination, "cannot move the outputs there", &error))
        });
        if let Err(mut failed) = renamed {
            failed.path = destination.clone();
            if exists && let Err(error) = fs::rename(&replaced, destination) {
                let place = shown_path(&replaced);
                failed.reason += &format!("; the old outputs are in {place} and could not be put back: {error}");
            }
            return Err(failed);
        }
        let _ = sync_directory(parent_of(destination));
        Ok(())
    }

    /// Makes the outputs durable, with the list of their files, and takes note of that.
    fn mark_complete(&self) -> io::Result<()> {
        contents::list(&self.outputs)?;
        let mut mark = safe_file::create(&self.working.path().join(COMPLETE))?;
        mark.write_all(if self.existing == Existing::Overwrite { OVERWRITES } else { b"" })?;
        mark.sync_all()?;
        sync_directory(self.working.path())
    }

    /// Removes the working directory of outputs that have their final name.
    ///
    /// # Errors
    /// What cannot be removed; the outputs are complete all the same.
    pub fn clear_away(&self) -> Result<(), SinkError> {
        // The mark last: until then replaced outputs are not taken for some to be put back.
        let removed = self.working.clear(&[COMPLETE]).and_then(|()| self.working.remove());
        removed.map_err(|error| SinkError {
            reason: format!("the outputs are complete, but this remains: {}", error.reason),
            ..error
        })
    }

    /// Whether there is something that must not be lost, whatever becomes of this attempt.
    fn is_kept(&self) -> bool {
        let working = self.working.path();
        let old = working.join(REPLACED).exists();
        match self.stage() {
            Stage::Absent => false,
            Stage::Interrupted => old || !checkpoints(working).is_empty() || self.keeps_batch(),
            Stage::Complete => true,
            // What is left to be done is in its plan.
            Stage::Published => working.join(JOURNAL_FILE).exists(),
        }
    }
}

impl Drop for OutputDirectory {
    fn drop(&mut self) {
        // Only the owner of the lock removes: it is still held here.
        if !self.is_kept() {
            let _ = self.working.remove();
        }
    }
}

fn failure(path: &Path, what: &str, error: &io::Error) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: format!("{what}: {error}") }
}

#[cfg(test)]
#[path = "directory_tests.rs"]
mod tests;
