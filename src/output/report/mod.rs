//! `report.html`: the run on one page, for somebody who has a browser and nothing else; and its figures as files.
//!
//! The page loads nothing: its figures are SVG within it, and its one script is not needed to read it. Everything of a
//! scenario that goes into it goes through the template's escaping. Maps of grids with more than 200 cells on a side are means
//! over groups of cells.

mod biases;
mod facts;
mod figures;
mod forecasts;
mod glance;
mod headline;
mod maps;
pub mod page;
mod scans;
mod section;
mod tables;
mod verdicts;
mod warnings;

use crate::event::{Event, RunInfo};
use crate::output::history::History;
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::plot::Thinning;
use crate::scores::Summary;
use std::fs;
use std::path::PathBuf;
use warnings::ProbabilityFields;

/// Name among the [`OUTPUTS`](crate::output::OUTPUTS).
pub const REPORT: &str = "report";

/// Name of the page in the output directory.
pub const REPORT_FILE: &str = "report.html";

/// Name of the directory of figures in the output directory.
pub const FIGURES_DIRECTORY: &str = "figures";

/// The most cells on a side of a map.
const MAP_CELLS: usize = 200;

/// The most cycles with maps, and the most values that their maps have together; two cycles have maps in any case.
const MOST_CYCLES: usize = 6;
const MOST_VALUES: usize = 200_000;

/// Writes the report when the run is complete.
#[derive(Debug)]
pub struct ReportSink {
    directory: PathBuf,
    history: History,
    probabilities: ProbabilityFields,
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
        let thinning = Thinning::new(&info.layout.grid, MAP_CELLS);
        let history = History::new(info, thinning, has_maps);
        Ok(Self { directory, history, probabilities: ProbabilityFields::default() })
    }

    fn failure(&self, file: &str, reason: impl ToString) -> SinkError {
        SinkError { path: self.directory.join(file), reason: reason.to_string() }
    }

    fn write(&self, summary: &Summary) -> Result<(), SinkError> {
        let report = page::Report::new(&self.history, &self.probabilities, summary);
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
            Event::Finished(summary) => self.write(summary),
            Event::Forecast(forecast) => {
                self.probabilities.add(&self.history, forecast);
                Ok(())
            }
            event => self.history.record(event).map_err(|reason| self.failure(REPORT_FILE, reason)),
        }
    }

    fn shows_structure(&self) -> bool {
        true
    }
}

/// Whether a cycle is one of those whose maps are on the page: the last, and others evenly before it, on small grids more than
/// on large ones.
fn has_maps(info: &RunInfo, cycle: usize) -> bool {
    let [columns, rows] = Thinning::new(&info.layout.grid, MAP_CELLS).size();
    // Truth; background, analysis and error or spread of every method.
    let values = columns * rows * (1 + 3 * info.methods.len());
    let parts = (MOST_VALUES / values.max(1)).clamp(2, MOST_CYCLES).min(info.count().max(1));
    (1..=parts).any(|part| cycle == info.done + (info.count() * part).div_ceil(parts))
}
