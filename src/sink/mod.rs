//! Sinks hear the events of a run and write files. None of them changes the run.
//!
//! Contents: [`directory`] (where outputs go), [`netcdf`], [`parameters`], [`report`], [`scores`],
//! [`summary`], and with the cargo feature
//! `rerun` the recording for the rerun viewer; [`structure`] is what report and recording show of a method's blocks.

pub mod directory;
pub mod netcdf;
pub mod parameters;
pub mod report;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod scores;
pub mod structure;
pub mod summary;

pub use directory::{Existing, OutputDirectory};

use crate::event::{Event, RunInfo};
use std::path::PathBuf;

/// Something that hears the events of a run.
pub trait Sink {
    /// Takes note of an event.
    ///
    /// # Errors
    /// What could not be written, and where.
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError>;

    /// What has come up since the last call that the user should know, although it is no reason to end the run.
    fn warnings(&mut self) -> Vec<String> {
        Vec::new()
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

/// Which outputs to write beside the summary and the scores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// The netCDF files.
    pub netcdf: bool,
    /// The recording for the rerun viewer.
    pub rerun: bool,
    /// The page, and the figures on it.
    pub report: bool,
    /// Whether the recording is also sent to a running viewer, while it comes to be.
    pub live: bool,
}

impl Outputs {
    /// Whether this isobar can write recordings for the rerun viewer: whether its cargo feature was on.
    pub const RERUN_AVAILABLE: bool = cfg!(feature = "rerun");
}

/// Opens all sinks of a run. Their files are complete once they have heard [`Event::Finished`]; then
/// [`OutputDirectory::complete`] gives them their final place.
///
/// # Errors
/// If a file cannot be created, if names of methods do not lead to distinct file names, or if a recording is asked for
/// and this isobar was built without the feature `rerun`.
pub fn open_all(
    info: &RunInfo,
    directory: &OutputDirectory,
    outputs: Outputs,
) -> Result<Vec<Box<dyn Sink>>, SinkError> {
    let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
    if outputs.netcdf {
        sinks.push(Box::new(netcdf::NetcdfSink::create(info, directory)?));
    }
    if outputs.report {
        sinks.push(Box::new(report::ReportSink::create(info, directory)?));
    }
    if outputs.rerun || outputs.live {
        #[cfg(feature = "rerun")]
        sinks.push(Box::new(rerun::RerunSink::create(info, directory, outputs)?));
        #[cfg(not(feature = "rerun"))]
        return Err(SinkError {
            path: directory.destination().join("recording.rrd"),
            reason: "this isobar was built without the cargo feature `rerun`".into(),
        });
    }
    sinks.push(Box::new(scores::ScoresSink::create(info, directory)?));
    sinks.push(Box::new(parameters::ParametersSink::new(info, directory)));
    sinks.push(Box::new(summary::SummarySink::new(directory)));
    Ok(sinks)
}
