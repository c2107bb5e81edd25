//! `readings.csv`: every observation without the biases that methods have found, of a run whose sensors are kept in a
//! database.
//!
//! Columns: `cycle`, `valid_time` (UTC), `network`, `platform`, `variable`, `unit`, `x_m`, `y_m`, `use` (`used`, or why not),
//! `value`, `sigma` (of its random error), then for each method that estimates biases `METHOD calibrated`, the value
//! without its bias, and `METHOD sigma`, how well the method knows that bias. A field is empty where there is no such figure.

use crate::calendar::utc;
use crate::event::{Analysed, Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::readings::Readings;
use isobar_obs::{ObservationWindow, Report};
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const READINGS_FILE: &str = "readings.csv";

/// Writes the readings of a cycle when it has ended.
pub struct ReadingsSink {
    path: PathBuf,
    writer: csv::Writer<File>,
    info: RunInfo,
    observed: Option<ObservationWindow>,
    /// By method; `None` where it has no readings in this cycle.
    readings: Vec<Option<Readings>>,
    /// The methods that have columns.
    columns: Vec<usize>,
}

impl ReadingsSink {
    /// Creates the file in `directory`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = directory.path().join(READINGS_FILE);
        let failure = |error: csv::Error| SinkError { path: path.clone(), reason: error.to_string() };
        let mut writer = csv::Writer::from_path(&path).map_err(failure)?;
        let columns: Vec<usize> = (0..info.methods.len()).filter(|&it| info.methods[it].estimates_biases).collect();
        let mut header: Vec<String> =
            ["cycle", "valid_time", "network", "platform", "variable", "unit", "x_m", "y_m", "use", "value", "sigma"]
                .map(String::from)
                .into();
        for name in columns.iter().map(|&method| &info.methods[method].name) {
            header.extend([format!("{name} calibrated"), format!("{name} sigma")]);
        }
        writer.write_record(&header).map_err(failure)?;
        let readings = vec![None; info.methods.len()];
        Ok(Self { path, writer, info: info.clone(), observed: None, readings, columns })
    }

    fn failure(&self, reason: &dyn Display) -> SinkError {
        SinkError { path: self.path.clone(), reason: reason.to_string() }
    }

    /// Writes the rows of the cycle.
    fn write(&mut self) -> Result<(), SinkError> {
        let Some(observed) = self.observed.take() else { return Ok(()) };
        let used = observed.reports.iter().zip(&observed.times).zip(&observed.values).zip(&observed.sigma);
        let used = used.map(|(((report, time), value), sigma)| (report, *time, *value, *sigma, "used"));
        let unused = observed.aside.unused.iter();
        let unused = unused.map(|it| (&it.report, it.time, it.value, it.sigma, it.why.name()));
        let number = |value: Option<f64>| value.filter(|it| it.is_finite()).map_or(String::new(), |it| it.to_string());
        for (row, (report, time, value, sigma, why)) in used.chain(unused).enumerate() {
            let Report { network, platform, variable, x_m, y_m, .. } = report;
            let variable = self.info.layout.variables.get(*variable);
            let mut fields = vec![
                observed.cycle.to_string(),
                utc(time),
                network.to_string(),
                platform.to_string(),
                variable.map_or(String::new(), |it| it.name.to_string()),
                variable.map_or(String::new(), |it| it.unit.to_string()),
                x_m.to_string(),
                y_m.to_string(),
                why.to_string(),
                number(Some(value)),
                number(Some(sigma)),
            ];
            for &method in &self.columns {
                let own = self.readings[method].as_ref();
                let of = |numbers: fn(&Readings) -> &Vec<f64>| number(own.and_then(|it| numbers(it).get(row)).copied());
                fields.extend([of(|it| &it.values), of(|it| &it.sigma)]);
            }
            self.writer.write_record(&fields).map_err(|error| self.failure(&error))?;
        }
        self.readings.fill(None);
        Ok(())
    }
}

impl Sink for ReadingsSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Observed { window, .. } => self.observed = Some(window.clone().into_owned()),
            Event::Analysed(Analysed { method, readings, .. }) => {
                self.readings[*method] = readings.as_deref().cloned();
            }
            Event::CycleEnded(_) => self.write()?,
            Event::Finished(_) => self.writer.flush().map_err(|error| self.failure(&error))?,
            _ => {}
        }
        Ok(())
    }
}
