//! `parameters.csv`: what methods estimate beside state and calibration, one row for each parameter and cycle; not there if
//! no method does.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, `parameter`, `unit`, `estimate`, `sigma` (its claimed standard
//! deviation, empty while the data do not determine it), `verdict`. A parameter that the data do not
//! determine in the end is also reported as a warning.

use crate::calendar::utc;
use crate::event::{Estimated, Event, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use indexmap::IndexMap;
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// Name of the file in the output directory.
pub const PARAMETERS_FILE: &str = "parameters.csv";

/// Writes the parameters as they come.
#[derive(Debug)]
pub struct ParametersSink {
    path: PathBuf,
    /// None before the first parameter.
    writer: Option<csv::Writer<File>>,
    info: RunInfo,
    /// The last verdict on each parameter of each method.
    verdicts: IndexMap<(usize, String), String>,
    warnings: Vec<String>,
}

impl ParametersSink {
    /// A sink that creates the file in `directory` when it is needed.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        let path = directory.path().join(PARAMETERS_FILE);
        Self { path, writer: None, info: info.clone(), verdicts: IndexMap::new(), warnings: Vec::new() }
    }

    fn fault(&self, reason: &dyn Display) -> SinkError {
        SinkError { path: self.path.clone(), reason: reason.to_string() }
    }

    fn name(&self, method: usize) -> String {
        self.info.methods.get(method).map_or(String::new(), |method| method.name.clone())
    }

    fn write(&mut self, estimated: &Estimated<'_>) -> Result<(), SinkError> {
        let mut writer = match self.writer.take() {
            Some(writer) => writer,
            None => {
                let mut writer = csv::Writer::from_path(&self.path).map_err(|error| self.fault(&error))?;
                let header = ["cycle", "valid_time", "method", "parameter", "unit", "estimate", "sigma", "verdict"];
                writer.write_record(header).map_err(|error| self.fault(&error))?;
                writer
            }
        };
        for parameter in estimated.parameters.iter() {
            let row = [
                estimated.cycle.to_string(),
                utc(estimated.time),
                self.name(estimated.method),
                parameter.name.clone(),
                parameter.unit.clone(),
                parameter.value.to_string(),
                parameter.sigma.map_or(String::new(), |sigma| sigma.to_string()),
                parameter.verdict.clone(),
            ];
            writer.write_record(&row).map_err(|error| self.fault(&error))?;
            self.verdicts.insert((estimated.method, parameter.name.clone()), parameter.verdict.clone());
        }
        self.writer = Some(writer);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        for ((method, parameter), verdict) in &self.verdicts {
            if verdict.starts_with("not determined") {
                self.warnings.push(format!("method {}, {parameter}: {verdict}", self.name(*method)));
            }
        }
        match &mut self.writer {
            Some(writer) => writer.flush().map_err(|error| self.fault(&error)),
            None => Ok(()),
        }
    }
}

impl Sink for ParametersSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Estimated(estimated) => self.write(estimated),
            Event::Finished(_) => self.finish(),
            _ => Ok(()),
        }
    }

    fn warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }
}
