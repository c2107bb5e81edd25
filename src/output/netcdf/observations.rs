//! `observations.nc`: all observations as points (CF discrete sampling geometry), with every method's departures.

use super::coordinates as cf;
use super::file::{Definition, FILL_VALUE, NetcdfFile, Values, Variable};
use crate::event::{Analysed, RunInfo};
use crate::output::SinkError;
use isobar_obs::{ObservationWindow, Report, Unused};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;

/// The observations of a run, held until all are known.
#[derive(Debug)]
pub struct ObservationsFile {
    path: PathBuf,
    reports: Vec<Report>,
    times: Vec<f64>,
    values: Vec<f64>,
    values_bias_removed: Vec<f64>,
    sigma: Vec<f64>,
    /// What quality control predicted, z, and the number of neighbours.
    checks: [Vec<f64>; 3],
    /// Why each is not used; 0 for those that are.
    codes: Vec<i32>,
    /// The cycle of each.
    cycle_numbers: Vec<i32>,
    /// The observations of each cycle: those that are used, and those that are not.
    cycles: BTreeMap<usize, [Range<usize>; 2]>,
    /// Background and analysis departures of each method.
    departures: Vec<[Vec<f64>; 2]>,
    /// The values without the biases that each method has found, and how well it knows these; empty if it estimates none.
    readings: Vec<[Vec<f64>; 2]>,
}

impl ObservationsFile {
    /// A file without observations yet, and not yet written.
    pub fn new(path: PathBuf, info: &RunInfo) -> Self {
        Self {
            path,
            reports: Vec::new(),
            times: Vec::new(),
            values: Vec::new(),
            values_bias_removed: Vec::new(),
            sigma: Vec::new(),
            checks: Default::default(),
            codes: Vec::new(),
            cycle_numbers: Vec::new(),
            cycles: BTreeMap::new(),
            departures: vec![Default::default(); info.methods.len()],
            readings: vec![Default::default(); info.methods.len()],
        }
    }

    /// Takes the observations of a cycle, and their values without the true biases.
    ///
    /// # Errors
    /// If its parts differ in length, or the cycle had its observations already.
    pub fn add(
        &mut self,
        info: &RunInfo,
        window: &ObservationWindow,
        values_bias_removed: &[f64],
    ) -> Result<(), SinkError> {
        let (n, cycle, unused) = (window.values.len(), window.cycle, &window.aside.unused);
        let lengths = [window.reports.len(), window.times.len(), window.sigma.len()];
        if lengths != [n; 3] || values_bias_removed.len() != n + unused.len() {
            return Err(self.failure(format!("the observations of cycle {cycle} differ in number from their reports")));
        }
        let start = self.values.len();
        let all = start + n + unused.len();
        if self.cycles.insert(cycle, [start..start + n, start + n..all]).is_some() {
            return Err(self.failure(format!("the observations of cycle {cycle} came twice")));
        }
        self.reports.extend(window.reports.iter().chain(unused.iter().map(|it| &it.report)).cloned());
        let times = window.times.iter().chain(unused.iter().map(|it| &it.time));
        self.times.extend(times.map(|time| time.seconds() as f64));
        self.cycle_numbers.resize(all, i32::try_from(cycle).unwrap_or(i32::MAX));
        self.values.extend(window.values.iter().copied().chain(unused.iter().map(|it| filled(it.value))));
        self.sigma.extend(window.sigma.iter().copied().chain(unused.iter().map(|it| filled(it.sigma))));
        self.codes.resize(start + n, 0);
        self.codes.extend(unused.iter().map(|it| i32::from(it.why.code())));
        let rejected = std::iter::repeat_n(false, n).chain(unused.iter().map(|it| it.why.rejection().is_some()));
        for ((report, is_rejected), &value) in self.reports[start..].iter().zip(rejected).zip(values_bias_removed) {
            // Nothing is known of the errors of what was recorded elsewhere, or fails quality control.
            let is_known = !is_rejected && !info.is_recorded(&report.network);
            self.values_bias_removed.push(if is_known { filled(value) } else { FILL_VALUE });
        }
        let of_used = (0..n).map(|number| window.aside.checks.get(number).copied().flatten());
        for check in of_used.chain(unused.iter().map(|it| it.check)) {
            let numbers = check.map(|it| [it.predicted, it.z, it.neighbours as f64]);
            let numbers = numbers.unwrap_or([FILL_VALUE; 3]);
            self.checks.iter_mut().zip(numbers).for_each(|(own, number)| own.push(filled(number)));
        }
        for method in self.departures.iter_mut().flatten() {
            method.resize(all, FILL_VALUE);
        }
        for method in self.readings.iter_mut().flatten().filter(|method| !method.is_empty()) {
            method.resize(all, FILL_VALUE);
        }
        Ok(())
    }

    /// Takes a method's departures of a cycle, and its readings.
    ///
    /// # Errors
    /// If the cycle has other observations.
    pub fn add_results(&mut self, analysed: &Analysed<'_>) -> Result<(), SinkError> {
        let &Analysed { cycle, method, ref analysis, ref unused, ref readings, .. } = analysed;
        let [of_used, of_unused] = self.cycles.get(&cycle).cloned().unwrap_or([0..0, 0..0]);
        let given =
            [(&analysis.background_departures, &unused.background), (&analysis.analysis_departures, &unused.analysis)];
        for (departures, (used, unused)) in self.departures[method].iter_mut().zip(given) {
            if used.len() != of_used.len() || unused.len() != of_unused.len() {
                let (given, n) = (used.len() + unused.len(), of_used.len() + of_unused.len());
                let reason =
                    format!("method {method} has {given} departures from the {n} observations of cycle {cycle}");
                return Err(SinkError { path: self.path.clone(), reason });
            }
            departures[of_used.clone()].copy_from_slice(used);
            for (own, given) in departures[of_unused.clone()].iter_mut().zip(unused) {
                *own = given.unwrap_or(FILL_VALUE);
            }
        }
        if let Some(readings) = readings {
            let (range, all) = (of_used.start..of_unused.end, self.values.len());
            for (own, given) in self.readings[method].iter_mut().zip([&readings.values, &readings.sigma]) {
                if given.len() != range.len() {
                    let (given, n) = (given.len(), range.len());
                    let reason =
                        format!("method {method} has {given} readings of the {n} observations of cycle {cycle}");
                    return Err(SinkError { path: self.path.clone(), reason });
                }
                own.resize(all, FILL_VALUE);
                own[range.clone()].iter_mut().zip(given).for_each(|(own, &value)| *own = filled(value));
            }
        }
        Ok(())
    }

    /// Writes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, info: &RunInfo) -> Result<(), SinkError> {
        let mut definition = Definition::new();
        cf::add_global_attributes(&mut definition, info, "observations");
        definition.attribute("featureType", "point");
        if self.values.is_empty() {
            // A fixed dimension cannot have length zero.
            definition.record_dimension("obs");
        } else {
            definition.dimension("obs", self.values.len());
            self.add_coordinates(&mut definition, info);
            self.add_numbers(&mut definition, info);
        }
        NetcdfFile::create(&self.path, definition).map(|_| ())
    }

    /// Where and when, what and by whom.
    fn add_coordinates(&self, definition: &mut Definition, info: &RunInfo) {
        let xs = self.reports.iter().map(|report| report.x_m).collect();
        let ys = self.reports.iter().map(|report| report.y_m).collect();
        definition.fixed(cf::time(Variable::new("time", &["obs"])), Values::Numbers(self.times.clone()));
        definition.fixed(cf::x(Variable::new("x", &["obs"]), "x of the observation"), Values::Numbers(xs));
        definition.fixed(cf::y(Variable::new("y", &["obs"]), "y of the observation"), Values::Numbers(ys));
        if let Some(projection) = &info.projection {
            let places = self.reports.iter().map(|report| projection.inverse(report.x_m, report.y_m)).collect();
            cf::add_grid_mapping(definition, projection);
            cf::add_places(definition, ["latitude", "longitude"], &["obs"], places);
        }
        let variable = Variable::new("cycle", &["obs"]).with("long_name", "number of the cycle").with("units", "1");
        definition.fixed(variable, Values::Integers(self.cycle_numbers.clone()));
        self.add_codes(definition);
        let reports = self.reports.iter();
        let text = |name: &str, long_name: &str| Variable::new(name, &[]).with("long_name", long_name);
        let networks = reports.clone().map(|report| &*report.network);
        definition.texts(text("network", "observing network or satellite"), "obs", networks);
        let platforms = reports.clone().map(|report| &*report.platform);
        definition.texts(text("platform", "station, or place in the swath"), "obs", platforms);
        definition.texts(text("variable", "observed variable"), "obs", reports.clone().map(|it| name(info, it)));
        definition.texts(text("unit", "unit of the observed variable"), "obs", reports.map(|it| unit(info, it)));
    }

    /// Which are used, and why the others are not.
    fn add_codes(&self, definition: &mut Definition) {
        let names: Vec<&str> = Unused::all().map(Unused::name).collect();
        let codes: Vec<i32> = std::iter::once(0).chain(Unused::all().map(|it| i32::from(it.code()))).collect();
        let variable = Variable::new("quality_code", &["obs"])
            .with("long_name", "0 for an observation that is used, else why it is not")
            .with("flag_values", codes)
            .with("flag_meanings", format!("used {}", names.join(" ")));
        definition.fixed(variable, Values::Integers(self.codes.clone()));
    }

    /// Values and departures.
    fn add_numbers(&self, definition: &mut Definition, info: &RunInfo) {
        let unit = cf::common(self.reports.iter().map(|report| unit(info, report)));
        let projected = info.projection.is_some();
        let places = if projected { "time y x latitude longitude" } else { "time y x" };
        let number = |name: &str, long_name: &str| {
            Variable::new(name, &["obs"])
                .with("long_name", long_name)
                .with("coordinates", format!("{places} network platform variable"))
                .with_some("grid_mapping", projected.then_some(cf::GRID_MAPPING))
                .with("_FillValue", FILL_VALUE)
        };
        let elsewhere = "each number has the unit that the variable `unit` says";
        let quantity = |name: &str, long_name: &str| {
            number(name, long_name).with_some("units", unit).with_some("comment", unit.is_none().then_some(elsewhere))
        };
        let scans = self.reports.iter().map(|report| report.scan.unwrap_or(FILL_VALUE)).collect();
        definition.fixed(number("scan", "scan position, from -1 to 1").with("units", "1"), Values::Numbers(scans));
        let bias = |(value, removed): (&f64, &f64)| if *removed == FILL_VALUE { FILL_VALUE } else { value - removed };
        let biases = self.values.iter().zip(&self.values_bias_removed).map(bias);
        for (name, long_name, values) in [
            ("value", "observed value, true bias included", self.values.clone()),
            ("value_bias_removed", "observed value without its true bias", self.values_bias_removed.clone()),
            ("true_bias", "true bias of the observed value", biases.collect()),
            ("sigma", "standard deviation of the random error", self.sigma.clone()),
            ("quality_prediction", "value that quality control predicts from neighbours", self.checks[0].clone()),
        ] {
            definition.fixed(quantity(name, long_name), Values::Numbers(values));
        }
        for (name, long_name, values) in [
            ("quality_z", "value minus prediction, in standard deviations of that difference", &self.checks[1]),
            ("quality_neighbours", "number of neighbours that the prediction is from", &self.checks[2]),
        ] {
            definition.fixed(number(name, long_name).with("units", "1"), Values::Numbers(values.clone()));
        }
        for (method, departures) in info.methods.iter().zip(&self.departures) {
            for (stage, values) in ["background", "analysis"].into_iter().zip(departures) {
                let name = format!("{stage}_departure_{}", cf::safe_name(&method.name, "_"));
                let long_name = format!("observed value minus the {stage} of {} at its place", method.name);
                definition.fixed(quantity(&name, &long_name), Values::Numbers(values.clone()));
            }
        }
        let estimating = info.methods.iter().zip(&self.readings).filter(|(_, [values, _])| !values.is_empty());
        for (method, [values, sigma]) in estimating {
            let name = format!("calibrated_value_{}", cf::safe_name(&method.name, "_"));
            let long_name = format!("observed value without the bias that {} has found", method.name);
            let of_sigma = format!("{name}_sigma");
            let variable = quantity(&name, &long_name).with("ancillary_variables", of_sigma.as_str());
            definition.fixed(variable, Values::Numbers(values.clone()));
            let long_name = format!("claimed standard deviation of the bias that {} has found", method.name);
            definition.fixed(quantity(&of_sigma, &long_name), Values::Numbers(sigma.clone()));
        }
    }

    fn failure(&self, reason: String) -> SinkError {
        SinkError { path: self.path.clone(), reason }
    }
}

fn filled(value: f64) -> f64 {
    if value.is_finite() { value } else { FILL_VALUE }
}

/// Name of the reported variable.
fn name<'a>(info: &'a RunInfo, report: &Report) -> &'a str {
    info.layout.variables.get(report.variable).map_or("", |variable| variable.name)
}

/// Unit of the reported variable.
fn unit<'a>(info: &'a RunInfo, report: &Report) -> &'a str {
    info.layout.variables.get(report.variable).map_or("", |variable| variable.unit)
}
