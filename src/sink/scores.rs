//! `scores.csv`: the scores of every method in every cycle, one row for each.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, then for each variable, with its unit in brackets,
//! `rmse_background`, `rmse_analysis`, `spread_background`, `spread_analysis`, as in `rmse_analysis h [m]`, then
//! `bias_rmse`, `bias_spread` and `innovation_chi2`. If a method has a smoother, `rmse_smoothed` and `spread_smoothed`
//! of each variable and `bias_rmse_smoothed`, `bias_spread_smoothed` follow: the scores of the cycle's estimate once later
//! observations have revised it. A field is empty where a method has no such figure. `isobar compare` reads it.

use crate::calendar::utc;
use crate::event::{Analysed, Event, RunInfo};
use crate::sink::{OutputDirectory, Sink, SinkError};
use crate::summary::{PerVariable, SmoothedScores};
use std::collections::VecDeque;
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const SCORES_FILE: &str = "scores.csv";

/// The scores of each variable, by the beginning of their columns' names.
pub const PER_VARIABLE: [&str; 4] = ["rmse_background", "rmse_analysis", "spread_background", "spread_analysis"];

/// Writes the scores as they come. A row waits until nothing in it will be smoothed any more.
#[derive(Debug)]
pub struct ScoresSink {
    path: PathBuf,
    writer: csv::Writer<File>,
    info: RunInfo,
    /// The most later cycles that revise an estimate, if a method has a smoother.
    lag: Option<usize>,
    waiting: VecDeque<Row>,
}

/// A row of the file.
#[derive(Debug)]
struct Row {
    cycle: usize,
    method: usize,
    fields: Vec<String>,
    smoothed: SmoothedScores,
}

impl ScoresSink {
    /// Creates the file in `directory`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = directory.path().join(SCORES_FILE);
        let mut writer = csv::Writer::from_path(&path).map_err(|error| failure(&path, &error))?;
        let lag = info.methods.iter().filter_map(|method| method.smoother_lag_cycles).max();
        let mut header: Vec<String> = ["cycle", "valid_time", "method"].map(String::from).into();
        let variables = &info.layout.variables;
        let column =
            |score: &str, variable: &isobar_model::Variable| format!("{score} {} [{}]", variable.name, variable.unit);
        for variable in variables {
            header.extend(PER_VARIABLE.map(|score| column(score, variable)));
        }
        header.extend(["bias_rmse", "bias_spread", "innovation_chi2"].map(String::from));
        if lag.is_some() {
            let names = |variable| ["rmse_smoothed", "spread_smoothed"].map(|score| column(score, variable));
            header.extend(variables.iter().flat_map(names));
            header.extend(["bias_rmse_smoothed", "bias_spread_smoothed"].map(String::from));
        }
        writer.write_record(&header).map_err(|error| failure(&path, &error))?;
        Ok(Self { path, writer, info: info.clone(), lag, waiting: VecDeque::new() })
    }

    fn row(&self, analysed: &Analysed<'_>) -> Row {
        let Analysed { cycle, method, scores, .. } = *analysed;
        let name = self.info.methods.get(method).map_or("", |method| method.name.as_str());
        let mut fields = vec![cycle.to_string(), utc(analysed.time), name.to_string()];
        for variable in &self.info.layout.variables {
            let tables = [Some(&scores.rmse_background), Some(&scores.rmse_analysis)];
            let spreads = [scores.spread_background.as_ref(), scores.spread_analysis.as_ref()];
            fields.extend(tables.into_iter().chain(spreads).map(|table| of_variable(table, variable.name)));
        }
        fields.extend([scores.bias_rmse, scores.bias_spread, scores.innovation_chi2].map(field));
        Row { cycle, method, fields, smoothed: SmoothedScores::default() }
    }

    /// Writes the rows of the cycles up to this one.
    fn write_until(&mut self, cycle: usize) -> Result<(), SinkError> {
        while let Some(Row { mut fields, smoothed, .. }) = self.waiting.pop_front_if(|row| row.cycle <= cycle) {
            if self.lag.is_some() {
                for variable in &self.info.layout.variables {
                    let tables = [Some(&smoothed.rmse), smoothed.spread.as_ref()];
                    fields.extend(tables.map(|table| of_variable(table, variable.name)));
                }
                fields.extend([smoothed.bias_rmse, smoothed.bias_spread].map(field));
            }
            self.writer.write_record(&fields).map_err(|error| failure(&self.path, &error))?;
        }
        Ok(())
    }
}

impl Sink for ScoresSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Analysed(analysed) => self.waiting.push_back(self.row(analysed)),
            Event::Smoothed(smoothed) => {
                let of_it = |row: &&mut Row| (row.cycle, row.method) == (smoothed.cycle, smoothed.method);
                if let Some(row) = self.waiting.iter_mut().find(of_it) {
                    row.smoothed = smoothed.scores.clone();
                }
            }
            Event::CycleEnded(cycle) => self.write_until(cycle.saturating_sub(self.lag.unwrap_or(0)))?,
            Event::Finished(_) => {
                self.write_until(usize::MAX)?;
                self.writer.flush().map_err(|error| failure(&self.path, &error))?;
            }
            _ => {}
        }
        Ok(())
    }
}

/// The figure of a variable; nothing if there is none.
fn of_variable(table: Option<&PerVariable>, variable: &str) -> String {
    field(table.and_then(|table| table.get(variable).copied()))
}

fn field(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

fn failure(path: &std::path::Path, reason: &dyn Display) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: reason.to_string() }
}
