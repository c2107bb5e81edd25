//! Sinks hear the events of a run and write files. None of them changes the run.

use crate::event::Event;
use std::path::PathBuf;

/// Something that hears the events of a run.
pub trait Sink {
    /// Takes note of an event.
    ///
    /// # Errors
    /// What could not be written, and where.
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError>;
}

/// An output that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {reason}", path.display())]
pub struct SinkError {
    /// The file or directory.
    pub path: PathBuf,
    /// Why not.
    pub reason: String,
}
