//! What the report needs to know of a run: scores and biases of all cycles, fields of few.

use super::reliability::Reliability;
use crate::event::{Analysed, Estimated, RunInfo, Smoothed};
use crate::output::structure::ShownStructure;
use crate::plot::Thinning;
use crate::scores::{SCORES, ScoreKind};
use indexmap::IndexMap;
use isobar_assim::{Estimate, EstimatedParameter};
use isobar_model::{State, Time};
use isobar_obs::{ObservationType, ObservationWindow, Report};
use std::collections::BTreeMap;

/// The most cells on a side of a map.
const MAP_CELLS: usize = 200;

/// The most observations whose places are marked on a map.
const MOST_PLACES: usize = 3000;

/// The run, as far as the report shows it.
#[derive(Debug)]
pub struct History {
    /// Number of the variable of which most maps are drawn: h, or the first.
    pub mapped: usize,
    /// How maps are thinned.
    pub thinning: Thinning,
    /// The cycles, in their order.
    pub cycles: Vec<Cycle>,
    /// The names of the scores that are drawn over time; the cycles have their values in this order.
    drawn: Vec<String>,
    /// The analysis errors of each method and variable against the claimed spread, over the cycles that count.
    reliability: Vec<Vec<Reliability>>,
    /// Fields of the cycles that are shown as maps, by cycle.
    pub snapshots: BTreeMap<usize, Snapshot>,
    /// What methods estimate beside state and calibration, by name; in the place of each method what it has of it.
    pub parameters: IndexMap<String, Vec<Option<ParameterHistory>>>,
    /// The whole true state of the current cycle, if there is a truth.
    truth: Option<Vec<f64>>,
}

/// A cycle.
#[derive(Debug)]
pub struct Cycle {
    /// Its number.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The true calibration parameters; empty without a truth.
    pub true_calibration: Vec<f64>,
    /// Network and variable of each observation; of the newest cycle only.
    kinds: Vec<ObservationType>,
    /// The results of the methods; the place of one that has none is empty.
    pub methods: Vec<Option<MethodCycle>>,
}

/// A method's results in a cycle.
#[derive(Debug)]
pub struct MethodCycle {
    /// The scores that are drawn, those of the smoothed estimate among them once later observations have revised it.
    scores: Vec<Option<f64>>,
    /// The calibration parameters after the analysis.
    pub calibration: Vec<f64>,
    /// Their claimed standard deviations.
    pub calibration_spread: Option<Vec<f64>>,
    /// Mean background and analysis departure of each network and variable.
    pub departures: BTreeMap<ObservationType, [f64; 2]>,
}

/// A parameter beside state and calibration, as a method has estimated it.
#[derive(Debug)]
pub struct ParameterHistory {
    /// The last estimate.
    pub last: EstimatedParameter,
    /// Time, estimate and claimed standard deviation, where the data determine it.
    pub determined: Vec<(Time, f64, f64)>,
}

/// The fields of one cycle.
#[derive(Debug)]
pub struct Snapshot {
    /// Valid time.
    pub time: Time,
    /// The truth, by variable, if there is one.
    pub truth: Option<Vec<Vec<f32>>>,
    /// The observations, thinned.
    pub places: Vec<Place>,
    /// Every so many-th observation of each variable is among them.
    pub every: Vec<usize>,
    /// The methods' fields.
    pub methods: Vec<Option<Fields>>,
}

/// Where a variable was observed.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Number of the observation.
    pub number: usize,
    /// Number of the variable.
    pub variable: usize,
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
}

/// A method's fields, by variable.
#[derive(Debug)]
pub struct Fields {
    /// Before the observations.
    pub background: Vec<Vec<f32>>,
    /// After them.
    pub analysis: Vec<Vec<f32>>,
    /// Claimed standard deviation after them.
    pub spread: Option<Vec<Vec<f32>>>,
    /// The background departures at [`Snapshot::places`].
    pub departures: Vec<f32>,
    /// Blocks and common factors, for a method that has them.
    pub structure: Option<ShownStructure>,
    /// What goes together with the error in the middle, for a method with a covariance.
    pub correlations: Option<ShownCorrelations>,
}

/// Correlations with the error of one value.
#[derive(Debug)]
pub struct ShownCorrelations {
    /// The number of the value.
    pub of: usize,
    /// By variable, thinned.
    pub fields: Vec<Vec<f32>>,
    /// With the calibration parameters.
    pub calibration: Vec<f32>,
}

impl History {
    /// The history of a run that has not begun.
    pub fn new(info: &RunInfo) -> Self {
        Self {
            mapped: info.layout.variable("h").unwrap_or(0),
            thinning: Thinning::new(&info.layout.grid, MAP_CELLS),
            cycles: Vec::new(),
            drawn: drawn_scores(info),
            reliability: vec![vec![Reliability::default(); info.layout.variables.len()]; info.methods.len()],
            snapshots: BTreeMap::new(),
            parameters: IndexMap::new(),
            truth: None,
        }
    }

    /// Takes the truth of a cycle.
    pub fn add_truth(&mut self, info: &RunInfo, cycle: usize, time: Time, state: &State, calibration: &[f64]) {
        if cycle == 0 {
            return;
        }
        self.truth = Some(state.values().to_vec());
        self.begin(info, cycle, time).true_calibration = calibration.to_vec();
        if self.snapshots.contains_key(&cycle) {
            let maps = self.maps(state.values());
            self.snapshots.entry(cycle).and_modify(|snapshot| snapshot.truth = Some(maps));
        }
    }

    /// A cycle, begun if it has not been.
    fn begin(&mut self, info: &RunInfo, cycle: usize, time: Time) -> &mut Cycle {
        if self.cycles.last().is_none_or(|last| last.cycle != cycle) {
            if let Some(last) = self.cycles.last_mut() {
                last.kinds = Vec::new();
            }
            let (true_calibration, kinds) = (Vec::new(), Vec::new());
            let methods = info.methods.iter().map(|_| None).collect();
            self.cycles.push(Cycle { cycle, time, true_calibration, kinds, methods });
            if cycle == info.cycles || cycle == info.cycles.div_ceil(2) {
                let every = vec![1; info.layout.variables.len()];
                let methods = info.methods.iter().map(|_| None).collect();
                self.snapshots.insert(cycle, Snapshot { time, truth: None, places: Vec::new(), every, methods });
            }
        }
        let last = self.cycles.len() - 1;
        &mut self.cycles[last]
    }

    /// Takes the observations of a cycle.
    pub fn add_observations(&mut self, info: &RunInfo, window: &ObservationWindow) {
        self.begin(info, window.cycle, window.time).kinds =
            window.reports.iter().map(Report::observation_type).collect();
        if let Some(snapshot) = self.snapshots.get_mut(&window.cycle) {
            let mut counts = vec![0; info.layout.variables.len()];
            window.reports.iter().for_each(|report| counts[report.variable] += 1);
            snapshot.every = counts.iter().map(|count: &usize| count.div_ceil(MOST_PLACES).max(1)).collect();
            let mut seen = vec![0_usize; counts.len()];
            for (number, report) in window.reports.iter().enumerate() {
                let variable = report.variable;
                if seen[variable].is_multiple_of(snapshot.every[variable]) {
                    snapshot.places.push(Place { number, variable, x_m: report.x_m, y_m: report.y_m });
                }
                seen[variable] += 1;
            }
        }
    }

    /// Takes the results of a method.
    ///
    /// # Errors
    /// If they do not fit the run.
    pub fn add_estimates(&mut self, info: &RunInfo, analysed: &Analysed<'_>) -> Result<(), String> {
        let &Analysed {
            method, cycle, ref background, ref analysis, ref scores, ref structure, ref correlations, ..
        } = analysed;
        let Estimate { state, calibration, state_spread, calibration_spread } = &analysis.estimate;
        let fits = |spread: &Option<Vec<f64>>, length: usize| spread.as_ref().is_none_or(|it| it.len() == length);
        if method >= info.methods.len() || !fits(state_spread, info.layout.len()) {
            return Err(format!("in cycle {cycle} the results of method {method} do not fit the run"));
        }
        if !fits(calibration_spread, calibration.len()) {
            return Err(format!("in cycle {cycle} the bias spread of method {method} does not fit its biases"));
        }
        if let Some(spread) = state_spread.as_ref().filter(|_| cycle >= info.score_from_cycle) {
            self.gather(info, method, state, spread);
        }
        let fields = self.snapshots.get(&cycle).map(|snapshot| Fields {
            background: self.maps(background.state.values()),
            analysis: self.maps(state.values()),
            spread: state_spread.as_ref().map(|spread| self.maps(spread)),
            departures: snapshot
                .places
                .iter()
                .map(|place| analysis.background_departures.get(place.number).map_or(f32::NAN, |&it| it as f32))
                .collect(),
            structure: structure.as_deref().map(|it| ShownStructure::new(it, info, &self.thinning)),
            correlations: correlations.as_deref().map(|it| ShownCorrelations {
                of: it.of,
                fields: it.state.chunks_exact(self.thinning.cells()).map(|field| self.thinning.pick(field)).collect(),
                calibration: it.calibration.clone(),
            }),
        });
        if let (Some(fields), Some(snapshot)) = (fields, self.snapshots.get_mut(&cycle)) {
            snapshot.methods[method] = Some(fields);
        }
        let Some(own) = self.cycles.last_mut().filter(|own| own.cycle == cycle) else {
            return Err(format!("method {method} has results of cycle {cycle} before its observations"));
        };
        let departures = [&analysis.background_departures, &analysis.analysis_departures];
        own.methods[method] = Some(MethodCycle {
            scores: self.drawn.iter().map(|name| scores.get(name).copied()).collect(),
            calibration: calibration.clone(),
            calibration_spread: calibration_spread.clone(),
            departures: mean_departures(&own.kinds, departures),
        });
        Ok(())
    }

    /// Takes the scores of a smoothed estimate.
    pub fn add_smoothed(&mut self, smoothed: &Smoothed<'_>) {
        let cycle = self.cycles.iter_mut().rev().find(|own| own.cycle == smoothed.cycle);
        if let Some(own) = cycle.and_then(|own| own.methods[smoothed.method].as_mut()) {
            for (value, name) in own.scores.iter_mut().zip(&self.drawn) {
                *value = smoothed.scores.get(name).copied().or(*value);
            }
        }
    }

    /// Takes what a method has estimated beside state and calibration.
    pub fn add_parameters(&mut self, info: &RunInfo, estimated: &Estimated<'_>) {
        for parameter in estimated.parameters.iter() {
            let none = || info.methods.iter().map(|_| None).collect();
            let methods = self.parameters.entry(parameter.name.clone()).or_insert_with(none);
            let own = methods[estimated.method]
                .get_or_insert_with(|| ParameterHistory { last: parameter.clone(), determined: Vec::new() });
            own.last.clone_from(parameter);
            own.determined.extend(parameter.sigma.map(|sigma| (estimated.time, parameter.value, sigma)));
        }
    }

    /// Takes the errors of an analysis against its spread, by variable.
    fn gather(&mut self, info: &RunInfo, method: usize, state: &State, spread: &[f64]) {
        let Some(truth) = &self.truth else { return };
        let cells = info.layout.grid.cells();
        for (variable, reliability) in self.reliability[method].iter_mut().enumerate() {
            let range = variable * cells..(variable + 1) * cells;
            if let Some(truth) = truth.get(range.clone()) {
                let errors = state.values()[range.clone()].iter().zip(truth).map(|(value, truth)| value - truth);
                reliability.add(errors.zip(spread[range].iter().copied()));
            }
        }
    }

    /// The analysis errors of a method's variable against the claimed spread, over the cycles that count.
    pub fn reliability(&self, method: usize, variable: usize) -> &Reliability {
        &self.reliability[method][variable]
    }

    /// A method's score in every cycle that has it; it must be one that is drawn.
    pub fn scores(&self, method: usize, name: &str) -> impl Iterator<Item = (&Cycle, f64)> {
        let number = self.drawn.iter().position(|own| own == name);
        self.cycles.iter().filter_map(move |cycle| {
            let own = cycle.methods.get(method)?.as_ref()?;
            Some((cycle, own.scores[number?]?))
        })
    }

    /// The variables of the values of a state, thinned.
    fn maps(&self, values: &[f64]) -> Vec<Vec<f32>> {
        values.chunks_exact(self.thinning.cells()).map(|field| self.thinning.apply(field)).collect()
    }
}

/// The names of the scores that have a line.
fn drawn_scores(info: &RunInfo) -> Vec<String> {
    let of_kind = |kind: &ScoreKind| {
        let all = info.layout.variables.iter().map(|variable| kind.key(variable.name));
        all.take(if kind.per_variable { usize::MAX } else { 1 }).collect::<Vec<_>>()
    };
    SCORES.iter().filter(|kind| kind.line.is_some()).flat_map(of_kind).collect()
}

fn mean_departures(kinds: &[ObservationType], departures: [&Vec<f64>; 2]) -> BTreeMap<ObservationType, [f64; 2]> {
    let mut sums: BTreeMap<ObservationType, (f64, [f64; 2])> = BTreeMap::new();
    for ((kind, background), analysis) in kinds.iter().zip(departures[0]).zip(departures[1]) {
        let sum = sums.entry(kind.clone()).or_default();
        *sum = (sum.0 + 1.0, [sum.1[0] + background, sum.1[1] + analysis]);
    }
    sums.into_iter().map(|(kind, (count, sums))| (kind, sums.map(|sum| sum / count))).collect()
}
