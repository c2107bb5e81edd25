//! `sweep.json`, `sweep.csv`, the page and its figures.
//!
//! Columns of the table: `method`, `setting`, each key that varies, `score`, `seeds` (number of seeds that have it), `mean`,
//! `mean_low`, `mean_high` (the 95 % interval); a field is empty where there is no such figure.

use super::SweepSummary;
use super::tables::shown;
use crate::output::SinkError;
use crate::output::directory::SWEEP_FILE;
use crate::output::report::{FIGURES_DIRECTORY, REPORT_FILE};
use crate::scenario::Scenario;
use crate::tables::{Cell, Table};
use std::fs;
use std::path::Path;

/// Name of the table in the output directory.
pub const TABLE_FILE: &str = "sweep.csv";

impl SweepSummary {
    /// Writes all files into a directory; the page only if it is asked for.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn write(&self, directory: &Path, scenario: &Scenario, with_page: bool) -> Result<(), SinkError> {
        let put = |name: &str, text: Result<String, String>| {
            let path = directory.join(name);
            let written = text.and_then(|text| fs::write(&path, text).map_err(|error| error.to_string()));
            written.map_err(|reason| SinkError { path, reason })
        };
        put(TABLE_FILE, Ok(self.all_scores(scenario).csv()))?;
        if with_page {
            put(REPORT_FILE, self.html(scenario).map_err(|error| error.to_string()))?;
            let figures = directory.join(FIGURES_DIRECTORY);
            let cannot = |error: std::io::Error| SinkError { path: figures.clone(), reason: error.to_string() };
            fs::create_dir_all(&figures).map_err(cannot)?;
            for own in self.figures(scenario) {
                put(&format!("{FIGURES_DIRECTORY}/{}.svg", own.stem), Ok(own.plot.svg("figure").file))?;
            }
            for own in self.heat_maps(scenario) {
                put(&format!("{FIGURES_DIRECTORY}/{}.svg", own.stem), Ok(own.plot.svg().file))?;
            }
        }
        let json = serde_json::to_string_pretty(self).map(|text| text + "\n");
        put(SWEEP_FILE, json.map_err(|error| error.to_string()))
    }

    fn all_scores(&self, scenario: &Scenario) -> Table {
        let keys: Vec<&str> = scenario.sweep.iter().flat_map(|sweep| sweep.vary.keys()).map(String::as_str).collect();
        let header = [&["method", "setting"], &keys[..], &["score", "seeds", "mean", "mean_low", "mean_high"]].concat();
        let mut rows = Vec::new();
        for (method, settings) in &self.methods {
            for own in settings {
                for (name, score) in &own.scores {
                    let mut row: Vec<Cell> = vec![method.as_str().into(), own.directory.as_str().into()];
                    row.extend(keys.iter().map(|key| own.values.get(*key).map_or_else(String::new, shown).into()));
                    row.extend([name.as_str().into(), score.seeds.into()]);
                    let interval = score.interval;
                    row.extend(
                        [Some(score.mean), interval.map(|it| it.low), interval.map(|it| it.high)].map(Cell::in_full),
                    );
                    rows.push(row);
                }
            }
        }
        Table::new(&header, rows)
    }
}
