//! Runs that are complete, read back from their directories.

pub mod recording;
mod scores;

pub use scores::{MethodSeries, Scores};

use crate::output::directory::SUMMARY_FILE;
use crate::output::summary::TRUTH_CHECKSUM;
use crate::safe_file::read_named;
use crate::scores::Summary;
use crate::text::{clean, shown_path};
use miette::Diagnostic;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// The largest file that is read \[bytes\].
const LARGEST_FILE: u64 = 1_000_000_000;

/// Why a directory is not that of a run that can be read.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{}: {reason}", shown_path(path))]
pub struct SavedRunError {
    /// The directory, or a file in it.
    pub path: PathBuf,
    /// Why not.
    pub reason: String,
    /// What to do.
    #[help]
    pub help: Option<String>,
}

impl SavedRunError {
    fn new(path: &Path, reason: impl ToString) -> Self {
        // Part of it may be what a file says.
        Self { path: path.to_path_buf(), reason: clean(&reason.to_string()), help: None }
    }

    fn with_help(self, help: impl ToString) -> Self {
        Self { help: Some(clean(&help.to_string())), ..self }
    }
}

/// A complete run.
#[derive(Clone, Debug)]
pub struct SavedRun {
    /// Its directory.
    pub directory: PathBuf,
    /// Its scores.
    pub summary: Summary,
    /// A checksum that identifies its truth; `None` without one.
    pub truth_checksum: Option<u64>,
}

impl SavedRun {
    /// Opens the directory of a run.
    ///
    /// # Errors
    /// If the directory is not that of a run, is incomplete, or was written by another version.
    pub fn open(directory: &Path) -> Result<Self, SavedRunError> {
        let failure = |reason: &str| SavedRunError::new(directory, reason);
        if !directory.exists() {
            return Err(
                failure("there is no such directory").with_help("a complete run leaves one, by default below ./out")
            );
        }
        if !directory.is_dir() {
            return Err(failure("it is a file, not the directory of a run"));
        }
        let path = directory.join(SUMMARY_FILE);
        if !path.is_file() {
            let error = failure("it holds no summary.json, so it is not the output of a complete run");
            return Err(match runs_below(directory) {
                runs if runs.is_empty() => error.with_help("a run that fails or is broken off leaves nothing behind"),
                runs => error.with_help(format!("below it there are: {}", runs.join(", "))),
            });
        }
        Self::parse(&read(&path)?, directory, &path)
    }

    /// The run in a directory, from the text of its summary, the file `path`.
    ///
    /// # Errors
    /// If the text is not a summary, or was written by another version.
    pub fn parse(text: &str, directory: &Path, path: &Path) -> Result<Self, SavedRunError> {
        let document: Value = serde_json::from_str(text).unwrap_or_default();
        let own = env!("CARGO_PKG_VERSION");
        let version = document.get("version").and_then(Value::as_str);
        if let Some(version) = version.filter(|version| *version != own) {
            let error =
                SavedRunError::new(directory, format!("it was written by isobar {version}, and this is isobar {own}"));
            return Err(error.with_help(format!("run it again with this version, or use isobar {version}")));
        }
        let summary: Summary = serde_json::from_str(text)
            .map_err(|error| SavedRunError::new(path, format!("it is not the summary of a run: {error}")))?;
        let truth_checksum = document.get(TRUTH_CHECKSUM).and_then(Value::as_u64);
        Ok(Self { directory: directory.to_path_buf(), summary, truth_checksum })
    }
}

/// The text of a file.
fn read(path: &Path) -> Result<String, SavedRunError> {
    let failure = |reason: String| SavedRunError::new(path, format!("it cannot be read: {reason}"));
    let bytes = read_named(path, LARGEST_FILE).map_err(|error| failure(error.to_string()))?;
    String::from_utf8(bytes).map_err(|error| failure(error.to_string()))
}

/// Directories of runs directly below, by name.
fn runs_below(directory: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(directory) else { return Vec::new() };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut runs: Vec<String> =
        paths.filter(|path| path.join(SUMMARY_FILE).is_file()).map(|path| path.display().to_string()).collect();
    runs.sort();
    runs.truncate(10);
    runs
}
