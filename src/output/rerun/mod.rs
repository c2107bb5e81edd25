//! `recording.rrd`: the run for the eye, in the rerun viewer.
//!
//! The whole run is held, as numbers of 32 bits, until it is complete: only then are the colour ranges known that all
//! cycles and methods share. That takes about 4 bytes × cells × cycles × variables × (1 + 3 × methods).
//!
//! Maps of grids with more than 256 cells on a side are means over square groups of cells, the smallest with which no
//! side has more than 256, or fewer where all maps would take more than 300 MB; curves and scores are those of the full
//! grid. A running viewer that is sent the run while it computes sees each cycle in the ranges of the cycles so far, and all
//! of them in the final ranges at the end.

mod biases;
mod blueprint;
mod frame;
mod live;
mod maps;
mod names;
mod ranges;
mod recording;
mod series;
mod text;
mod verdicts;
mod views;

use crate::event::{Event, RunInfo};
use crate::output::history::History;
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::plot::Thinning;
use isobar_model::Layout;
use live::Live;
use std::path::PathBuf;
use std::sync::Arc;

/// Name of the recording in the output directory.
pub const RECORDING_FILE: &str = "recording.rrd";

/// The most cells on a side of a map, the first of these with which all maps of the run take less than [`MAPS_BYTES`].
const MAP_CELLS: [usize; 5] = [256, 192, 128, 96, 64];

/// What all maps of a run may take before compression \[bytes\].
const MAPS_BYTES: usize = 300_000_000;

/// Bytes of a cell in the maps of a truth, and of a method: six fields of numbers, and colours of three of them.
const BYTES: [usize; 2] = [4, 33];

/// What both sinks hold of a run.
#[derive(Debug)]
struct Held {
    /// The run as its maps show it: on a coarser grid if its own is finer than maps are.
    info: RunInfo,
    history: History,
}

impl Held {
    fn new(info: &RunInfo) -> Self {
        let (Layout { grid, variables }, thinning) = (&*info.layout, thinning(info));
        let layout = Arc::new(Layout { grid: thinning.grid(grid), variables: variables.clone() });
        Self { info: RunInfo { layout, ..info.clone() }, history: History::new(info, thinning, |_, _| true) }
    }
}

fn thinning(info: &RunInfo) -> Thinning {
    let of_cell = info.count() * info.layout.variables.len() * (BYTES[0] + BYTES[1] * info.methods.len());
    let thinnings = MAP_CELLS.map(|most| Thinning::new(&info.layout.grid, most));
    let fits = |thinning: &Thinning| thinning.size().iter().product::<usize>() * of_cell < MAPS_BYTES;
    thinnings.into_iter().find(fits).unwrap_or(thinnings[MAP_CELLS.len() - 1])
}

/// Writes the recording when the run is complete.
#[derive(Debug)]
pub struct RerunSink {
    path: PathBuf,
    held: Held,
}

impl RerunSink {
    /// A sink that writes into `directory`.
    ///
    /// # Errors
    /// If the run has no variable to draw a map of.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = directory.path().join(RECORDING_FILE);
        if info.layout.is_empty() {
            return Err(SinkError { path, reason: "the run has no variables to draw".into() });
        }
        Ok(Self { path, held: Held::new(info) })
    }
}

impl Sink for RerunSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let failure = |reason: String| SinkError { path: self.path.clone(), reason };
        if let Event::Finished(summary) = event {
            let written = recording::write(&self.path, &self.held.info, &self.held.history, summary);
            return written.map_err(|error| failure(error.to_string()));
        }
        self.held.history.record(event).map_err(failure)
    }

    fn shows_structure(&self) -> bool {
        true
    }
}

/// Shows the run in a running viewer while it computes. The run continues without a viewer that is not there or leaves.
#[derive(Debug)]
pub struct LiveSink {
    held: Held,
    /// `None` without a viewer.
    viewer: Option<Live>,
    warnings: Vec<String>,
}

impl LiveSink {
    /// A sink that sends to the viewer on this machine.
    ///
    /// # Errors
    /// If the run has no variable to draw a map of.
    pub fn connect(info: &RunInfo) -> Result<Self, SinkError> {
        if info.layout.is_empty() {
            let reason = "the run has no variables to draw".into();
            return Err(SinkError { path: "the rerun viewer".into(), reason });
        }
        let held = Held::new(info);
        let (viewer, warnings) = match Live::connect(&held.info) {
            Ok(viewer) => (Some(viewer), Vec::new()),
            Err(reason) => (None, vec![reason]),
        };
        Ok(Self { held, viewer, warnings })
    }
}

impl Sink for LiveSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let Some(viewer) = &mut self.viewer else { return Ok(()) };
        let failure = |reason: String| SinkError { path: "the rerun viewer".into(), reason };
        self.held.history.record(event).map_err(failure)?;
        let Held { info, history } = &self.held;
        let shown = match event {
            Event::CycleEnded(cycle) => viewer.show(info, history, *cycle),
            Event::Finished(summary) => viewer.finish(info, history, summary),
            _ => Ok(()),
        };
        if let Err(error) = shown {
            self.warnings.push(format!("the rerun viewer has gone away, the run goes on without it: {error}"));
            self.viewer = None;
        }
        Ok(())
    }

    fn warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    fn shows_structure(&self) -> bool {
        self.viewer.is_some()
    }
}
