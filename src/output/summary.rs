//! `summary.json`: the scores of a run.

use crate::event::Event;
use crate::output::directory::{OutputDirectory, SUMMARY_FILE};
use crate::output::{Sink, SinkError};
use std::fs;
use std::path::PathBuf;

/// Writes the scores of the run when it is complete.
#[derive(Debug)]
pub struct SummarySink {
    path: PathBuf,
}

impl SummarySink {
    /// A sink that writes into `directory`.
    pub fn new(directory: &OutputDirectory) -> Self {
        Self { path: directory.path().join(SUMMARY_FILE) }
    }
}

impl Sink for SummarySink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let Event::Finished(summary) = event else { return Ok(()) };
        let failure = |reason: String| SinkError { path: self.path.clone(), reason };
        let mut text = serde_json::to_string_pretty(summary).map_err(|error| failure(error.to_string()))?;
        text.push('\n');
        fs::write(&self.path, text).map_err(|error| failure(error.to_string()))
    }
}
