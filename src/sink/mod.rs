//! Sinks hear the events of a run and write files. None of them changes the run.
//!
//! Contents: [`directory`] (where outputs go), [`OUTPUTS`] (the outputs that can be switched off), [`netcdf`],
//! [`parameters`], [`report`], [`scores`], [`summary`], and with the cargo feature `rerun` the recording for the rerun
//! viewer; [`structure`] is what report and recording show of a method's blocks.

pub mod directory;
pub mod netcdf;
mod outputs;
pub mod parameters;
pub mod report;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod scores;
pub mod structure;
pub mod summary;

pub use directory::{Existing, OutputDirectory};
pub use outputs::{OUTPUTS, Open, Output, Outputs};

use crate::event::{Event, RunInfo};
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
#[error("cannot write {}: {reason}", path.display())]
pub struct SinkError {
    /// The file or directory.
    pub path: PathBuf,
    /// Why not.
    pub reason: String,
}

/// Opens all sinks of a run: those of the outputs that are wanted, and those that are always there. Their files are complete
/// once they have heard [`Event::Finished`]; then [`OutputDirectory::complete`] gives them their final place.
///
/// # Errors
/// If a file cannot be created, if names of methods do not lead to distinct file names, or if an output is wanted for which
/// this isobar was built without its feature.
pub fn open_all(
    info: &RunInfo,
    directory: &OutputDirectory,
    outputs: &Outputs,
) -> Result<Vec<Box<dyn Sink>>, SinkError> {
    let mut sinks = outputs::open(info, directory, outputs)?;
    sinks.push(Box::new(scores::ScoresSink::create(info, directory)?));
    sinks.push(Box::new(parameters::ParametersSink::new(info, directory)));
    sinks.push(Box::new(summary::SummarySink::new(directory)));
    Ok(sinks)
}
