//! `summary.json`: the scores of a run, and all that is needed to read them years later: the version of the file's layout,
//! units, meanings of scores, kinds and settings of methods, times, threads, and the whole scenario.

use crate::calendar::utc;
use crate::event::{Event, RunInfo};
use crate::output::directory::{OutputDirectory, SUMMARY_FILE};
use crate::output::{Sink, SinkError};
use crate::scores::{SCORES, Score, ScoreKind, Summary};
use crc32fast::Hasher;
use isobar_model::{State, Variable};
use serde_json::{Map, Value, json};
use std::fs;
use std::path::PathBuf;

/// The version of the layout of `summary.json`: it grows whenever something moves or disappears.
pub const LAYOUT_VERSION: u32 = 1;

/// The key of the checksum that identifies the truth of the run.
pub const TRUTH_CHECKSUM: &str = "truth_checksum";

/// Writes the scores of the run when it is complete.
#[derive(Debug)]
pub struct SummarySink {
    path: PathBuf,
    info: RunInfo,
    /// Of the true state after the first cycle.
    truth: Option<u32>,
}

impl SummarySink {
    /// A sink that writes into `directory`.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        Self { path: directory.path().join(SUMMARY_FILE), info: info.clone(), truth: None }
    }

    /// The document: what is known of the run, and then its scores.
    fn document(&self, summary: &Summary) -> Result<Value, serde_json::Error> {
        let Value::Object(scores) = serde_json::to_value(summary)? else { unreachable!("a summary is an object") };
        let mut all = Map::from_iter([("layout_version".to_string(), LAYOUT_VERSION.into())]);
        all.extend(scores);
        if let Some(truth) = self.truth {
            all.insert(TRUTH_CHECKSUM.into(), truth.into());
        }
        all.extend(about(&self.info));
        let scenario: toml::Table = self.info.scenario_text.parse().unwrap_or_default();
        let kind = |name: &str| scenario.get("methods")?.get(name)?.get("kind")?.as_str();
        for method in &self.info.methods {
            let Some(own) = all.get_mut("methods").and_then(|all| all.get_mut(&method.name)) else { continue };
            own["kind"] = kind(&method.name).into();
            own["description"] = method.description.as_str().into();
        }
        all.insert("scenario_settings".into(), json_of(&toml::Value::Table(scenario)));
        Ok(all.into())
    }
}

/// What is known of a run beside its scores.
fn about(info: &RunInfo) -> Map<String, Value> {
    let variables = info.layout.variables.iter();
    let variable = |it: &Variable| json!({ "name": it.name, "long_name": it.long_name, "unit": it.unit });
    let meaning = |kind: &'static ScoreKind| {
        let unit = if kind.per_variable { "of the variable" } else { Score { kind, variable: ("", "") }.unit() };
        (kind.name.to_string(), json!({ "unit": unit, "meaning": kind.about }))
    };
    let grid = &info.layout.grid;
    let Value::Object(about) = json!({
        "title": info.title,
        "threads": info.threads,
        "begin": utc(info.begin()),
        "end": utc(info.time(info.cycles)),
        "cycle_hours": info.window.hours(),
        "grid": { "nx": grid.nx, "ny": grid.ny, "dx_m": grid.dx_m, "dy_m": grid.dy_m },
        "variables": variables.map(variable).collect::<Vec<_>>(),
        "score_meanings": Value::Object(SCORES.iter().map(meaning).collect()),
    }) else {
        unreachable!("it is an object")
    };
    about
}

/// A value of a scenario as JSON, with times as strings.
fn json_of(value: &toml::Value) -> Value {
    match value {
        toml::Value::String(text) => text.as_str().into(),
        toml::Value::Integer(number) => (*number).into(),
        toml::Value::Float(number) => (*number).into(),
        toml::Value::Boolean(is_true) => (*is_true).into(),
        toml::Value::Datetime(time) => time.to_string().into(),
        toml::Value::Array(all) => all.iter().map(json_of).collect(),
        toml::Value::Table(table) => table.iter().map(|(key, value)| (key.clone(), json_of(value))).collect(),
    }
}

/// A checksum that identifies a truth.
fn checksum(state: &State) -> u32 {
    let mut hasher = Hasher::new();
    state.values().iter().for_each(|value| hasher.update(&value.to_le_bytes()));
    hasher.finalize()
}

impl Sink for SummarySink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Truth { cycle, state, .. } if *cycle == self.info.done + 1 => self.truth = Some(checksum(state)),
            Event::Finished(summary) => {
                let failure = |reason: String| SinkError { path: self.path.clone(), reason };
                let document = self.document(summary).map_err(|error| failure(error.to_string()))?;
                fs::write(&self.path, format!("{document:#}\n")).map_err(|error| failure(error.to_string()))?;
            }
            _ => {}
        }
        Ok(())
    }
}
