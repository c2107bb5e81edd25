//! `warnings.csv` and `warning_scores.csv`: the probabilities that forecasts ahead gave to the events of the scenario's warnings,
//! and how right they were.
//!
//! `warnings.csv` has a row for each warning, method, start and lead time: `warning`, `method`, `from_cycle`, `from_time`,
//! `lead_hours`, `valid_time` (UTC), `probability`, `issued` and `occurred`, both 1 or 0. `occurred` is empty where nothing says
//! whether the event came about: of times after the end of the run, and without a truth where there is no observation.
//!
//! `warning_scores.csv` has a row for each warning, method and lead time, and one with an empty lead time for all lead times
//! after the analysis: `warning`, `method`, `lead_hours`, `cases`, `occurred`, `hits`, `misses`, `false_alarms`, `brier`,
//! `brier_low` and `brier_high`, the ends of its 95 % interval, `reliability`, `resolution`, `uncertainty` and `skill`. There are
//! no such files in a run without warnings.

use crate::calendar::utc;
use crate::event::{Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::scores::warnings::VerifiedWarnings;
use crate::scores::{Outlook, Summary, WarningCase};
use crate::tables::{Cell, Table};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Name of the file of all warnings in the output directory.
pub const WARNINGS_FILE: &str = "warnings.csv";

/// Name of the file of their scores.
pub const WARNING_SCORES_FILE: &str = "warning_scores.csv";

/// Writes both files when the run is complete.
#[derive(Debug)]
pub struct WarningsSink {
    directory: PathBuf,
    info: RunInfo,
    /// By warning, method, start and lead time in cycles.
    rows: BTreeMap<(usize, usize, usize, usize), WarningCase>,
}

impl WarningsSink {
    /// A sink that writes into `directory`.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        Self { directory: directory.path().to_path_buf(), info: info.clone(), rows: BTreeMap::new() }
    }

    fn add_outlook(&mut self, method: usize, outlook: &Outlook) {
        for (lead, probabilities) in &outlook.leads {
            for (number, (&probability, placed)) in probabilities.iter().zip(&self.info.warnings).enumerate() {
                let case = WarningCase { probability, issued: placed.issues(probability), occurred: None };
                self.rows.insert((number, method, outlook.from_cycle, *lead), case);
            }
        }
    }

    fn table(&self) -> Table {
        let header = [
            "warning",
            "method",
            "from_cycle",
            "from_time",
            "lead_hours",
            "valid_time",
            "probability",
            "issued",
            "occurred",
        ];
        let info = &self.info;
        let yes_or_no = |it: bool| Cell::from(usize::from(it));
        let row = |(&(number, method, from_cycle, lead), case): (&(usize, usize, usize, usize), &WarningCase)| {
            vec![
                info.warnings[number].warning.name.as_str().into(),
                info.methods[method].name.as_str().into(),
                from_cycle.into(),
                utc(info.time(from_cycle)).into(),
                Cell::in_full(Some(info.lead_hours(lead))),
                utc(info.time(from_cycle + lead)).into(),
                Cell::in_full(Some(case.probability)),
                yes_or_no(case.issued),
                case.occurred.map_or_else(Cell::default, yes_or_no),
            ]
        };
        Table::new(&header, self.rows.iter().map(row).collect())
    }

    fn write(&self, file: &str, table: &Table) -> Result<(), SinkError> {
        let path = self.directory.join(file);
        std::fs::write(&path, table.csv()).map_err(|error| SinkError { path, reason: error.to_string() })
    }
}

/// All scores of warnings.
fn scores(summary: &Summary) -> Table {
    let header = [
        "warning",
        "method",
        "lead_hours",
        "cases",
        "occurred",
        "hits",
        "misses",
        "false_alarms",
        "brier",
        "brier_low",
        "brier_high",
        "reliability",
        "resolution",
        "uncertainty",
        "skill",
    ];
    let mut rows = Vec::new();
    for (method, scores) in &summary.methods {
        for warning in &scores.warnings {
            let leads = warning.leads.iter().map(|lead| (Some(lead.lead_hours), &lead.scores));
            for (hours, verified) in leads.chain([(None, &warning.ahead)]) {
                let mut row = vec![warning.name.as_str().into(), method.as_str().into(), Cell::in_full(hours)];
                row.extend(figures(verified));
                rows.push(row);
            }
        }
    }
    Table::new(&header, rows)
}

fn figures(verified: &VerifiedWarnings) -> Vec<Cell> {
    let VerifiedWarnings { cases, occurred, hits, misses, false_alarms, brier } = verified;
    let counts = [cases, occurred, hits, misses, false_alarms].map(|&count| Cell::from(count));
    let interval = brier.and_then(|it| it.score.interval);
    let figures = [
        brier.map(|it| it.score.value),
        interval.map(|it| it.low),
        interval.map(|it| it.high),
        brier.map(|it| it.reliability),
        brier.map(|it| it.resolution),
        brier.map(|it| it.uncertainty),
        brier.and_then(|it| it.skill),
    ];
    counts.into_iter().chain(figures.map(Cell::in_full)).collect()
}

impl Sink for WarningsSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Outlook { method, outlook } => self.add_outlook(*method, outlook),
            Event::Forecast(forecast) => {
                let lead = forecast.cycle - forecast.from_cycle;
                for (number, case) in forecast.warnings.iter().enumerate() {
                    self.rows.insert((number, forecast.method, forecast.from_cycle, lead), *case);
                }
            }
            Event::Finished(summary) => {
                self.write(WARNINGS_FILE, &self.table())?;
                self.write(WARNING_SCORES_FILE, &scores(summary))?;
            }
            _ => {}
        }
        Ok(())
    }
}
