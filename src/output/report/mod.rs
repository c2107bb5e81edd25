//! `report.html`: the run on one page, for somebody who has a browser and nothing else; and its figures as files.
//!
//! The page loads nothing: curves are SVG within it, maps are PNG as data. Everything of a scenario that goes into it goes
//! through the template's escaping. Maps of grids with more than 200 cells on a side are means over groups of cells.

mod facts;
mod figures;
mod forecasts;
mod history;
mod maps;
pub mod page;
mod reliability;
mod tables;

use crate::event::{Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::scores::Summary;
use history::History;
use std::fs;
use std::path::PathBuf;

/// Name among the [`OUTPUTS`](crate::output::OUTPUTS).
pub const REPORT: &str = "report";

/// Name of the page in the output directory.
pub const REPORT_FILE: &str = "report.html";

/// Name of the directory of figures in the output directory.
pub const FIGURES_DIRECTORY: &str = "figures";

/// Writes the report when the run is complete.
#[derive(Debug)]
pub struct ReportSink {
    directory: PathBuf,
    info: RunInfo,
    history: History,
}

impl ReportSink {
    /// A sink that writes into `directory`.
    ///
    /// # Errors
    /// If the run has no variable to draw.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let directory = directory.path().to_path_buf();
        if info.layout.is_empty() {
            return Err(SinkError { path: directory.join(REPORT_FILE), reason: "the run has no variables".into() });
        }
        Ok(Self { directory, info: info.clone(), history: History::new(info) })
    }

    fn failure(&self, file: &str, reason: impl ToString) -> SinkError {
        SinkError { path: self.directory.join(file), reason: reason.to_string() }
    }

    fn write(&self, summary: &Summary) -> Result<(), SinkError> {
        let report = page::Report::new(&self.info, &self.history, summary);
        let report = report.map_err(|error| self.failure(FIGURES_DIRECTORY, error))?;
        let figures = self.directory.join(FIGURES_DIRECTORY);
        fs::create_dir_all(&figures).map_err(|error| self.failure(FIGURES_DIRECTORY, error))?;
        for (name, bytes) in report.files() {
            let name = format!("{FIGURES_DIRECTORY}/{name}");
            fs::write(self.directory.join(&name), bytes).map_err(|error| self.failure(&name, error))?;
        }
        let text = report.html().map_err(|error| self.failure(REPORT_FILE, error))?;
        fs::write(self.directory.join(REPORT_FILE), text).map_err(|error| self.failure(REPORT_FILE, error))
    }
}

impl Sink for ReportSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Truth { cycle, time, state, calibration } => {
                self.history.add_truth(&self.info, *cycle, *time, state, calibration);
                Ok(())
            }
            Event::Observed { window, .. } => {
                self.history.add_observations(&self.info, window);
                Ok(())
            }
            Event::Analysed(analysed) => {
                let added = self.history.add_estimates(&self.info, analysed);
                added.map_err(|reason| self.failure(REPORT_FILE, reason))
            }
            Event::Smoothed(smoothed) => {
                self.history.add_smoothed(smoothed);
                Ok(())
            }
            Event::Estimated(estimated) => {
                self.history.add_parameters(&self.info, estimated);
                Ok(())
            }
            Event::Finished(summary) => self.write(summary),
            Event::Started(_)
            | Event::Resumed(_)
            | Event::Forecast(_)
            | Event::Failed { .. }
            | Event::CycleEnded(_)
            | Event::Warning(_) => Ok(()),
        }
    }

    fn shows_structure(&self) -> bool {
        true
    }
}
