//! `truth.nc`: the true states on their staggered grid, and the true calibration parameters.

use super::coordinates as cf;
use super::file::{Definition, FILL_VALUE, NetcdfFile};
use crate::event::RunInfo;
use crate::output::SinkError;
use isobar_model::{Layout, State, Time};
use isobar_obs::Calibration;
use std::path::Path;
use std::sync::Arc;

/// The file of the truth.
#[derive(Debug)]
pub struct TruthFile {
    file: NetcdfFile,
    layout: Arc<Layout>,
    /// The names of the variables of the state.
    names: Vec<String>,
    parameters: usize,
}

/// Name of the variable of the true calibration parameters.
const CALIBRATION: &str = "calibration";

impl TruthFile {
    /// Creates the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path, info: &RunInfo) -> Result<Self, SinkError> {
        let mut definition = Definition::new();
        cf::add_global_attributes(&mut definition, info, "truth");
        cf::add_time(&mut definition);
        cf::add_grid(&mut definition, &info.layout, info.projection.as_ref());
        let taken = [CALIBRATION, "parameter_name", "parameter_unit"];
        let mut names = Vec::new();
        for variable in &info.layout.variables {
            // A model may have a variable `x`, as the grid has.
            let is_taken = taken.contains(&variable.name) || definition.has_variable(variable.name);
            let name = if is_taken { format!("{}_true", variable.name) } else { variable.name.to_string() };
            let long_name = format!("true {}", variable.long_name);
            let projected = info.projection.is_some();
            let field = cf::field(&name, &long_name, variable.unit, variable.location, projected);
            definition.record(field.with_some("standard_name", variable.standard_name));
            names.push(name);
        }
        let Calibration { parameters, .. } = &info.calibration;
        if !parameters.is_empty() {
            cf::add_parameters(&mut definition, &info.calibration);
            definition.record(cf::parameters(CALIBRATION, "true calibration parameters", &info.calibration));
        }
        let (layout, parameters) = (Arc::clone(&info.layout), parameters.len());
        Ok(Self { file: NetcdfFile::create(path, definition)?, layout, names, parameters })
    }

    /// Appends a cycle's truth; what is not known of the calibration is missing.
    ///
    /// # Errors
    /// If state or calibration do not fit the run, or the file cannot be written.
    pub fn append(&mut self, time: Time, state: &State, calibration: &[Option<f64>]) -> Result<(), SinkError> {
        let cells = self.layout.grid.cells();
        let time = [time.seconds() as f64];
        let calibration: Vec<f64> = calibration.iter().map(|value| value.unwrap_or(FILL_VALUE)).collect();
        let mut values: Vec<(&str, &[f64])> = vec![("time", &time)];
        values.extend(self.names.iter().map(String::as_str).zip(state.values().chunks_exact(cells)));
        if self.parameters > 0 {
            values.push((CALIBRATION, &calibration));
        }
        self.file.append(&values)
    }

    /// The file.
    pub fn file(&self) -> &NetcdfFile {
        &self.file
    }
}
