//! Curves over time: errors and spreads of each variable, and the bias estimates.

use super::names::{CYCLE, Names, Result, VALID_TIME};
use crate::event::RunInfo;
use crate::output::history::{Cycle, History, MethodCycle};
use crate::plot::colors;
use crate::scores::{Line, Part, ScoreKind};
use isobar_obs::{Calibration, Placement};
use re_sdk::RecordingStream;
use re_sdk::log::TimeColumn;
use re_sdk_types::archetypes::{Scalars, SeriesLines};
use std::cmp::Reverse;

/// Plots of calibration parameters on one page.
pub const PARAMETERS_PER_PAGE: usize = 4;

/// The most calibration parameters that are shown of a method, on twelve pages.
pub const MOST_PARAMETERS: usize = 12 * PARAMETERS_PER_PAGE;

/// What the mean departures of all methods are called beside names of variables and scores.
pub const DEPARTURE: &str = "mean_departure";

const BACKGROUND: [u8; 4] = [214, 96, 77, 255];
const ANALYSIS: [u8; 4] = [86, 180, 233, 255];
const BACKGROUND_SPREAD: [u8; 4] = [250, 200, 180, 255];
const ANALYSIS_SPREAD: [u8; 4] = [180, 220, 245, 255];
/// Of smoothed estimates, and of passive observations.
const INDEPENDENT: [u8; 4] = [230, 190, 80, 255];
const TRUTH: [u8; 4] = [240, 240, 240, 255];

/// Colour, width and name of a curve.
struct Style<'a> {
    color: [u8; 4],
    width: f32,
    name: &'a str,
}

/// What all curves of a run have in common.
pub struct Series<'a> {
    pub recording: &'a RecordingStream,
    pub info: &'a RunInfo,
    pub history: &'a History,
    pub names: &'a Names,
    /// The first cycle that is logged.
    pub since: usize,
}

impl Series<'_> {
    /// All curves of the run.
    pub fn log(&self) -> Result {
        for method in 0..self.info.methods.len() {
            self.log_scores(method)?;
            self.log_comparison(method)?;
            for parameter in shown_parameters(&self.info.calibration) {
                self.log_parameter(method, parameter)?;
            }
            self.log_estimated(method)?;
        }
        Ok(())
    }

    /// The scores of each variable that are drawn: claims below errors.
    fn log_scores(&self, method: usize) -> Result {
        let mut kinds: Vec<_> = self.info.drawn(true).collect();
        kinds.sort_by_key(|(_, line)| Reverse(*line));
        for variable in self.info.layout.variables.iter().map(|variable| variable.name) {
            for (kind, line) in &kinds {
                let title = kind.name.replace('_', " ").replace("rmse", "RMSE");
                let points = self.history.scores(method, &kind.key(variable), self.since);
                self.curve(&self.names.score(method, variable, kind.name), &style(kind, *line, &title), points)?;
            }
        }
        Ok(())
    }

    /// What is compared of all methods: a score of each variable, those of the method as a whole, and the mean background
    /// departure of the mapped variable.
    fn log_comparison(&self, method: usize) -> Result {
        let [red, green, blue] = colors::of_method(method);
        let style = Style { color: [red, green, blue, 255], width: 2.5, name: &self.info.methods[method].name };
        let variables = self.info.layout.variables.iter().map(|variable| variable.name);
        let of_variables = variables.filter_map(|variable| Some((variable, compared(self.info)?.key(variable))));
        let others = self.info.drawn(false).map(|(kind, _)| (kind.name, kind.name.to_string()));
        for (what, key) in of_variables.chain(others) {
            let points = self.history.scores(method, &key, self.since);
            self.curve(&self.names.comparison(what, method), &style, points)?;
        }
        let mean = |(cycle, own): (&'_ Cycle, &MethodCycle)| {
            let departures = &own.maps.as_ref()?.departures;
            let reports = cycle.reports.iter().zip(departures);
            let mapped = reports.filter(|(report, _)| report.variable == self.history.mapped);
            let (count, sum) = mapped.fold((0.0, 0.0), |(count, sum), (_, &it)| (count + 1.0, sum + f64::from(it)));
            (count > 0.0).then(|| sum / count)
        };
        self.curve(&self.names.comparison(DEPARTURE, method), &style, self.estimates(method, mean))
    }

    fn log_parameter(&self, method: usize, parameter: usize) -> Result {
        let path = |part: &str| self.names.parameter(method, parameter, part);
        let cycles = self.history.cycles.iter().filter(|cycle| cycle.number >= self.since);
        let truth = cycles.filter_map(|cycle| Some((cycle, cycle.true_bias(parameter)?)));
        self.curve(&path("truth"), &Style { color: TRUTH, width: 1.5, name: "truth" }, truth)?;
        let bound = |factor: f64| {
            self.estimates(method, move |(_, own)| Some(own.bias(parameter)? + factor * own.bias_spread(parameter)?))
        };
        self.log_estimate(&path, bound, self.estimates(method, |(_, own)| own.bias(parameter)))
    }

    /// What a method estimates beside state and calibration, where the data determine it.
    fn log_estimated(&self, method: usize) -> Result {
        for (name, methods) in &self.history.parameters {
            let Some(parameter) = &methods[method] else { continue };
            let bound = |factor: f64| {
                parameter.determined.iter().filter_map(move |(time, value, sigma)| {
                    let cycle = self.history.cycles.iter().find(|cycle| cycle.time == *time)?;
                    (cycle.number >= self.since).then_some((cycle, value + factor * sigma))
                })
            };
            self.log_estimate(&|part| self.names.estimated(method, name, part), bound, bound(0.0))?;
        }
        Ok(())
    }

    /// An estimate, and its bounds, those of `bound` for −2 and 2 standard deviations.
    fn log_estimate<'a, B: Iterator<Item = (&'a Cycle, f64)>>(
        &self,
        path: &dyn Fn(&str) -> String,
        bound: impl Fn(f64) -> B,
        estimate: impl Iterator<Item = (&'a Cycle, f64)>,
    ) -> Result {
        for (part, name, factor) in [("below", "−2σ", -2.0), ("above", "+2σ", 2.0)] {
            self.curve(&path(part), &Style { color: ANALYSIS_SPREAD, width: 1.0, name }, bound(factor))?;
        }
        self.curve(&path("estimate"), &Style { color: ANALYSIS, width: 2.5, name: "estimate" }, estimate)
    }

    /// A method's figure in every cycle that has one.
    fn estimates(
        &self,
        method: usize,
        figure: impl Fn((&Cycle, &MethodCycle)) -> Option<f64>,
    ) -> impl Iterator<Item = (&Cycle, f64)> {
        let results = self.history.of_method(method).filter(|(cycle, _)| cycle.number >= self.since);
        results.filter_map(move |(cycle, own)| Some((cycle, figure((cycle, own))?)))
    }

    /// A whole curve at once; nothing if there are no points.
    fn curve<'a>(&self, path: &str, style: &Style<'_>, points: impl Iterator<Item = (&'a Cycle, f64)>) -> Result {
        let points: Vec<(&Cycle, f64)> = points.collect();
        if points.is_empty() {
            return Ok(());
        }
        let lines = SeriesLines::new().with_colors([style.color]).with_widths([style.width]).with_names([style.name]);
        self.recording.log_static(path, &lines)?;
        let cycles = TimeColumn::new_sequence(CYCLE, points.iter().map(|(cycle, _)| cycle.number as i64));
        let seconds = points.iter().map(|(cycle, _)| cycle.time.seconds() as f64);
        let times = TimeColumn::new_timestamp_secs_since_epoch(VALID_TIME, seconds);
        let values = Scalars::new(points.iter().map(|point| point.1)).columns_of_unit_batches()?;
        self.recording.send_columns(path, [cycles, times], values)?;
        Ok(())
    }
}

/// The score of variables by which methods are compared.
pub fn compared(info: &RunInfo) -> Option<&'static ScoreKind> {
    info.drawn(true).map(|(kind, _)| kind).find(|kind| kind.compared && info.can_have(kind))
}

/// Colour and width of a curve: claims are paler and thinner than errors.
fn style<'a>(kind: &ScoreKind, line: Line, name: &'a str) -> Style<'a> {
    let (color, width) = match (kind.part, line) {
        (Part::Background, Line::Solid) => (BACKGROUND, 2.5),
        (Part::Background, _) => (BACKGROUND_SPREAD, 1.0),
        (_, Line::Solid) => (ANALYSIS, 2.5),
        (_, Line::Dashed) => (ANALYSIS_SPREAD, 1.0),
        (_, Line::Dotted) => (INDEPENDENT, 1.5),
    };
    Style { color, width, name }
}

/// The numbers of the calibration parameters that are recorded. Those that many observations share come first: where there
/// are too many, single stations are left out.
pub fn shown_parameters(calibration: &Calibration) -> Vec<usize> {
    let mut numbers: Vec<usize> = (0..calibration.len()).collect();
    numbers.sort_by_key(|&number| calibration.parameters[number].placement != Placement::Shared);
    numbers.truncate(MOST_PARAMETERS);
    numbers
}
