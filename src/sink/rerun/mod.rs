//! `recording.rrd`: the run for the eye, in the rerun viewer.
//!
//! The whole run is held, as numbers of 32 bits, until it is complete: only then are the colour ranges known that all
//! cycles and methods share. That takes about 4 bytes × cells × cycles × variables × (1 + 3 × methods).
//!
//! Maps of grids with more than 256 cells on a side are means over square groups of cells, the smallest with which no
//! side has more than 256, or fewer where all maps would take more than 300 MB; curves and scores are those of the full
//! grid. A running viewer that is told the run while it
//! computes sees each cycle in the ranges of the cycles so far, and all of them in the final ranges at the end.

mod blueprint;
mod frame;
mod history;
mod live;
mod maps;
mod ranges;
mod recording;
mod series;
mod text;
mod views;

use crate::event::{Event, RunInfo};
use crate::sink::{OutputDirectory, Outputs, Sink, SinkError};
use history::History;
use live::Live;
use std::fmt::Display;
use std::path::PathBuf;

/// Name of the recording in the output directory.
pub const RECORDING_FILE: &str = "recording.rrd";

/// Writes the recording when the run is complete.
#[derive(Debug)]
pub struct RerunSink {
    /// The file; `None` if only a running viewer is to be told.
    path: Option<PathBuf>,
    info: RunInfo,
    history: History,
    live: Option<Live>,
    warnings: Vec<String>,
}

impl RerunSink {
    /// A sink that writes into `directory`.
    ///
    /// # Errors
    /// If the run has no variable to draw a map of.
    pub fn create(info: &RunInfo, directory: &OutputDirectory, outputs: Outputs) -> Result<Self, SinkError> {
        let path = directory.path().join(RECORDING_FILE);
        if info.layout.is_empty() {
            return Err(SinkError { path, reason: "the run has no variables to draw".into() });
        }
        let history = History::new(info);
        let info = history.thinned(info);
        let (mut live, mut warnings) = (None, Vec::new());
        if outputs.live {
            match Live::connect(&info) {
                Ok(connected) => live = Some(connected),
                Err(reason) => warnings.push(reason),
            }
        }
        Ok(Self { path: outputs.rerun.then_some(path), history, info, live, warnings })
    }

    /// Tells a running viewer; one that has gone away is told no more.
    fn tell(&mut self, tell: impl FnOnce(&mut Live, &RunInfo, &History) -> recording::Result) {
        let told = self.live.as_mut().map(|live| tell(live, &self.info, &self.history));
        if let Some(Err(error)) = told {
            self.warnings.push(format!("the rerun viewer has gone away, the run goes on without it: {error}"));
            self.live = None;
        }
    }

    fn failure(&self, reason: impl Display) -> SinkError {
        let path = self.path.clone().unwrap_or_else(|| RECORDING_FILE.into());
        SinkError { path, reason: reason.to_string() }
    }
}

impl Sink for RerunSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(_) | Event::Resumed(_) => Ok(()),
            Event::Truth { cycle, time, state, calibration } => {
                self.history.add_truth(*cycle, *time, state, calibration);
                Ok(())
            }
            Event::Observed { window, .. } => {
                self.history.add_observations(&self.info, window);
                Ok(())
            }
            Event::Analysed(analysed) => {
                let added = self.history.add_estimates(&self.info, analysed);
                added.map_err(|reason| self.failure(reason))
            }
            Event::CycleEnded(cycle) => {
                self.tell(|live, info, history| live.show(info, history, *cycle));
                Ok(())
            }
            Event::Finished(summary) => {
                if let Some(path) = &self.path {
                    let written = recording::write(path, &self.info, &self.history, summary);
                    written.map_err(|reason| self.failure(reason))?;
                }
                self.tell(|live, info, history| live.finish(info, history, summary));
                Ok(())
            }
            Event::Estimated(_) | Event::Smoothed(_) | Event::Failed { .. } | Event::Warning(_) => Ok(()),
        }
    }

    fn warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }
}
