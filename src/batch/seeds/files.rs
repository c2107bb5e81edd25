//! `seeds.json` and `seeds.csv`.
//!
//! Columns of the latter: `method`, `score`, `seeds` (number of seeds that have it), `mean`, `mean_low`, `mean_high`, then
//! `against`, `difference`, `difference_low`, `difference_high`, `significant`. Intervals are at 95 %; a field is empty
//! where there is no such figure.

use super::{SeedsScore, SeedsSummary};
use crate::output::SinkError;
use crate::output::directory::SEEDS_FILE;
use crate::scores::statistics::Interval;
use crate::tables::{Cell, Table};
use std::fs;
use std::path::Path;

/// Name of the table in the output directory.
pub const TABLE_FILE: &str = "seeds.csv";

const HEADER: [&str; 11] = [
    "method",
    "score",
    "seeds",
    "mean",
    "mean_low",
    "mean_high",
    "against",
    "difference",
    "difference_low",
    "difference_high",
    "significant",
];

impl SeedsSummary {
    /// Writes both files into a directory.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn write(&self, directory: &Path) -> Result<(), SinkError> {
        let put = |name: &str, text: Result<String, String>| {
            let path = directory.join(name);
            let written = text.and_then(|text| fs::write(&path, text).map_err(|error| error.to_string()));
            written.map_err(|reason| SinkError { path, reason })
        };
        put(TABLE_FILE, Ok(self.table().csv()))?;
        let json = serde_json::to_string_pretty(self).map(|text| text + "\n");
        put(SEEDS_FILE, json.map_err(|error| error.to_string()))
    }

    fn table(&self) -> Table {
        let ends =
            |interval: Option<Interval>| [interval.map(|it| it.low), interval.map(|it| it.high)].map(Cell::in_full);
        let row = |method: &String, name: &String, score: &SeedsScore| {
            let difference = score.difference;
            let mut row: Vec<Cell> = vec![method.as_str().into(), name.as_str().into()];
            row.extend([score.values.iter().flatten().count().into(), Cell::in_full(Some(score.mean))]);
            row.extend(ends(score.interval));
            row.push(difference.map_or("", |_| &self.against).into());
            row.push(Cell::in_full(difference.map(|it| it.mean)));
            row.extend(ends(difference.and_then(|it| it.interval)));
            let significant = difference.and_then(|it| it.significant);
            row.push(significant.map_or_else(String::new, |it| it.to_string()).into());
            row
        };
        let rows = self.methods.iter().flat_map(|(method, scores)| scores.iter().map(move |own| (method, own)));
        Table::new(&HEADER, rows.map(|(method, (name, score))| row(method, name, score)).collect())
    }
}
