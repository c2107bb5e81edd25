//! The outputs of a run that can be switched on and off.

use super::viewer_data::ViewerSink;
#[cfg(not(feature = "rerun"))]
use super::viewer_data::{VIEWER_DATA_FILE, ViewerData};
use super::{
    OutputDirectory, Sink, SinkError, forecasts, netcdf, parameters, readings, report, scores, summary, verdicts,
    warnings,
};
#[cfg(feature = "rerun")]
use super::{recorded::recording::RECORDING_FILE, rerun};
use crate::event::RunInfo;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
#[cfg(not(feature = "rerun"))]
use {crate::scores::Summary, std::path::Path};

/// The name of the output that is the state in which a run ends.
pub const STATE: &str = "state";

/// Its file in the output directory.
pub const STATE_FILE: &str = "final_state.bin";

/// A kind of output beside the summary and the scores.
pub struct Output {
    /// Its name, and its key in `[output]`.
    pub name: &'static str,
    /// The switch on the command line, without `--`: it turns the output off if that is on by default, and on if not.
    pub switch: &'static str,
    /// What the switch does.
    pub about: &'static str,
    /// Whether it is written unless scenario or command line say otherwise. If not, it has no key in `[output]`.
    pub by_default: bool,
    /// Makes its sink.
    pub open: Open,
}

/// Makes the recording.
#[cfg(feature = "rerun")]
fn open_viewer_sink(info: &RunInfo, directory: &OutputDirectory) -> Opened {
    Ok(Box::new(ViewerSink::create(info, directory.path().join(RECORDING_FILE), rerun::write)?))
}

/// Keeps what a recording is made of, which an isobar with the viewer's SDK can make of it later.
#[cfg(not(feature = "rerun"))]
fn open_viewer_sink(info: &RunInfo, directory: &OutputDirectory) -> Opened {
    let write = |data: &ViewerData, path: &Path, _: &Summary| data.write(path).map_err(|error| error.to_string());
    Ok(Box::new(ViewerSink::create(info, directory.path().join(VIEWER_DATA_FILE), write)?))
}

/// A sink, or why it cannot be opened.
type Opened = Result<Box<dyn Sink>, SinkError>;

/// How the sink of an output is opened.
pub enum Open {
    /// By a function that creates its files.
    Available(fn(&RunInfo, &OutputDirectory) -> Opened),
    /// Not by a sink: the run itself writes it at its end.
    ByRun,
    /// Not in this build, for want of a cargo feature.
    NeedsFeature(&'static str),
}

/// All of them.
pub const OUTPUTS: &[Output] = &[
    Output {
        name: "netcdf",
        switch: "no-netcdf",
        about: "Write no netCDF files",
        by_default: true,
        open: Open::Available(|info, directory| Ok(Box::new(netcdf::NetcdfSink::create(info, directory)?))),
    },
    Output {
        name: report::REPORT,
        switch: "no-report",
        about: "Write no report.html, and no figures",
        by_default: true,
        open: Open::Available(|info, directory| Ok(Box::new(report::ReportSink::create(info, directory)?))),
    },
    Output {
        name: "rerun",
        switch: "no-rerun",
        about: "Write no recording for the rerun viewer, nor what it is made of",
        by_default: true,
        open: Open::Available(open_viewer_sink),
    },
    Output {
        name: STATE,
        switch: "no-state",
        about: "Keep no final state, from which `isobar run --from` would go on",
        by_default: true,
        open: Open::ByRun,
    },
    Output {
        name: "live",
        switch: "live",
        about: "Show the run in a running rerun viewer while it computes",
        by_default: false,
        #[cfg(feature = "rerun")]
        open: Open::Available(|info, _| Ok(Box::new(rerun::LiveSink::connect(info)?))),
        #[cfg(not(feature = "rerun"))]
        open: Open::NeedsFeature("rerun"),
    },
];

/// The names of the outputs to write.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outputs(BTreeSet<String>);

impl Outputs {
    /// Those that are written by default.
    pub fn by_default() -> Self {
        Self::of(OUTPUTS.iter().filter(|output| output.by_default).map(|output| output.name))
    }

    /// Those of these names.
    pub fn of<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        Self(names.into_iter().map(String::from).collect())
    }

    /// Those that are written by default: the others belong to a process and not to the run, which another process may
    /// continue without them.
    pub fn of_run(&self) -> Self {
        Self::of(Self::by_default().0.iter().filter(|name| self.contains(name)).map(String::as_str))
    }

    /// Whether an output is one of them.
    pub fn contains(&self, name: &str) -> bool {
        self.0.contains(name)
    }

    /// Adds an output or takes it away.
    pub fn set(&mut self, name: &str, wanted: bool) {
        if wanted {
            self.0.insert(name.to_string());
        } else {
            self.0.remove(name);
        }
    }
}

/// Opens all sinks of a run: those of the outputs that are wanted, and those that are always there. Their files are complete
/// once they have heard [`Event::Finished`](crate::event::Event::Finished); then [`OutputDirectory::complete`] gives them their final place.
///
/// # Errors
/// If a file cannot be created, if names of methods do not lead to distinct file names, or if an output is wanted for which
/// this isobar was built without its feature.
pub fn open_all(
    info: &RunInfo,
    directory: &OutputDirectory,
    outputs: &Outputs,
) -> Result<Vec<Box<dyn Sink>>, SinkError> {
    let mut sinks = open(info, directory, outputs)?;
    sinks.push(Box::new(scores::ScoresSink::create(info, directory)?));
    sinks.push(Box::new(forecasts::ForecastsSink::new(info, directory)));
    sinks.push(Box::new(parameters::ParametersSink::new(info, directory)));
    sinks.push(Box::new(verdicts::VerdictsSink::new(info, directory)));
    if !info.warnings.is_empty() {
        sinks.push(Box::new(warnings::WarningsSink::new(info, directory)));
    }
    if info.keeps_sensors {
        sinks.push(Box::new(readings::ReadingsSink::create(info, directory)?));
    }
    sinks.push(Box::new(summary::SummarySink::new(info, directory)));
    Ok(sinks)
}

/// Opens the sinks of these outputs.
///
/// # Errors
/// If a file cannot be created, if names of methods do not lead to distinct file names, or if this isobar was built without
/// an output's feature.
fn open(info: &RunInfo, directory: &OutputDirectory, outputs: &Outputs) -> Result<Vec<Box<dyn Sink>>, SinkError> {
    let wanted = OUTPUTS.iter().filter(|output| outputs.contains(output.name));
    let open = |output: &Output| match output.open {
        Open::Available(open) => Some(open(info, directory)),
        Open::ByRun => None,
        Open::NeedsFeature(feature) => Some(Err(SinkError {
            path: directory.destination().join(output.name),
            reason: format!("this isobar was built without the cargo feature `{feature}`"),
        })),
    };
    wanted.filter_map(open).collect()
}
