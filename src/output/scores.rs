//! `scores.csv`: the scores of every method in every cycle, one row for each; `scores_long.csv`: the same, one row for each value.
//!
//! Columns of `scores.csv`: `cycle`, `valid_time` (UTC), `method`, then for each variable, with its unit in brackets,
//! `rmse_background`, `rmse_analysis`, `spread_background`, `spread_analysis`, as in `rmse_analysis h [m]`, then
//! `bias_rmse`, `bias_spread` and `innovation_chi2`. If a method has a smoother, `rmse_smoothed` and `spread_smoothed`
//! of each variable and `bias_rmse_smoothed`, `bias_spread_smoothed` follow: the scores of the cycle's estimate once later
//! observations have revised it. A field is empty where a method has no such figure. Without a truth there are no columns
//! of `rmse_…` and `bias_rmse`; instead there are `departure_background` and `departure_analysis`, the root-mean-square
//! departures of the observations that are used. With passive networks there are `passive_departure_background` and
//! `passive_departure_analysis`. `isobar compare` reads it.
//!
//! Columns of `scores_long.csv`: `cycle`, `valid_time`, `method`, `score` (`rmse_analysis`), `variable` (empty for a score of the
//! method as a whole), `unit` (UDUNITS), `value`. A value that a method does not have has no row.

use crate::calendar::utc;
use crate::event::{Analysed, Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::scores::{Part, Score, ScoreKind, Values};
use isobar_model::Time;
use std::collections::VecDeque;
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const SCORES_FILE: &str = "scores.csv";

/// Name of the file with a row for each value.
pub const LONG_SCORES_FILE: &str = "scores_long.csv";

/// Writes the scores as they come. A row waits until nothing in it will be smoothed any more.
#[derive(Debug)]
pub struct ScoresSink {
    wide: Table,
    long: Table,
    info: RunInfo,
    /// The most later cycles that revise an estimate, if a method has a smoother.
    lag: Option<usize>,
    /// The scores, in the order of the columns.
    scores: Vec<Score<'static>>,
    waiting: VecDeque<Row>,
}

/// A file.
#[derive(Debug)]
struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl Table {
    fn create(path: PathBuf, header: &[String]) -> Result<Self, SinkError> {
        let writer = csv::Writer::from_path(&path).map_err(|error| failure(&path, &error))?;
        let mut table = Self { path, writer };
        table.add(header)?;
        Ok(table)
    }

    fn add(&mut self, fields: &[String]) -> Result<(), SinkError> {
        self.writer.write_record(fields).map_err(|error| failure(&self.path, &error))
    }

    fn flush(&mut self) -> Result<(), SinkError> {
        self.writer.flush().map_err(|error| failure(&self.path, &error))
    }
}

/// A row of the file.
#[derive(Debug)]
struct Row {
    cycle: usize,
    method: usize,
    time: Time,
    values: Values,
}

impl ScoresSink {
    /// Creates the files in `directory`.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let lag = info.methods.iter().filter_map(|method| method.smoother_lag_cycles).max();
        let scores = columns(info, lag.is_some());
        let first: Vec<String> = ["cycle", "valid_time", "method"].map(String::from).into();
        let header = [first.clone(), scores.iter().map(Score::column).collect()].concat();
        let wide = Table::create(directory.path().join(SCORES_FILE), &header)?;
        let header = [first, ["score", "variable", "unit", "value"].map(String::from).into()].concat();
        let long = Table::create(directory.path().join(LONG_SCORES_FILE), &header)?;
        Ok(Self { wide, long, info: info.clone(), lag, scores, waiting: VecDeque::new() })
    }

    /// Writes the rows of the cycles up to this one.
    fn write_until(&mut self, last: usize) -> Result<(), SinkError> {
        while let Some(Row { cycle, method, time, values }) = self.waiting.pop_front_if(|row| row.cycle <= last) {
            let name = self.info.methods.get(method).map_or("", |method| method.name.as_str());
            let first = [cycle.to_string(), utc(time), name.to_string()];
            let mut fields = first.to_vec();
            for score in &self.scores {
                let value = values.get(&score.key()).map(f64::to_string);
                fields.push(value.clone().unwrap_or_default());
                if let Some(value) = value {
                    let rest = [score.kind.name, score.variable.0, score.unit()].map(String::from);
                    self.long.add(&[first.as_slice(), &rest, &[value]].concat())?;
                }
            }
            self.wide.add(&fields)?;
        }
        Ok(())
    }
}

/// The scores of a cycle.
fn columns(info: &RunInfo, with_smoothed: bool) -> Vec<Score<'static>> {
    let variables = info.variables();
    let scores = |smoothed: bool| {
        let is_there = |kind: &ScoreKind| kind.is_of_cycles() && info.can_have(kind);
        Score::all(&variables, move |kind| is_there(kind) && (kind.part == Part::Smoothed) == smoothed)
    };
    scores(false).into_iter().chain(if with_smoothed { scores(true) } else { Vec::new() }).collect()
}

impl Sink for ScoresSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Analysed(Analysed { method, cycle, time, scores, .. }) => {
                let values = scores.clone().into_owned();
                self.waiting.push_back(Row { cycle: *cycle, method: *method, time: *time, values });
            }
            Event::Smoothed(smoothed) => {
                let of_it = |row: &&mut Row| (row.cycle, row.method) == (smoothed.cycle, smoothed.method);
                if let Some(row) = self.waiting.iter_mut().find(of_it) {
                    row.values.extend(smoothed.scores.clone().into_owned());
                }
            }
            Event::CycleEnded(cycle) => self.write_until(cycle.saturating_sub(self.lag.unwrap_or(0)))?,
            Event::Finished(_) => {
                self.write_until(usize::MAX)?;
                self.wide.flush()?;
                self.long.flush()?;
            }
            _ => {}
        }
        Ok(())
    }
}

fn failure(path: &std::path::Path, reason: &dyn Display) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: reason.to_string() }
}
