//! `scores.csv`: the scores of every method in every cycle, one row for each.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, then for each variable, with its unit in brackets,
//! `rmse_background`, `rmse_analysis`, `spread_background`, `spread_analysis`, as in `rmse_analysis h [m]`, then
//! `bias_rmse`, `bias_spread` and `innovation_chi2`. A field is empty where a method has no such figure.
//! `isobar compare` reads it.

use crate::event::{Event, RunInfo};
use crate::sink::{OutputDirectory, Sink, SinkError};
use crate::summary::{MethodScores, PerVariable};
use isobar_model::Time;
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const SCORES_FILE: &str = "scores.csv";

/// The scores of each variable, by the beginning of their columns' names.
pub const PER_VARIABLE: [&str; 4] = ["rmse_background", "rmse_analysis", "spread_background", "spread_analysis"];

/// Writes the scores as they come.
#[derive(Debug)]
pub struct ScoresSink {
    path: PathBuf,
    writer: csv::Writer<File>,
    info: RunInfo,
}

impl ScoresSink {
    /// Creates the file in `directory`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = directory.path().join(SCORES_FILE);
        let mut writer = csv::Writer::from_path(&path).map_err(|error| failure(&path, &error))?;
        let mut header: Vec<String> = ["cycle", "valid_time", "method"].map(String::from).into();
        for variable in &info.layout.variables {
            header.extend(PER_VARIABLE.map(|score| format!("{score} {} [{}]", variable.name, variable.unit)));
        }
        header.extend(["bias_rmse", "bias_spread", "innovation_chi2"].map(String::from));
        writer.write_record(&header).map_err(|error| failure(&path, &error))?;
        Ok(Self { path, writer, info: info.clone() })
    }

    fn row(&self, cycle: usize, time: Time, method: usize, scores: &MethodScores) -> Vec<String> {
        let name = self.info.methods.get(method).map_or("", |method| method.name.as_str());
        let mut row = vec![cycle.to_string(), utc(time), name.to_string()];
        let figure = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        for variable in &self.info.layout.variables {
            let of = |table: Option<&PerVariable>| figure(table.and_then(|table| table.get(variable.name).copied()));
            row.push(of(Some(&scores.rmse_background)));
            row.push(of(Some(&scores.rmse_analysis)));
            row.push(of(scores.spread_background.as_ref()));
            row.push(of(scores.spread_analysis.as_ref()));
        }
        row.extend([scores.bias_rmse, scores.bias_spread, scores.innovation_chi2].map(figure));
        row
    }
}

impl Sink for ScoresSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Analysed(analysed) => {
                let row = self.row(analysed.cycle, analysed.time, analysed.method, analysed.scores);
                self.writer.write_record(&row).map_err(|error| failure(&self.path, &error))
            }
            Event::Finished(_) => self.writer.flush().map_err(|error| failure(&self.path, &error)),
            _ => Ok(()),
        }
    }
}

fn failure(path: &std::path::Path, reason: &dyn Display) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: reason.to_string() }
}

/// A valid time as text: `2026-01-15T06:00:00Z`; seconds since 1970 where the calendar ends.
pub fn utc(time: Time) -> String {
    match jiff::Timestamp::from_second(time.seconds()) {
        Ok(timestamp) => timestamp.to_string(),
        Err(_) => time.seconds().to_string(),
    }
}
