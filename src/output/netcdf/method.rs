//! `<method>.nc`: backgrounds and analyses of one method, with the standard deviations it claims, and what its smoother makes
//! of them. A smoothed estimate has the time of the state that it is of; `smoother_later_cycles` says how many later cycles
//! went into it: those of the smoother's lag or, at the end of the run, all there are.

use super::coordinates as cf;
use super::file::{Definition, FILL_VALUE, NetcdfFile, Variable};
use crate::event::{Analysed, MethodInfo, RunInfo, Smoothed};
use crate::output::SinkError;
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
    /// The last cycle before those of the file.
    done: usize,
    /// The names of what is smoothed, and missing at first, with the lengths of its records.
    smoothed: Vec<(String, usize)>,
}

/// The number of later cycles whose observations a smoothed estimate has taken in.
const LATER_CYCLES: &str = "smoother_later_cycles";

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
        let analysis = first.map(|analysed| &analysed.analysis.estimate);
        let mut stages = vec![("background", first.map(|analysed| &*analysed.background)), ("analysis", analysis)];
        let mut smoothed = Vec::new();
        if let Some(lag) = method.smoother_lag_cycles {
            definition.attribute("smoother_lag_cycles", lag as f64);
            let name = "number of later cycles whose observations the smoothed estimate takes in";
            let variable = Variable::new(LATER_CYCLES, &[]).with("long_name", name).with("units", "1");
            definition.record(variable.with("_FillValue", FILL_VALUE));
            // It has spreads where the analysis has.
            stages.push(("smoothed", analysis));
            smoothed.push((LATER_CYCLES.to_string(), 1));
            if let Some(analysis) = analysis {
                let names = named_values(&info.layout, parameters, "smoothed", analysis);
                smoothed.extend(names.into_iter().map(|(name, values)| (name, values.len())));
            }
        }
        for (stage, estimate) in stages {
            let state_spread = estimate.is_some_and(|estimate| estimate.state_spread.is_some());
            let calibration_spread = estimate.is_some_and(|estimate| estimate.calibration_spread.is_some());
            add_fields(&mut definition, info, stage, state_spread);
            if parameters > 0 {
                add_calibration(&mut definition, info, stage, calibration_spread);
            }
        }
        let (file, layout) = (NetcdfFile::create(path, definition)?, Arc::clone(&info.layout));
        Ok(Self { file, layout, parameters, done: info.done, smoothed })
    }

    /// Appends a cycle's estimates.
    ///
    /// # Errors
    /// If they do not fit the run or the file, as with a spread that the first cycle had not, or cannot be written.
    pub fn append(&mut self, analysed: &Analysed<'_>) -> Result<(), SinkError> {
        let time = [analysed.time.seconds() as f64];
        let mut values: Vec<(String, &[f64])> = vec![("time".into(), &time)];
        values.extend(named_values(&self.layout, self.parameters, "background", &analysed.background));
        values.extend(named_values(&self.layout, self.parameters, "analysis", &analysed.analysis.estimate));
        let missing = vec![FILL_VALUE; self.smoothed.iter().map(|(_, length)| *length).max().unwrap_or(0)];
        values.extend(self.smoothed.iter().map(|(name, length)| (name.clone(), &missing[..*length])));
        let values: Vec<(&str, &[f64])> = values.iter().map(|(name, values)| (name.as_str(), *values)).collect();
        self.file.append(&values)
    }

    /// Writes what has been found out of an earlier cycle into its record.
    ///
    /// # Errors
    /// If it does not fit the run or the file, or cannot be written.
    pub fn smooth(&mut self, smoothed: &Smoothed<'_>) -> Result<(), SinkError> {
        let later = [smoothed.later_cycles as f64];
        let mut values: Vec<(String, &[f64])> = vec![(LATER_CYCLES.into(), &later)];
        values.extend(named_values(&self.layout, self.parameters, "smoothed", &smoothed.estimate));
        let values: Vec<(&str, &[f64])> = values.iter().map(|(name, values)| (name.as_str(), *values)).collect();
        let record = smoothed.cycle.checked_sub(self.done + 1);
        let record = record.ok_or_else(|| self.file.failure(format!("it has no cycle {}", smoothed.cycle)))?;
        self.file.amend(record, &values)
    }

    /// Appends missing values for every cycle after those that the file has, up to the run's last.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn fill_up(&mut self, info: &RunInfo) -> Result<(), SinkError> {
        for cycle in info.done + self.file.records() + 1..=info.cycles {
            self.file.append_missing(info.time(cycle).seconds() as f64)?;
        }
        Ok(())
    }

    /// The file.
    pub fn file(&self) -> &NetcdfFile {
        &self.file
    }
}

/// The values of an estimate, by the names of their variables.
fn named_values<'a>(
    layout: &Layout,
    parameters: usize,
    stage: &str,
    estimate: &'a Estimate,
) -> Vec<(String, &'a [f64])> {
    let mut values = Vec::new();
    let mut fields = |state: &'a [f64], suffix: &str| {
        let names = layout.variables.iter().map(|variable| format!("{}_{stage}{suffix}", variable.name));
        values.extend(names.zip(state.chunks(layout.grid.cells())));
    };
    fields(estimate.state.values(), "");
    if let Some(spread) = &estimate.state_spread {
        fields(spread, "_spread");
    }
    if parameters > 0 {
        values.push((format!("calibration_{stage}"), estimate.calibration.as_slice()));
        if let Some(spread) = &estimate.calibration_spread {
            values.push((format!("calibration_{stage}_spread"), spread.as_slice()));
        }
    }
    values
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
