//! The run as pictures show it, on the page and in the viewer: scores and biases of all cycles, and the fields of those
//! cycles of which there are maps.

use super::reliability::Reliability;
use super::scans::ScanBiases;
use super::structure::ShownStructure;
use crate::event::{Analysed, Estimated, Event, Judged, RunInfo, Smoothed};
use crate::plot::Thinning;
use crate::plot::range::{around, quantile};
use crate::scores::{Part, Score};
use crate::verdict::Verdict;
use indexmap::IndexMap;
use isobar_assim::{Estimate, EstimatedParameter};
use isobar_model::{State, Time};
use isobar_obs::{ObservationType, ObservationWindow, Report, SensorComparison};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Each variable of a state `[y, x]`, thinned.
pub type Fields = Vec<Vec<f32>>;

/// The run so far.
#[derive(Debug)]
pub struct History {
    /// The run.
    pub info: RunInfo,
    /// Number of the variable of which most maps are drawn: h, or the first.
    pub mapped: usize,
    /// How maps are thinned.
    pub thinning: Thinning,
    /// Whether there are maps of the cycle of this number.
    has_maps: fn(&RunInfo, usize) -> bool,
    /// The cycles in their order, before them that with whose state the run begins if there is a truth.
    pub cycles: Vec<Cycle>,
    /// The scores that are drawn over time; the cycles have their values in this order.
    drawn: Vec<Score<'static>>,
    /// The analysis errors of each method and variable against the claimed spread, over the cycles that count.
    reliability: Vec<Vec<Reliability>>,
    /// What methods estimate beside state and calibration, by name; in the place of each method what it has of it.
    pub parameters: IndexMap<String, Vec<Option<ParameterHistory>>>,
    /// The verdicts on biases that were other than before, with cycle, time and number of the method.
    pub verdicts: Vec<(usize, Time, usize, Verdict)>,
    /// The stations with a bias of each variable: the number of the station and that of the parameter, which is the station's or
    /// its group's.
    pub station_biases: Vec<Vec<(usize, usize)>>,
    /// The biases of scanning instruments, each in the newest cycle with observations of it.
    pub scans: BTreeMap<ObservationType, ScanBiases>,
    /// The whole true state of the current cycle, if there is a truth.
    truth: Option<Vec<f64>>,
}

/// A cycle.
#[derive(Debug, Serialize, Deserialize)]
pub struct Cycle {
    /// Its number.
    pub number: usize,
    /// Valid time.
    pub time: Time,
    /// Whether there are maps of it, for which observations and fields are held.
    pub has_maps: bool,
    /// The true calibration parameters, where they are known; empty without a truth.
    pub true_calibration: Vec<Option<f64>>,
    /// The true fields.
    pub truth: Option<Fields>,
    /// The observations, if there are maps of the cycle or if it is the newest.
    pub reports: Vec<Report>,
    /// Their values.
    pub values: Vec<f64>,
    /// The comparisons of sensors.
    pub comparisons: Vec<SensorComparison>,
    /// The results of the methods; the place of one that has none is empty.
    pub methods: Vec<Option<MethodCycle>>,
}

/// A method's results in a cycle.
#[derive(Debug, Serialize, Deserialize)]
pub struct MethodCycle {
    /// The scores that are drawn, those of the smoothed estimate among them once later observations have revised it.
    scores: Vec<Option<f64>>,
    /// The cycle whose observations were the last to revise the estimate.
    revised_in: usize,
    /// The calibration parameters after the analysis.
    pub calibration: Vec<f64>,
    /// Their claimed standard deviations.
    pub calibration_spread: Option<Vec<f64>>,
    /// Mean background and analysis departure of each network and variable.
    pub departures: BTreeMap<ObservationType, [f64; 2]>,
    /// What maps show, in a cycle that has some.
    pub maps: Option<MethodMaps>,
}

/// A method's results in a cycle as maps show them.
#[derive(Debug, Serialize, Deserialize)]
pub struct MethodMaps {
    /// Before the observations.
    pub background: Fields,
    /// After them.
    pub analysis: Fields,
    /// Claimed standard deviation after them.
    pub spread: Option<Fields>,
    /// The analysis as later observations have revised it, once they have.
    pub smoothed: Option<Fields>,
    /// The background departure of each observation.
    pub departures: Vec<f32>,
    /// Blocks and common factors, for a method that has them.
    pub structure: Option<ShownStructure>,
    /// What goes together with the error in the middle, for a method with a covariance.
    pub correlations: Option<ShownCorrelations>,
}

/// Correlations with the error of one value.
#[derive(Debug, Serialize, Deserialize)]
pub struct ShownCorrelations {
    /// The number of the value.
    pub of: usize,
    /// With each variable.
    pub fields: Fields,
    /// With the calibration parameters.
    pub calibration: Vec<f32>,
}

/// A parameter beside state and calibration, as a method has estimated it.
#[derive(Debug, Serialize, Deserialize)]
pub struct ParameterHistory {
    /// The last estimate.
    pub last: EstimatedParameter,
    /// Time, estimate and claimed standard deviation, where the data determine it.
    pub determined: Vec<(Time, f64, f64)>,
}

impl Cycle {
    /// The true value of a calibration parameter, if it is known.
    pub fn true_bias(&self, number: usize) -> Option<f64> {
        self.true_calibration.get(number).copied().flatten()
    }
}

impl MethodCycle {
    /// The estimate of a calibration parameter.
    pub fn bias(&self, number: usize) -> Option<f64> {
        self.calibration.get(number).copied()
    }

    /// The claimed standard deviation of a calibration parameter, if the method claims one.
    pub fn bias_spread(&self, number: usize) -> Option<f64> {
        self.calibration_spread.as_ref()?.get(number).copied()
    }
}

impl History {
    /// The history of a run that has not begun, which holds fields of the cycles for which `has_maps` is true.
    pub fn new(info: &RunInfo, thinning: Thinning, has_maps: fn(&RunInfo, usize) -> bool) -> Self {
        Self {
            mapped: info.layout.variable("h").unwrap_or(0),
            thinning,
            has_maps,
            cycles: Vec::new(),
            drawn: Score::all(&info.variables(), |kind| kind.line.is_some()),
            reliability: vec![vec![Reliability::default(); info.layout.variables.len()]; info.methods.len()],
            parameters: IndexMap::new(),
            verdicts: Vec::new(),
            station_biases: info.station_biases(),
            scans: BTreeMap::new(),
            truth: None,
            info: info.clone(),
        }
    }

    /// Takes in what has happened.
    ///
    /// # Errors
    /// If results do not fit the run.
    pub fn record(&mut self, event: &Event<'_>) -> Result<(), String> {
        match event {
            Event::Truth { cycle, time, state, calibration } => self.add_truth(*cycle, *time, state, calibration),
            Event::Observed { window, values_bias_removed } => {
                self.scans.extend(ScanBiases::all(window, values_bias_removed, self.info.methods.len()));
                self.add_observations(window);
            }
            Event::Analysed(analysed) => self.add_estimates(analysed)?,
            Event::Smoothed(smoothed) => self.add_smoothed(smoothed),
            Event::Estimated(estimated) => self.add_parameters(estimated),
            Event::Judged(Judged { method, cycle, time, verdicts }) => {
                self.verdicts.extend(verdicts.iter().map(|verdict| (*cycle, *time, *method, verdict.clone())));
            }
            Event::Started(_)
            | Event::Resumed(_)
            | Event::Outlook { .. }
            | Event::Forecast(_)
            | Event::Failed { .. }
            | Event::CycleEnded(_)
            | Event::Warning(_)
            | Event::Finished(_) => {}
        }
        Ok(())
    }

    fn add_truth(&mut self, number: usize, time: Time, state: &State, calibration: &[Option<f64>]) {
        self.truth = Some(state.values().to_vec());
        let thinning = self.thinning;
        let cycle = self.begin(number, time);
        cycle.true_calibration = calibration.to_vec();
        cycle.truth = cycle.has_maps.then(|| fields(thinning, state.values()));
    }

    /// Whether the true value of any calibration parameter is known.
    pub fn knows_biases(&self) -> bool {
        self.cycles.iter().flat_map(|cycle| &cycle.true_calibration).any(Option::is_some)
    }

    /// A cycle, begun if it has not been.
    fn begin(&mut self, number: usize, time: Time) -> &mut Cycle {
        if self.cycles.last().is_none_or(|last| last.number != number) {
            if let Some(last) = self.cycles.last_mut().filter(|last| !last.has_maps) {
                (last.reports, last.values) = (Vec::new(), Vec::new());
            }
            let has_maps = (self.has_maps)(&self.info, number);
            let (true_calibration, truth, reports, values) = (Vec::new(), None, Vec::new(), Vec::new());
            let methods = self.info.methods.iter().map(|_| None).collect();
            let comparisons = Vec::new();
            self.cycles.push(Cycle {
                number,
                time,
                has_maps,
                true_calibration,
                truth,
                reports,
                values,
                comparisons,
                methods,
            });
        }
        let last = self.cycles.len() - 1;
        &mut self.cycles[last]
    }

    fn add_observations(&mut self, window: &ObservationWindow) {
        let cycle = self.begin(window.cycle, window.time);
        (cycle.reports, cycle.values) = (window.reports.clone(), window.values.clone());
        cycle.comparisons.clone_from(&window.comparisons);
    }

    fn add_estimates(&mut self, analysed: &Analysed<'_>) -> Result<(), String> {
        let &Analysed {
            method, cycle, ref background, ref analysis, ref scores, ref structure, ref correlations, ..
        } = analysed;
        let Estimate { state, calibration, state_spread, calibration_spread } = &analysis.estimate;
        let (info, thinning) = (&self.info, self.thinning);
        let fits = |spread: &Option<Vec<f64>>, length: usize| spread.as_ref().is_none_or(|it| it.len() == length);
        if method >= info.methods.len() || !fits(state_spread, info.layout.len()) {
            return Err(format!("in cycle {cycle} the results of method {method} do not fit the run"));
        }
        if !fits(calibration_spread, calibration.len()) {
            return Err(format!("in cycle {cycle} the bias spread of method {method} does not fit its biases"));
        }
        let Some(own) = self.cycles.last_mut().filter(|own| own.number == cycle) else {
            return Err(format!("method {method} has results of cycle {cycle} before its observations"));
        };
        let maps = own.has_maps.then(|| MethodMaps {
            background: fields(thinning, background.state.values()),
            analysis: fields(thinning, state.values()),
            spread: state_spread.as_ref().map(|spread| fields(thinning, spread)),
            smoothed: None,
            departures: analysis.background_departures.iter().map(|&it| it as f32).collect(),
            structure: structure.as_deref().map(|it| ShownStructure::new(it, info, &thinning)),
            correlations: correlations.as_deref().map(|it| ShownCorrelations {
                of: it.of,
                fields: it.state.chunks_exact(thinning.cells()).map(|field| thinning.pick(field)).collect(),
                calibration: it.calibration.clone(),
            }),
        });
        for biases in self.scans.values_mut().filter(|biases| biases.cycle == cycle) {
            biases.add(analysed, &own.values);
        }
        let departures = [&analysis.background_departures, &analysis.analysis_departures];
        own.methods[method] = Some(MethodCycle {
            scores: self.drawn.iter().map(|score| scores.get(&score.key()).copied()).collect(),
            revised_in: cycle,
            calibration: calibration.clone(),
            calibration_spread: calibration_spread.clone(),
            departures: mean_departures(&own.reports, departures),
            maps,
        });
        if let Some(spread) = state_spread.as_ref().filter(|_| cycle >= self.info.score_from_cycle) {
            self.gather(method, state, spread);
        }
        Ok(())
    }

    /// Takes a smoothed estimate, and its scores.
    fn add_smoothed(&mut self, smoothed: &Smoothed<'_>) {
        let Some(newest) = self.cycles.last().map(|last| last.number) else { return };
        let cycle = self.cycles.iter_mut().rev().find(|own| own.number == smoothed.cycle);
        if let Some(own) = cycle.and_then(|own| own.methods[smoothed.method].as_mut()) {
            own.revised_in = newest;
            for (value, score) in own.scores.iter_mut().zip(&self.drawn) {
                *value = smoothed.scores.get(&score.key()).copied().or(*value);
            }
            if let Some(maps) = &mut own.maps {
                maps.smoothed = Some(fields(self.thinning, smoothed.estimate.state.values()));
            }
        }
    }

    /// Takes what a method has estimated beside state and calibration.
    fn add_parameters(&mut self, estimated: &Estimated<'_>) {
        for parameter in estimated.parameters.iter() {
            let none = || self.info.methods.iter().map(|_| None).collect();
            let methods = self.parameters.entry(parameter.name.clone()).or_insert_with(none);
            let own = methods[estimated.method]
                .get_or_insert_with(|| ParameterHistory { last: parameter.clone(), determined: Vec::new() });
            own.last.clone_from(parameter);
            own.determined.extend(parameter.sigma.map(|sigma| (estimated.time, parameter.value, sigma)));
        }
    }

    /// Takes the errors of an analysis against its spread, by variable.
    fn gather(&mut self, method: usize, state: &State, spread: &[f64]) {
        let Some(truth) = &self.truth else { return };
        let cells = self.thinning.cells();
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

    /// The cycles in which a method has results.
    pub fn of_method(&self, method: usize) -> impl Iterator<Item = (&Cycle, &MethodCycle)> {
        self.cycles.iter().filter_map(move |cycle| Some((cycle, cycle.methods.get(method)?.as_ref()?)))
    }

    /// The cycles in which a method has maps.
    pub fn maps(&self, method: usize) -> impl Iterator<Item = (&Cycle, &MethodMaps)> {
        self.of_method(method).filter_map(|(cycle, own)| Some((cycle, own.maps.as_ref()?)))
    }

    /// A method's score, one that is drawn, in every cycle that has it, of those that became known in the cycle `since` or later:
    /// those of smoothed estimates do with the last observations that revise them.
    pub fn scores(&self, method: usize, key: &str, since: usize) -> impl Iterator<Item = (&Cycle, f64)> + use<'_> {
        let number = self.drawn.iter().position(|score| score.key() == key);
        let is_smoothed = number.is_some_and(|number| self.drawn[number].kind.part == Part::Smoothed);
        let known = move |cycle: &Cycle, own: &MethodCycle| if is_smoothed { own.revised_in } else { cycle.number };
        let new = self.of_method(method).filter(move |(cycle, own)| known(cycle, own) >= since);
        new.filter_map(move |(cycle, own)| Some((cycle, own.scores.get(number?).copied().flatten()?)))
    }

    /// The fields whose range all maps of states have: those of the truth, without one those of the analyses.
    pub fn states(&self) -> impl Iterator<Item = &Fields> {
        let analyses =
            (0..self.info.methods.len()).flat_map(|method| self.maps(method)).map(|(_, maps)| &maps.analysis);
        let truths = self.cycles.iter().filter_map(|cycle| cycle.truth.as_ref());
        truths.chain(analyses.filter(|_| !self.info.has_truth))
    }

    /// The range of colours of all states of a variable.
    pub fn state_range(&self, variable: usize) -> [f32; 2] {
        let values = self.states().flat_map(|fields| &fields[variable]).filter(|value| value.is_finite());
        let (low, high) =
            values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &it| (low.min(it), high.max(it)));
        if low <= high { around(low, high) } else { [0.0, 1.0] }
    }

    /// The quantile of values on maps, the median over the methods: one that goes astray must not make the maps of all others
    /// pale.
    pub fn usual(&self, part: f32, values: impl Fn(&Cycle, &MethodMaps) -> Vec<f32>) -> Option<f32> {
        let of_method =
            |method| quantile(self.maps(method).flat_map(|(cycle, maps)| values(cycle, maps)).collect(), part);
        quantile((0..self.info.methods.len()).filter_map(of_method).collect(), 0.5)
    }
}

/// The variables of the values of a state, thinned.
fn fields(thinning: Thinning, values: &[f64]) -> Fields {
    values.chunks_exact(thinning.cells()).map(|field| thinning.apply(field)).collect()
}

fn mean_departures(reports: &[Report], departures: [&Vec<f64>; 2]) -> BTreeMap<ObservationType, [f64; 2]> {
    let mut sums: BTreeMap<ObservationType, (f64, [f64; 2])> = BTreeMap::new();
    for ((report, background), analysis) in reports.iter().zip(departures[0]).zip(departures[1]) {
        let sum = sums.entry(report.observation_type()).or_default();
        *sum = (sum.0 + 1.0, [sum.1[0] + background, sum.1[1] + analysis]);
    }
    sums.into_iter().map(|(kind, (count, sums))| (kind, sums.map(|sum| sum / count))).collect()
}
