//! The file of a checkpoint: written beside its place and renamed, so that it is there complete or not at all.

use super::saved::save;
use super::{Checkpoint, Plan};
use crate::output::SinkError;
use crate::output::directory::{CHECKPOINT_PREFIX, checkpoints};
use crate::run::experiment::Experiment;
use crate::safe_file::sync_directory;
use crate::sealed::{Contents, Format, Memories};
use crate::text::clean;
use std::fs::{self, File};
use std::io::Cursor;
use std::path::{Path, PathBuf};

const FORMAT: Format = Format { name: "checkpoint", number: 8 };

/// How many checkpoints are kept.
const KEPT: usize = 2;

/// Writes a checkpoint of an experiment, with the memories of its methods, and removes those that are no longer needed.
///
/// # Errors
/// If it cannot be written; those that were there are as they were.
pub fn write(directory: &Path, checkpoint: &Checkpoint, experiment: &Experiment) -> Result<(), SinkError> {
    let path = directory.join(format!("{CHECKPOINT_PREFIX}{:010}", checkpoint.saved.cycle));
    let temporary = path.with_extension("new");
    let written = FORMAT
        .write(&temporary, checkpoint, experiment.methods.len(), &|number, to| save(experiment, number, to))
        .and_then(|()| fs::rename(&temporary, &path))
        .and_then(|()| sync_directory(directory));
    if let Err(error) = written {
        let _ = fs::remove_file(&temporary);
        return Err(SinkError { path, reason: error.to_string() });
    }
    for (_, old) in checkpoints(directory).into_iter().skip(KEPT) {
        // One more than needed does no harm.
        let _ = fs::remove_file(old);
    }
    Ok(())
}

/// Gives a checkpoint that cannot be used another name.
pub fn put_aside(path: &Path) {
    let name = path.file_name().unwrap_or_default().to_string_lossy().replace(CHECKPOINT_PREFIX, "damaged-");
    // If that fails, it is only read and refused again.
    let _ = fs::rename(path, path.with_file_name(name));
}

/// Reads a checkpoint, with the memories of the methods.
///
/// # Errors
/// In words, if it is damaged or was written by another version.
pub fn read(path: &Path) -> Result<Contents<Checkpoint, File>, String> {
    FORMAT.read(path)
}

/// A checkpoint from the bytes of its file.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8]) -> Result<Contents<Checkpoint, Cursor<&[u8]>>, String> {
    FORMAT.parse(bytes)
}

/// The newest checkpoint that can be used, and those that cannot.
pub struct Newest {
    /// The checkpoint.
    pub checkpoint: Checkpoint,
    /// The methods' memories.
    pub memories: Memories<File>,
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
        match read(&path).and_then(|contents| match plan.difference(&contents.head.plan) {
            None => Ok(contents),
            Some(difference) => Err(difference),
        }) {
            Ok(Contents { head: checkpoint, memories, .. }) => return Ok(Newest { checkpoint, memories, damaged }),
            Err(reason) => damaged.push((path, reason)),
        }
    }
    let reasons = damaged
        .iter()
        .map(|(path, reason)| format!("{}: {reason}", clean(&path.file_name().unwrap_or_default().to_string_lossy())));
    Err(format!("no checkpoint can be used ({})", reasons.collect::<Vec<_>>().join("; ")))
}
