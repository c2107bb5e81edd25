//! The file: everything that is logged.

use super::frame::Frame;
use super::maps::Pictures;
use super::names::{APPLICATION_ID, Names, Result};
use super::ranges::Ranges;
use super::series::Series;
use super::{text, verdicts, views};
use crate::event::RunInfo;
use crate::output::earth;
use crate::output::history::History;
use crate::output::viewer_data::ViewerData;
use crate::scores::Summary;
use crate::tables::stability;
use re_sdk::log::ChunkBatcherConfig;
use re_sdk::{RecordingStream, RecordingStreamBuilder};
use re_sdk_types::archetypes::TextDocument;
use std::path::Path;
use std::time::Duration;

/// Writes the recording of a complete run.
///
/// # Errors
/// In words, those of the file system and of the SDK.
pub fn write(data: &ViewerData, path: &Path, summary: &Summary) -> std::result::Result<(), String> {
    log_all(data, path, summary).map_err(|error| error.to_string())
}

fn log_all(ViewerData { info, history }: &ViewerData, path: &Path, summary: &Summary) -> Result {
    // Nothing in the file may depend on the clock: neither times of logging, nor how rows are grouped to chunks.
    let batching = ChunkBatcherConfig { flush_tick: Duration::from_secs(86_400), ..ChunkBatcherConfig::DEFAULT };
    let recording = RecordingStreamBuilder::new(APPLICATION_ID)
        .recording_id(id(info))
        .send_properties(false)
        .batcher_config(batching)
        .save(path)?;
    log_run(&recording, info, history, Some(summary), 0)?;
    recording.flush_blocking()?;
    Ok(())
}

/// Name of the recording in the viewer's memory.
pub fn id(info: &RunInfo) -> String {
    format!("{}-seed-{}", info.scenario, info.seed)
}

/// Logs the layout of the views and all that has happened; without a summary, the run is not complete.
///
/// Curves and verdicts are logged from a cycle on: a viewer that is sent a point twice would draw it twice.
pub fn log_run(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    summary: Option<&Summary>,
    curves_since: usize,
) -> Result {
    recording.set_log_time_enabled(false);
    recording.set_log_tick_enabled(false);
    recording.send_recording_name(format!("{}, seed {}", info.title, info.seed))?;
    let (names, ranges) = (Names::new(info), Ranges::of_run(info, history));
    let frame = Frame::new(&info.layout);
    let coast = earth::coastlines(info);
    views::send(recording, info, history, (&names, &ranges), !coast.is_empty())?;
    let scores = summary.map_or_else(|| text::unfinished(info), |summary| text::scores(info, summary));
    recording.log_static("text/scores", &TextDocument::from_markdown(scores))?;
    let stability = summary.map_or_else(|| text::unfinished(info), stability::markdown);
    recording.log_static("text/stability", &TextDocument::from_markdown(stability))?;
    recording.log_static("text/scenario", &TextDocument::from_markdown(text::scenario(info)))?;
    let pictures = Pictures { recording, info, history, ranges: &ranges, names: &names, frame };
    pictures.log_frames(coast)?;
    pictures.log_bias_frame()?;
    pictures.log_maps(0)?;
    pictures.log_biases(0)?;
    verdicts::log(recording, info, history, &names, curves_since)?;
    Series { recording, info, history, names: &names, since: curves_since }.log()
}

/// Logs what has happened since a cycle, for a viewer that has what was before, in the ranges of then.
pub fn log_since(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    ranges: &Ranges,
    since: usize,
) -> Result {
    let (names, frame) = (Names::new(info), Frame::new(&info.layout));
    let pictures = Pictures { recording, info, history, ranges, names: &names, frame };
    pictures.log_maps(since)?;
    pictures.log_biases(since)?;
    verdicts::log(recording, info, history, &names, since)?;
    Series { recording, info, history, names: &names, since }.log()
}
