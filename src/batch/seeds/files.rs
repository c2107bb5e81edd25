//! `seeds.json` and `seeds.csv`.
//!
//! Columns of the latter: `method`, `score`, `seeds` (number of seeds that have it), `mean`, `mean_low`, `mean_high`, then
//! `against`, `difference`, `difference_low`, `difference_high`, `significant`. Intervals are at 95 %; a field is empty
//! where there is no such figure.

use super::SeedsSummary;
use crate::output::SinkError;
use crate::output::directory::SEEDS_FILE;
use crate::scores::statistics::Interval;
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
        put(TABLE_FILE, self.csv().map_err(|error| error.to_string()))?;
        let json = serde_json::to_string_pretty(self).map(|text| text + "\n");
        put(SEEDS_FILE, json.map_err(|error| error.to_string()))
    }

    fn csv(&self) -> Result<String, csv::Error> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(HEADER)?;
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let ends = |interval: Option<Interval>| [interval.map(|it| it.low), interval.map(|it| it.high)].map(number);
        for (method, scores) in &self.methods {
            for (name, score) in scores {
                let count = score.values.iter().flatten().count();
                let mut row = vec![method.clone(), name.clone(), count.to_string(), score.mean.to_string()];
                row.extend(ends(score.interval));
                let difference = score.difference;
                row.push(difference.map_or_else(String::new, |_| self.against.clone()));
                row.push(number(difference.map(|it| it.mean)));
                row.extend(ends(difference.and_then(|it| it.interval)));
                let significant = difference.and_then(|it| it.significant);
                row.push(significant.map_or_else(String::new, |it| it.to_string()));
                writer.write_record(&row)?;
            }
        }
        let bytes = writer.into_inner().map_err(|error| error.into_error())?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }
}
