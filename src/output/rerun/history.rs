//! What happened in a run, as far as pictures of it need.

use crate::event::{Analysed, RunInfo};
use crate::output::structure::ShownStructure;
use crate::plot::Thinning;
use crate::scores::Values;
use isobar_assim::Estimate;
use isobar_model::{Layout, State, Time};
use isobar_obs::ObservationWindow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The most cells on a side of a map, the first of these with which all maps of the run take less than [`MAPS_BYTES`].
const MAP_CELLS: [usize; 5] = [256, 192, 128, 96, 64];

/// What all maps of a run may take before compression \[bytes\].
const MAPS_BYTES: usize = 300_000_000;

/// Bytes of a cell in the maps of a truth, and of a method: three fields of numbers and three of colours.
const BYTES: [usize; 2] = [4, 21];

/// The whole run.
#[derive(Debug)]
pub struct History {
    /// Number of the variable that is shown first: h, or the first.
    pub mapped: usize,
    /// The truth, by cycle.
    pub truth: BTreeMap<usize, Truth>,
    /// The observing platforms, by cycle.
    pub observed: BTreeMap<usize, Vec<Platform>>,
    /// The results of each method, by cycle.
    pub methods: Vec<BTreeMap<usize, Estimates>>,
    /// How maps are thinned.
    pub thinning: Thinning,
    wind: Option<[usize; 2]>,
}

/// The truth of a cycle.
#[derive(Debug)]
pub struct Truth {
    /// Valid time.
    pub time: Time,
    /// Each variable.
    pub fields: Vec<Vec<f32>>,
    /// The calibration parameters.
    pub calibration: Vec<f64>,
}

/// A station or footprint in one cycle, with all that it reported.
#[derive(Debug)]
pub struct Platform {
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
    /// Network and name.
    pub name: String,
    /// Numbers of its reports in the cycle's observations, with variable and value.
    pub reports: Vec<(usize, usize, f64)>,
}

/// The results of one method in one cycle.
#[derive(Debug)]
pub struct Estimates {
    /// Valid time.
    pub time: Time,
    /// Each variable before the analysis.
    pub background: Vec<Vec<f32>>,
    /// Each variable after it.
    pub analysis: Vec<Vec<f32>>,
    /// Claimed standard deviation of each variable after the analysis.
    pub spread: Option<Vec<Vec<f32>>>,
    /// Blocks and common factors, for a method that has them.
    pub structure: Option<ShownStructure>,
    /// Background departure of each observation.
    pub departures: Vec<f32>,
    /// Calibration parameters after the analysis.
    pub calibration: Vec<f64>,
    /// Their claimed standard deviations.
    pub calibration_spread: Option<Vec<f64>>,
    /// The scores of the cycle.
    pub scores: Values,
}

impl History {
    /// The history of a run that has not begun.
    pub fn new(info: &RunInfo) -> Self {
        let variable = |name| info.layout.variable(name);
        Self {
            mapped: variable("h").unwrap_or(0),
            truth: BTreeMap::new(),
            observed: BTreeMap::new(),
            methods: info.methods.iter().map(|_| BTreeMap::new()).collect(),
            thinning: thinning(info),
            wind: variable("u").zip(variable("v")).map(|(u, v)| [u, v]),
        }
    }

    /// The run as its maps show it: on a coarser grid if its own is finer than maps are.
    pub fn thinned(&self, info: &RunInfo) -> RunInfo {
        let Layout { grid, variables } = &*info.layout;
        let layout = Layout { grid: self.thinning.grid(grid), variables: variables.clone() };
        RunInfo { layout: Arc::new(layout), ..info.clone() }
    }

    /// Takes the truth of a cycle.
    pub fn add_truth(&mut self, cycle: usize, time: Time, state: &State, calibration: &[f64]) {
        let fields = self.fields(state.values());
        self.truth.insert(cycle, Truth { time, fields, calibration: calibration.to_vec() });
    }

    /// Takes the observations of a cycle.
    pub fn add_observations(&mut self, info: &RunInfo, window: &ObservationWindow) {
        let mut platforms: Vec<Platform> = Vec::new();
        let mut known = std::collections::HashMap::new();
        for (number, (report, &value)) in window.reports.iter().zip(&window.values).enumerate() {
            if report.variable >= info.layout.variables.len() {
                continue;
            }
            let place = (&report.network, &report.platform, report.x_m.to_bits(), report.y_m.to_bits());
            let at = *known.entry(place).or_insert_with(|| {
                let name = format!("{} {}", report.network, report.platform);
                platforms.push(Platform { x_m: report.x_m, y_m: report.y_m, name, reports: Vec::new() });
                platforms.len() - 1
            });
            platforms[at].reports.push((number, report.variable, value));
        }
        self.observed.insert(window.cycle, platforms);
    }

    /// Takes the results of a method.
    ///
    /// # Errors
    /// If they do not fit the run.
    pub fn add_estimates(&mut self, info: &RunInfo, analysed: &Analysed<'_>) -> Result<(), String> {
        let &Analysed { method, cycle, time, ref background, ref analysis, ref scores, ref structure, .. } = analysed;
        let Estimate { state, calibration, state_spread, calibration_spread } = &analysis.estimate;
        let length = self.thinning.cells() * info.layout.variables.len();
        let spread_length = state_spread.as_ref().map_or(length, Vec::len);
        let calibration_spread_length = calibration_spread.as_ref().map_or(calibration.len(), Vec::len);
        if spread_length != length || state.values().len() != length || calibration_spread_length != calibration.len() {
            return Err(format!("in cycle {cycle} the spread of method {method} does not fit its estimate"));
        }
        let estimates = Estimates {
            time,
            background: self.fields(background.state.values()),
            analysis: self.fields(state.values()),
            spread: state_spread.as_ref().map(|spread| self.fields(spread)),
            structure: structure.as_deref().map(|it| ShownStructure::new(it, info, &self.thinning)),
            departures: single(&analysis.background_departures),
            calibration: calibration.clone(),
            calibration_spread: calibration_spread.clone(),
            scores: scores.clone().into_owned(),
        };
        self.methods[method].insert(cycle, estimates);
        Ok(())
    }

    /// u and v of the fields of all variables, where the model has them.
    pub fn wind<'a>(&self, fields: &'a [Vec<f32>]) -> Option<[&'a [f32]; 2]> {
        self.wind.map(|wind| wind.map(|variable| fields[variable].as_slice()))
    }

    /// The highest wind speed in the fields of all variables; 0 without wind.
    pub fn highest_speed(&self, fields: &[Vec<f32>]) -> f32 {
        let Some([u, v]) = self.wind(fields) else { return 0.0 };
        u.iter().zip(v).map(|(u, v)| u.hypot(*v)).filter(|speed| speed.is_finite()).fold(0.0, f32::max)
    }

    /// Whether a method estimates biases, or claims to know them.
    pub fn has_biases(&self, method: usize) -> bool {
        let claims =
            |it: &Estimates| it.calibration_spread.is_some() || it.calibration.iter().any(|&value| value != 0.0);
        self.methods[method].values().any(claims)
    }

    /// The variables of the values of a state, thinned.
    fn fields(&self, values: &[f64]) -> Vec<Vec<f32>> {
        values.chunks_exact(self.thinning.cells()).map(|field| self.thinning.apply(field)).collect()
    }
}

fn thinning(info: &RunInfo) -> Thinning {
    let of_cell = info.cycles * info.layout.variables.len() * (BYTES[0] + BYTES[1] * info.methods.len());
    let thinnings = MAP_CELLS.map(|most| Thinning::new(&info.layout.grid, most));
    let fits = |thinning: &Thinning| thinning.size().iter().product::<usize>() * of_cell < MAPS_BYTES;
    thinnings.into_iter().find(fits).unwrap_or(thinnings[MAP_CELLS.len() - 1])
}

fn single(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&value| value as f32).collect()
}
