//! `parameters.csv`: what methods estimate beside state and calibration, one row for each parameter and cycle; not there if
//! no method does.
//!
//! Columns: `cycle`, `valid_time` (UTC), `method`, `parameter`, `unit`, `estimate`, `sigma` (its claimed standard
//! deviation, empty while the data do not determine it), `verdict`. A parameter that the data do not
//! determine in the end is also reported as a warning.

use crate::calendar::utc;
use crate::event::{Estimated, Event, RunInfo};
use crate::output::late_csv::LateCsv;
use crate::output::{OutputDirectory, Sink, SinkError};
use indexmap::IndexMap;

/// Name of the file in the output directory.
pub const PARAMETERS_FILE: &str = "parameters.csv";

/// The columns.
const HEADER: [&str; 8] = ["cycle", "valid_time", "method", "parameter", "unit", "estimate", "sigma", "verdict"];

/// Writes the parameters as they come.
#[derive(Debug)]
pub struct ParametersSink {
    file: LateCsv,
    info: RunInfo,
    /// The last verdict on each parameter of each method.
    verdicts: IndexMap<(usize, String), String>,
    warnings: Vec<String>,
}

impl ParametersSink {
    /// A sink that creates the file in `directory` when it is needed.
    pub fn new(info: &RunInfo, directory: &OutputDirectory) -> Self {
        let file = LateCsv::new(directory, PARAMETERS_FILE, &HEADER);
        Self { file, info: info.clone(), verdicts: IndexMap::new(), warnings: Vec::new() }
    }

    fn name(&self, method: usize) -> String {
        self.info.methods.get(method).map_or(String::new(), |method| method.name.clone())
    }

    fn write(&mut self, estimated: &Estimated<'_>) -> Result<(), SinkError> {
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
            self.file.write(row)?;
            self.verdicts.insert((estimated.method, parameter.name.clone()), parameter.verdict.clone());
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        for ((method, parameter), verdict) in &self.verdicts {
            if verdict.starts_with("not determined") {
                self.warnings.push(format!("method {}, {parameter}: {verdict}", self.name(*method)));
            }
        }
        self.file.flush()
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
