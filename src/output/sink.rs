//! What every output is to a run: something that hears its events.

use crate::event::Event;
use crate::text::shown_path;
use std::path::PathBuf;

/// Something that hears the events of a run.
pub trait Sink {
    /// Takes note of an event.
    ///
    /// # Errors
    /// What could not be written, and where.
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError>;

    /// Problems since the last call that the user should know of, although they are no reason to end the run.
    fn warnings(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Whether it shows blocks, common factors and correlations of methods, which are computed only for sinks that do.
    fn shows_structure(&self) -> bool {
        false
    }
}

/// Every sink in turn; the first error ends it.
impl Sink for Vec<Box<dyn Sink>> {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.iter_mut().try_for_each(|sink| sink.record(event))
    }

    fn warnings(&mut self) -> Vec<String> {
        self.iter_mut().flat_map(|sink| sink.warnings()).collect()
    }

    fn shows_structure(&self) -> bool {
        self.iter().any(|sink| sink.shows_structure())
    }
}

/// An output that could not be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, miette::Diagnostic)]
#[error("cannot write {}: {reason}", shown_path(path))]
pub struct SinkError {
    /// The file or directory.
    pub path: PathBuf,
    /// Why not.
    pub reason: String,
}
