//! The verdicts on biases as a log: what a method began to say of a bias, and in which cycle.

use super::names::{Names, Result, set_time};
use crate::event::RunInfo;
use crate::output::history::History;
use crate::plot::number;
use re_sdk::RecordingStream;
use re_sdk_types::archetypes::TextLog;
use re_sdk_types::components::TextLogLevel;

/// Logs the verdicts of the cycles from `since` on.
pub fn log(recording: &RecordingStream, info: &RunInfo, history: &History, names: &Names, since: usize) -> Result {
    for (cycle, time, method, verdict) in history.verdicts.iter().filter(|(cycle, ..)| *cycle >= since) {
        set_time(recording, *cycle, *time);
        let because = if verdict.stable {
            format!("the observations leave {} % of its prior variance", number(100.0 * verdict.variance_ratio))
        } else {
            verdict.why.join("; ")
        };
        let parameter = &info.calibration.parameters[verdict.parameter].name;
        let name = &info.methods[*method].name;
        let text = format!("{name}, {parameter}: {}: {because}", verdict.in_words());
        let level = if verdict.stable { TextLogLevel::INFO } else { TextLogLevel::WARN };
        recording.log(names.map(*method, "verdicts"), &TextLog::new(text).with_level(level))?;
    }
    recording.reset_time();
    Ok(())
}
