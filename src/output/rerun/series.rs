//! Curves over time: errors and spreads of each variable, and the bias estimates.

use super::names::{Names, Result};
use crate::event::RunInfo;
use crate::output::history::{Cycle, History, MethodCycle};
use crate::plot::colors;
use crate::scores::{Line, Part, SCORES, ScoreKind};
use ::rerun::{RecordingStream, Scalars, SeriesLines, TimeColumn};
use isobar_model::Time;
use isobar_obs::{Calibration, Placement};

/// Plots of calibration parameters on one page.
pub const PARAMETERS_PER_PAGE: usize = 4;

/// The most pages of them that a method has.
const PAGES: usize = 12;

const BACKGROUND: [u8; 4] = [214, 96, 77, 255];
const ANALYSIS: [u8; 4] = [86, 180, 233, 255];
const BACKGROUND_SPREAD: [u8; 4] = [250, 200, 180, 255];
const ANALYSIS_SPREAD: [u8; 4] = [180, 220, 245, 255];
const TRUTH: [u8; 4] = [240, 240, 240, 255];

/// Colour, width and name of a curve.
struct Style<'a> {
    color: [u8; 4],
    width: f32,
    name: &'a str,
}

/// All curves of the run from a cycle on.
pub fn log_since(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    names: &Names,
    since: usize,
) -> Result {
    for number in 0..info.methods.len() {
        log_scores(recording, info, history, names, number, since)?;
        log_innovations(recording, info, history, names, number, since)?;
        for parameter in shown_parameters(&info.calibration) {
            log_parameter(recording, history, names, number, parameter, since)?;
        }
    }
    Ok(())
}

/// The scores of a variable that are drawn: those of background and analysis, claims below errors.
pub fn drawn() -> impl Iterator<Item = &'static ScoreKind> {
    let of_line = |line| SCORES.iter().filter(move |kind| kind.per_variable && kind.line == Some(line));
    of_line(Line::Dashed).chain(of_line(Line::Solid))
}

/// The score of variables by which methods are compared.
pub fn compared(info: &RunInfo) -> Option<&'static ScoreKind> {
    SCORES.iter().find(|kind| kind.per_variable && kind.compared && info.can_have(kind))
}

/// Colour and width of a curve: claims are paler and thinner than errors.
fn style<'a>(kind: &ScoreKind, name: &'a str) -> Style<'a> {
    let (color, width) = match (kind.part, kind.line) {
        (Part::Background, Some(Line::Solid)) => (BACKGROUND, 2.5),
        (Part::Background, _) => (BACKGROUND_SPREAD, 1.0),
        (_, Some(Line::Solid)) => (ANALYSIS, 2.5),
        _ => (ANALYSIS_SPREAD, 1.0),
    };
    Style { color, width, name }
}

fn log_scores(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    names: &Names,
    method: usize,
    since: usize,
) -> Result {
    let [red, green, blue] = colors::of_method(method);
    let own = Style { color: [red, green, blue, 255], width: 2.5, name: &info.methods[method].name };
    for variable in info.layout.variables.iter().map(|variable| variable.name) {
        let points = |key: &str| points(since, history.scores(method, key));
        for kind in drawn() {
            let title = kind.name.replace('_', " ").replace("rmse", "RMSE");
            let path = names.score(method, variable, kind.name);
            log(recording, &path, &style(kind, &title), &points(&kind.key(variable)))?;
        }
        if let Some(kind) = compared(info) {
            log(recording, &names.comparison(variable, method), &own, &points(&kind.key(variable)))?;
        }
    }
    Ok(())
}

/// χ²/n, and the mean background departure of the mapped variable.
fn log_innovations(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    names: &Names,
    method: usize,
    since: usize,
) -> Result {
    let [red, green, blue] = colors::of_method(method);
    let style = Style { color: [red, green, blue, 255], width: 2.5, name: &info.methods[method].name };
    let chi2 = points(since, history.scores(method, "innovation_chi2"));
    log(recording, &names.innovation("chi2", method), &style, &chi2)?;
    let mean = |cycle: &Cycle, departures: &[f32]| {
        let mapped = cycle.reports.iter().zip(departures).filter(|(report, _)| report.variable == history.mapped);
        let (count, sum) = mapped.fold((0.0, 0.0), |(count, sum), (_, &it)| (count + 1.0, sum + f64::from(it)));
        (count > 0.0).then(|| sum / count)
    };
    let means = history.maps(method).filter_map(|(cycle, maps)| Some((cycle, mean(cycle, &maps.departures)?)));
    log(recording, &names.innovation("departure", method), &style, &points(since, means))
}

fn log_parameter(
    recording: &RecordingStream,
    history: &History,
    names: &Names,
    method: usize,
    parameter: usize,
    since: usize,
) -> Result {
    let path = |part: &str| names.parameter(method, parameter, part);
    let estimates = |value: &dyn Fn(&MethodCycle) -> Option<f64>| {
        points(since, history.of_method(method).filter_map(|(cycle, own)| Some((cycle, value(own)?))))
    };
    for (part, name, factor) in [("below", "−2σ", -2.0), ("above", "+2σ", 2.0)] {
        let bound = |own: &MethodCycle| {
            Some(own.calibration.get(parameter)? + factor * own.calibration_spread.as_ref()?.get(parameter)?)
        };
        log(recording, &path(part), &Style { color: ANALYSIS_SPREAD, width: 1.0, name }, &estimates(&bound))?;
    }
    let truth = history.cycles.iter().filter_map(|cycle| Some((cycle, *cycle.true_calibration.get(parameter)?)));
    log(recording, &path("truth"), &Style { color: TRUTH, width: 1.5, name: "truth" }, &points(since, truth))?;
    let estimate = estimates(&|own| own.calibration.get(parameter).copied());
    log(recording, &path("estimate"), &Style { color: ANALYSIS, width: 2.5, name: "estimate" }, &estimate)
}

/// The points of a curve from a cycle on.
fn points<'a>(since: usize, values: impl Iterator<Item = (&'a Cycle, f64)>) -> Vec<(usize, Time, f64)> {
    let values = values.filter(|(cycle, _)| cycle.number >= since);
    values.map(|(cycle, value)| (cycle.number, cycle.time, value)).collect()
}

/// A whole curve at once; nothing if there are no points.
fn log(recording: &RecordingStream, path: &str, style: &Style<'_>, points: &[(usize, Time, f64)]) -> Result {
    if points.is_empty() {
        return Ok(());
    }
    let lines = SeriesLines::new().with_colors([style.color]).with_widths([style.width]).with_names([style.name]);
    recording.log_static(path, &lines)?;
    let cycles = TimeColumn::new_sequence("cycle", points.iter().map(|point| point.0 as i64));
    let seconds = points.iter().map(|point| point.1.seconds() as f64);
    let times = TimeColumn::new_timestamp_secs_since_epoch("valid_time", seconds);
    let values = Scalars::new(points.iter().map(|point| point.2)).columns_of_unit_batches()?;
    recording.send_columns(path, [cycles, times], values)?;
    Ok(())
}

/// The numbers of the calibration parameters that are recorded. Those that many observations share come first: where there
/// are too many, single stations are left out.
pub fn shown_parameters(calibration: &Calibration) -> Vec<usize> {
    let mut numbers: Vec<usize> = (0..calibration.len()).collect();
    numbers.sort_by_key(|&number| calibration.parameters[number].placement != Placement::Shared);
    numbers.truncate(PAGES * PARAMETERS_PER_PAGE);
    numbers
}
