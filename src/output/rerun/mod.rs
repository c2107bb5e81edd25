//! `recording.rrd`: the run for the eye, in the rerun viewer, from what [`ViewerData`] holds of it.
//!
//! A running viewer that is sent the run while it computes sees each cycle in the ranges of the cycles so far, and all
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
use crate::output::viewer_data::ViewerData;
use crate::output::{Sink, SinkError};
use live::Live;

pub use recording::write;

/// Shows the run in a running viewer while it computes. The run continues without a viewer that is not there or leaves.
#[derive(Debug)]
pub struct LiveSink {
    data: ViewerData,
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
        let data = ViewerData::new(info);
        let (viewer, warnings) = match Live::connect(&data.info) {
            Ok(viewer) => (Some(viewer), Vec::new()),
            Err(reason) => (None, vec![reason]),
        };
        Ok(Self { data, viewer, warnings })
    }
}

impl Sink for LiveSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let Some(viewer) = &mut self.viewer else { return Ok(()) };
        let failure = |reason: String| SinkError { path: "the rerun viewer".into(), reason };
        self.data.history.record(event).map_err(failure)?;
        let ViewerData { info, history } = &self.data;
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
