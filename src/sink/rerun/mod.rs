//! `recording.rrd`: the run for the eye, in the rerun viewer.
//!
//! The whole run is held, as numbers of 32 bits, until it is complete: only then are the colour ranges known that all
//! cycles and methods share. That takes about 4 bytes × cells × cycles × (7 + 7 × methods).

mod blueprint;
mod frame;
mod history;
mod maps;
mod ranges;
mod recording;
mod series;
mod text;
mod views;

use crate::event::{Event, RunInfo};
use crate::sink::{OutputDirectory, Outputs, Sink, SinkError};
use history::History;
use std::fmt::Display;
use std::path::PathBuf;

/// Name of the recording in the output directory.
pub const RECORDING_FILE: &str = "recording.rrd";

/// Writes the recording when the run is complete.
#[derive(Debug)]
pub struct RerunSink {
    path: PathBuf,
    info: RunInfo,
    history: History,
}

impl RerunSink {
    /// A sink that writes into `directory`.
    ///
    /// # Errors
    /// If the run has no variable to draw a map of.
    pub fn create(info: &RunInfo, directory: &OutputDirectory, _outputs: Outputs) -> Result<Self, SinkError> {
        let path = directory.path().join(RECORDING_FILE);
        if info.layout.is_empty() {
            return Err(SinkError { path, reason: "the run has no variables to draw".into() });
        }
        Ok(Self { path, info: info.clone(), history: History::new(info) })
    }

    fn failure(&self, reason: impl Display) -> SinkError {
        SinkError { path: self.path.clone(), reason: reason.to_string() }
    }
}

impl Sink for RerunSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(_) => Ok(()),
            Event::Truth { cycle, time, state, calibration } => {
                self.history.add_truth(*cycle, *time, state, calibration);
                Ok(())
            }
            Event::Observed(window) => {
                self.history.add_observations(&self.info, window);
                Ok(())
            }
            Event::Analysed(analysed) => {
                let added = self.history.add_estimates(&self.info, analysed);
                added.map_err(|reason| self.failure(reason))
            }
            Event::Finished(summary) => {
                let written = recording::write(&self.path, &self.info, &self.history, summary);
                written.map_err(|reason| self.failure(reason))
            }
            Event::Warning(_) => Ok(()),
        }
    }
}
