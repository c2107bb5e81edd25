//! `scores.csv`: the scores of every method in every cycle, one row for each.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, then for each variable, with its unit in brackets,
//! `rmse_background`, `rmse_analysis`, `spread_background`, `spread_analysis`, as in `rmse_analysis h [m]`, then
//! `bias_rmse`, `bias_spread` and `innovation_chi2`. If a method has a smoother, `rmse_smoothed` and `spread_smoothed`
//! of each variable and `bias_rmse_smoothed`, `bias_spread_smoothed` follow: the scores of the cycle's estimate once later
//! observations have revised it. A field is empty where a method has no such figure. Without a truth there are no columns
//! of `rmse_…` and `bias_rmse`; instead there are `departure_background` and `departure_analysis`, the root-mean-square
//! departures of the observations that are used. With passive networks there are `passive_departure_background` and
//! `passive_departure_analysis`. `isobar compare` reads it.

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

/// Writes the scores as they come. A row waits until nothing in it will be smoothed any more.
#[derive(Debug)]
pub struct ScoresSink {
    path: PathBuf,
    writer: csv::Writer<File>,
    info: RunInfo,
    /// The most later cycles that revise an estimate, if a method has a smoother.
    lag: Option<usize>,
    /// The keys of the scores in the columns.
    keys: Vec<String>,
    waiting: VecDeque<Row>,
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
    /// Creates the file in `directory`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = directory.path().join(SCORES_FILE);
        let mut writer = csv::Writer::from_path(&path).map_err(|error| failure(&path, &error))?;
        let lag = info.methods.iter().filter_map(|method| method.smoother_lag_cycles).max();
        let mut header: Vec<String> = ["cycle", "valid_time", "method"].map(String::from).into();
        let columns = columns(info, lag.is_some());
        header.extend(columns.iter().map(|(_, title)| title.clone()));
        writer.write_record(&header).map_err(|error| failure(&path, &error))?;
        let keys = columns.into_iter().map(|(key, _)| key).collect();
        Ok(Self { path, writer, info: info.clone(), lag, keys, waiting: VecDeque::new() })
    }

    /// Writes the rows of the cycles up to this one.
    fn write_until(&mut self, last: usize) -> Result<(), SinkError> {
        while let Some(Row { cycle, method, time, values }) = self.waiting.pop_front_if(|row| row.cycle <= last) {
            let name = self.info.methods.get(method).map_or("", |method| method.name.as_str());
            let mut fields = vec![cycle.to_string(), utc(time), name.to_string()];
            let field = |key: &String| values.get(key).map_or_else(String::new, f64::to_string);
            fields.extend(self.keys.iter().map(field));
            self.writer.write_record(&fields).map_err(|error| failure(&self.path, &error))?;
        }
        Ok(())
    }
}

/// The scores of a cycle: keys and titles, `rmse_analysis.h` and `rmse_analysis h [m]`.
fn columns(info: &RunInfo, with_smoothed: bool) -> Vec<(String, String)> {
    let variables = info.variables();
    let scores = |smoothed: bool| {
        let is_there = |kind: &ScoreKind| kind.is_of_cycles() && info.can_have(kind);
        Score::all(&variables, move |kind| is_there(kind) && (kind.part == Part::Smoothed) == smoothed)
    };
    let all = scores(false).into_iter().chain(if with_smoothed { scores(true) } else { Vec::new() });
    all.map(|score| (score.key(), score.column())).collect()
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
                self.writer.flush().map_err(|error| failure(&self.path, &error))?;
            }
            _ => {}
        }
        Ok(())
    }
}

fn failure(path: &std::path::Path, reason: &dyn Display) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: reason.to_string() }
}
