//! `verdicts.csv`: which biases the observations determine, cycle by cycle; a row for the first verdict on each bias of each
//! method that claims a covariance of biases, and for each verdict that is another than in the cycle before. A run that goes on
//! from an earlier one goes on with its rows. Without such a method there is no file.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, `parameter`, `stable` and `frozen` (`true` or `false`), `variance_ratio` (the
//! share of its prior variance that it still has), `verdict`, `because` (empty for a stable one).

use crate::calendar::utc;
use crate::event::{Event, Judged, RunInfo};
use crate::output::late_csv::LateCsv;
use crate::output::{OutputDirectory, Sink, SinkError};

/// Name of the file in the output directory.
pub const VERDICTS_FILE: &str = "verdicts.csv";

/// The columns.
const HEADER: [&str; 9] =
    ["cycle", "valid_time", "method", "parameter", "stable", "frozen", "variance_ratio", "verdict", "because"];

/// Writes the verdicts as they come.
#[derive(Debug)]
pub struct VerdictsSink {
    file: LateCsv,
    info: RunInfo,
}

impl VerdictsSink {
    /// A sink that creates the file in `directory` when it is needed.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        Self { file: LateCsv::new(directory, VERDICTS_FILE, &HEADER), info: info.clone() }
    }

    fn write(&mut self, judged: &Judged<'_>) -> Result<(), SinkError> {
        let method = self.info.methods.get(judged.method).map_or("", |method| method.name.as_str());
        for verdict in judged.verdicts.iter() {
            let parameter = self.info.calibration.parameters.get(verdict.parameter);
            let ratio = Some(verdict.variance_ratio).filter(|ratio| ratio.is_finite());
            self.file.write([
                judged.cycle.to_string(),
                utc(judged.time),
                method.to_string(),
                parameter.map_or(String::new(), |it| it.name.clone()),
                verdict.stable.to_string(),
                verdict.frozen.to_string(),
                ratio.map_or(String::new(), |ratio| ratio.to_string()),
                verdict.in_words().to_string(),
                verdict.why.join("; "),
            ])?;
        }
        Ok(())
    }
}

impl Sink for VerdictsSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Judged(judged) => self.write(judged),
            Event::Finished(_) => self.file.flush(),
            _ => Ok(()),
        }
    }
}
