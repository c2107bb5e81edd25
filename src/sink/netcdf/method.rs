//! `<method>.nc`: backgrounds and analyses of one method, with the standard deviations it claims.

use super::coordinates as cf;
use super::file::{Definition, NetcdfFile};
use crate::event::{Analysed, MethodInfo, RunInfo};
use crate::sink::SinkError;
use isobar_assim::Estimate;
use isobar_model::Layout;
use std::path::Path;
use std::sync::Arc;

/// The file of a method.
#[derive(Debug)]
pub struct MethodFile {
    file: NetcdfFile,
    layout: Arc<Layout>,
    parameters: usize,
}

impl MethodFile {
    /// Creates the file, with spreads if `first`, the method's first result, has them.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(
        path: &Path,
        info: &RunInfo,
        method: &MethodInfo,
        first: Option<&Analysed<'_>>,
    ) -> Result<Self, SinkError> {
        let mut definition = Definition::new();
        cf::add_global_attributes(&mut definition, info, &format!("estimates of {}", method.name));
        definition.attribute("method", method.name.as_str());
        definition.attribute("method_description", method.description.as_str());
        cf::add_time(&mut definition);
        cf::add_grid(&mut definition, &info.layout, info.projection.as_ref());
        let parameters = info.calibration.len();
        if parameters > 0 {
            cf::add_parameters(&mut definition, &info.calibration);
        }
        for (stage, estimate) in [
            ("background", first.map(|analysed| analysed.background)),
            ("analysis", first.map(|analysed| &analysed.analysis.estimate)),
        ] {
            let state_spread = estimate.is_some_and(|estimate| estimate.state_spread.is_some());
            let calibration_spread = estimate.is_some_and(|estimate| estimate.calibration_spread.is_some());
            add_fields(&mut definition, info, stage, state_spread);
            if parameters > 0 {
                add_calibration(&mut definition, info, stage, calibration_spread);
            }
        }
        Ok(Self { file: NetcdfFile::create(path, definition)?, layout: Arc::clone(&info.layout), parameters })
    }

    /// Appends a cycle's estimates.
    ///
    /// # Errors
    /// If they do not fit the run or the file, as with a spread that the first cycle had not, or cannot be written.
    pub fn append(&mut self, analysed: &Analysed<'_>) -> Result<(), SinkError> {
        let time = [analysed.time.seconds() as f64];
        let mut values: Vec<(String, &[f64])> = vec![("time".into(), &time)];
        self.collect(&mut values, "background", analysed.background);
        self.collect(&mut values, "analysis", &analysed.analysis.estimate);
        let values: Vec<(&str, &[f64])> = values.iter().map(|(name, values)| (name.as_str(), *values)).collect();
        self.file.append(&values)
    }

    /// Appends missing values for every cycle after those that the file has, up to the run's last.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn fill_up(&mut self, info: &RunInfo) -> Result<(), SinkError> {
        for cycle in self.file.records() + 1..=info.cycles {
            self.file.append_missing((info.start.seconds() + info.window.seconds() * cycle as i64) as f64)?;
        }
        Ok(())
    }

    /// The file.
    pub fn file(&self) -> &NetcdfFile {
        &self.file
    }

    fn collect<'a>(&self, values: &mut Vec<(String, &'a [f64])>, stage: &str, estimate: &'a Estimate) {
        let mut fields = |state: &'a [f64], suffix: &str| {
            let names = self.layout.variables.iter().map(|variable| format!("{}_{stage}{suffix}", variable.name));
            values.extend(names.zip(state.chunks(self.layout.grid.cells())));
        };
        fields(estimate.state.values(), "");
        if let Some(spread) = &estimate.state_spread {
            fields(spread, "_spread");
        }
        if self.parameters > 0 {
            values.push((format!("calibration_{stage}"), &estimate.calibration));
            if let Some(spread) = &estimate.calibration_spread {
                values.push((format!("calibration_{stage}_spread"), spread));
            }
        }
    }
}

fn add_fields(definition: &mut Definition, info: &RunInfo, stage: &str, with_spread: bool) {
    for variable in &info.layout.variables {
        let field = |suffix: &str, meaning: String| {
            let name = format!("{}_{stage}{suffix}", variable.name);
            cf::field(&name, &meaning, variable.unit, variable.location, info.projection.is_some())
        };
        let estimate = field("", format!("{stage} {}", variable.long_name));
        definition.record(estimate.with_some("standard_name", variable.standard_name));
        if with_spread {
            let spread = field("_spread", format!("claimed standard deviation of {stage} {}", variable.long_name));
            let standard_name = variable.standard_name.map(|name| format!("{name} standard_error"));
            definition.record(spread.with_some("standard_name", standard_name));
        }
    }
}

fn add_calibration(definition: &mut Definition, info: &RunInfo, stage: &str, with_spread: bool) {
    let (name, meaning) = (format!("calibration_{stage}"), format!("{stage} calibration parameters"));
    definition.record(cf::parameters(&name, &meaning, &info.calibration));
    if with_spread {
        let meaning = format!("claimed standard deviation of the {meaning}");
        definition.record(cf::parameters(&format!("{name}_spread"), &meaning, &info.calibration));
    }
}
