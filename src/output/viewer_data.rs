//! What a recording for the rerun viewer is made of: the run as its maps and curves show it.
//!
//! An isobar with the viewer's SDK makes the recording at the end of the run; one without it writes a file instead, from which
//! the other makes the same recording later.
//!
//! The whole run is held, as numbers of 32 bits, until it is complete: only then are the colour ranges known that all
//! cycles and methods share. That takes about 4 bytes × cells × cycles × variables × (1 + 3 × methods).
//!
//! Maps of grids with more than 256 cells on a side are means over square groups of cells, the smallest with which no
//! side has more than 256, or fewer where all maps would take more than 300 MB; curves and scores are those of the full
//! grid.

use super::history::{Cycle, Fields, History, MethodCycle, MethodMaps, ParameterHistory};
use crate::event::{Event, RunInfo};
use crate::output::{Sink, SinkError};
use crate::plot::Thinning;
use crate::scores::Summary;
use crate::sealed::Format;
use crate::verdict::Verdict;
use indexmap::IndexMap;
use isobar_model::{Layout, Time};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Name of the file in a run's directory.
pub const VIEWER_DATA_FILE: &str = "viewer_data.bin";

const FORMAT: Format = Format { name: "file of viewer data", number: 2 };

/// The most cells on a side of a map, the first of these with which all maps of the run take less than [`MAPS_BYTES`].
const MAP_CELLS: [usize; 5] = [256, 192, 128, 96, 64];

/// What all maps of a run may take before compression \[bytes\].
const MAPS_BYTES: usize = 300_000_000;

/// Bytes of a cell in the maps of a truth, and of a method: six fields of numbers, and colours of three of them.
const BYTES: [usize; 2] = [4, 33];

/// A run as the viewer shows it.
#[derive(Debug)]
pub struct ViewerData {
    /// The run as its maps show it: on a coarser grid if its own is finer than maps are.
    pub info: RunInfo,
    /// What happened.
    pub history: History,
}

/// What a file holds: the run on its own grid, and the parts of its history that the viewer shows.
type Contents =
    (RunInfo, Vec<Cycle>, IndexMap<String, Vec<Option<ParameterHistory>>>, Vec<(usize, Time, usize, Verdict)>);

impl ViewerData {
    /// Of a run that has not begun.
    pub fn new(info: &RunInfo) -> Self {
        let (Layout { grid, variables }, thinning) = (&*info.layout, thinning(info));
        let layout = Arc::new(Layout { grid: thinning.grid(grid), variables: variables.clone() });
        Self { info: RunInfo { layout, ..info.clone() }, history: History::new(info, thinning, |_, _| true) }
    }

    /// Writes a durable file.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let History { info, cycles, parameters, verdicts, .. } = &self.history;
        FORMAT.write(path, &(info, cycles, parameters, verdicts), 0, &|_, _| Ok(()))
    }

    /// Reads a file.
    ///
    /// # Errors
    /// In words, if it is damaged, is not of one run, or was written by another version.
    pub fn read(path: &Path) -> Result<Self, String> {
        let contents: Contents = FORMAT.read(path)?.head;
        if !fits(&contents) {
            return Err("its parts are not those of one run".into());
        }
        let (info, cycles, parameters, verdicts) = contents;
        let mut data = Self::new(&info);
        (data.history.cycles, data.history.parameters, data.history.verdicts) = (cycles, parameters, verdicts);
        Ok(data)
    }
}

fn thinning(info: &RunInfo) -> Thinning {
    let of_cell = info.count() * info.layout.variables.len() * (BYTES[0] + BYTES[1] * info.methods.len());
    let thinnings = MAP_CELLS.map(|most| Thinning::new(&info.layout.grid, most));
    let fits = |thinning: &Thinning| thinning.size().iter().product::<usize>() * of_cell < MAPS_BYTES;
    thinnings.into_iter().find(fits).unwrap_or(thinnings[MAP_CELLS.len() - 1])
}

/// Whether all parts have the sizes of the run.
fn fits((info, cycles, parameters, verdicts): &Contents) -> bool {
    let grid = &info.layout.grid;
    let (methods, biases, variables) = (info.methods.len(), info.calibration.len(), info.layout.variables.len());
    if grid.nx.checked_mul(grid.ny).is_none_or(|cells| cells == 0) || variables == 0 || info.done > info.cycles {
        return false;
    }
    let cells: usize = thinning(info).size().iter().product();
    let are_fields = |fields: &Fields| fields.len() == variables && fields.iter().all(|field| field.len() == cells);
    let maps_fit = |maps: &MethodMaps| {
        let structure_fits = maps.structure.as_ref().is_none_or(|it| {
            let factors_fit = it.factors.iter().all(|it| are_fields(&it.fields) && it.largest.len() == variables);
            it.parts.len() == cells && factors_fit
        });
        let correlations_fit =
            maps.correlations.as_ref().is_none_or(|it| are_fields(&it.fields) && it.calibration.len() == biases);
        are_fields(&maps.background)
            && are_fields(&maps.analysis)
            && [&maps.spread, &maps.smoothed].into_iter().flatten().all(are_fields)
            && structure_fits
            && correlations_fit
    };
    let method_fits = |own: &MethodCycle| {
        own.departures.keys().all(|kind| kind.variable < variables) && own.maps.as_ref().is_none_or(maps_fit)
    };
    let cycle_fits = |cycle: &Cycle| {
        cycle.truth.as_ref().is_none_or(are_fields)
            && cycle.values.len() == cycle.reports.len()
            && cycle.reports.iter().all(|report| report.variable < variables)
            && cycle.methods.len() == methods
            && cycle.methods.iter().flatten().all(method_fits)
    };
    cycles.iter().all(cycle_fits)
        && parameters.values().all(|of_methods| of_methods.len() == methods)
        && verdicts.iter().all(|(_, _, method, verdict)| *method < methods && verdict.parameter < biases)
}

/// Holds the run, and writes a file of it when it is complete.
#[derive(Debug)]
pub struct ViewerSink {
    path: PathBuf,
    data: ViewerData,
    write: Write,
}

/// Writes what the viewer shows of a complete run into a file.
pub type Write = fn(&ViewerData, &Path, &Summary) -> Result<(), String>;

impl ViewerSink {
    /// A sink that makes the file `path`.
    ///
    /// # Errors
    /// If the run has no variable to draw a map of.
    pub fn create(info: &RunInfo, path: PathBuf, write: Write) -> Result<Self, SinkError> {
        if info.layout.is_empty() {
            return Err(SinkError { path, reason: "the run has no variables to draw".into() });
        }
        Ok(Self { path, data: ViewerData::new(info), write })
    }
}

impl Sink for ViewerSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let done = match event {
            Event::Finished(summary) => (self.write)(&self.data, &self.path, summary),
            event => self.data.history.record(event),
        };
        done.map_err(|reason| SinkError { path: self.path.clone(), reason })
    }

    fn shows_structure(&self) -> bool {
        true
    }
}
