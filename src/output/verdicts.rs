//! `verdicts.csv`: which biases the observations determine, cycle by cycle; a row for the first verdict on each bias of each
//! method that claims a covariance of biases, and for each verdict that is another than in the cycle before. A run that goes on
//! from an earlier one goes on with its rows. The file is not there if there is no such method.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, `parameter`, `stable` and `frozen` (`true` or `false`), `variance_ratio` (the
//! share of its prior variance that it still has), `verdict`, `because` (empty for a stable one).

use crate::calendar::utc;
use crate::event::{Event, Judged, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const VERDICTS_FILE: &str = "verdicts.csv";

/// Writes the verdicts as they come.
#[derive(Debug)]
pub struct VerdictsSink {
    path: PathBuf,
    /// None before the first verdict.
    writer: Option<csv::Writer<File>>,
    info: RunInfo,
}

impl VerdictsSink {
    /// A sink that creates the file in `directory` when it is needed.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        Self { path: directory.path().join(VERDICTS_FILE), writer: None, info: info.clone() }
    }

    fn fault(&self, reason: &dyn Display) -> SinkError {
        SinkError { path: self.path.clone(), reason: reason.to_string() }
    }

    fn write(&mut self, judged: &Judged<'_>) -> Result<(), SinkError> {
        let mut writer = match self.writer.take() {
            Some(writer) => writer,
            None => {
                let mut writer = csv::Writer::from_path(&self.path).map_err(|error| self.fault(&error))?;
                let header = [
                    "cycle",
                    "valid_time",
                    "method",
                    "parameter",
                    "stable",
                    "frozen",
                    "variance_ratio",
                    "verdict",
                    "because",
                ];
                writer.write_record(header).map_err(|error| self.fault(&error))?;
                writer
            }
        };
        let method = self.info.methods.get(judged.method).map_or("", |method| method.name.as_str());
        for verdict in judged.verdicts.iter() {
            let parameter = self.info.calibration.parameters.get(verdict.parameter);
            let ratio = Some(verdict.variance_ratio).filter(|ratio| ratio.is_finite());
            let row = [
                judged.cycle.to_string(),
                utc(judged.time),
                method.to_string(),
                parameter.map_or(String::new(), |it| it.name.clone()),
                verdict.stable.to_string(),
                verdict.frozen.to_string(),
                ratio.map_or(String::new(), |ratio| ratio.to_string()),
                verdict.in_words().to_string(),
                verdict.why.join("; "),
            ];
            writer.write_record(&row).map_err(|error| self.fault(&error))?;
        }
        self.writer = Some(writer);
        Ok(())
    }
}

impl Sink for VerdictsSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match (event, &mut self.writer) {
            (Event::Judged(judged), _) => self.write(judged),
            (Event::Finished(_), Some(writer)) => writer.flush().map_err(|error| self.fault(&error)),
            _ => Ok(()),
        }
    }
}
