//! `forecasts.csv`: the scores of forecasts ahead, a row for each method, lead time and variable.
//!
//! Columns: `method`, `lead_hours`, `variable`, `unit` (UDUNITS), `cases`, then `rmse`, `spread`, `spread_per_error`,
//! `anomaly_correlation`, `departure` and `standardised_departure`, each but `spread_per_error` with the ends of its 95 %
//! interval after it, as in `rmse_low` and `rmse_high`. A field is empty where there is no such figure. Lead time 0 is the
//! analysis. There is no file in a run without forecasts ahead.

use crate::event::{Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::scores::Summary;
use crate::scores::forecast::{FORECAST_SCORES, Known, SPREAD_PER_ERROR};
use crate::tables::{Cell, Table};
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const FORECASTS_FILE: &str = "forecasts.csv";

/// Writes the scores once all are known.
#[derive(Debug)]
pub struct ForecastsSink {
    path: PathBuf,
    /// Names and units of the variables; `None` in a run without forecasts ahead.
    variables: Option<Vec<(&'static str, &'static str)>>,
}

impl ForecastsSink {
    /// A sink that writes into `directory`.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        let variables = info.lead_times.map(|_| info.variables());
        Self { path: directory.path().join(FORECASTS_FILE), variables }
    }
}

/// All scores of forecasts ahead.
fn table(summary: &Summary, variables: &[(&str, &str)]) -> Table {
    let mut header: Vec<String> = ["method", "lead_hours", "variable", "unit", "cases"].map(String::from).into();
    for name in FORECAST_SCORES {
        header.push(name.into());
        if name != SPREAD_PER_ERROR {
            header.extend(["low", "high"].map(|end| format!("{name}_{end}")));
        }
    }
    let mut rows = Vec::new();
    for (method, scores) in &summary.methods {
        for lead in scores.forecasts.iter().flat_map(|forecasts| &forecasts.leads) {
            for &(variable, unit) in variables {
                let mut row: Vec<Cell> = vec![method.as_str().into(), Cell::in_full(Some(lead.lead_hours))];
                row.extend([variable.into(), unit.into(), lead.cases.into()]);
                for name in FORECAST_SCORES {
                    let known: Option<&Known> = lead.score(name, variable);
                    row.push(Cell::in_full(known.map(|known| known.value)));
                    if name != SPREAD_PER_ERROR {
                        let interval = known.and_then(|known| known.interval);
                        row.extend([interval.map(|it| it.low), interval.map(|it| it.high)].map(Cell::in_full));
                    }
                }
                rows.push(row);
            }
        }
    }
    Table { header, rows }
}

impl Sink for ForecastsSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let (Event::Finished(summary), Some(variables)) = (event, &self.variables) else { return Ok(()) };
        let written = std::fs::write(&self.path, table(summary, variables).csv());
        written.map_err(|error| SinkError { path: self.path.clone(), reason: error.to_string() })
    }
}
