//! Curves over time: errors and spreads of each variable, and the bias estimates.

use super::history::{Estimates, History};
use super::names::{Names, Result};
use crate::event::RunInfo;
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
    for (number, method) in history.methods.iter().enumerate() {
        log_scores(recording, info, names, number, method.range(since..))?;
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

fn log_scores<'a>(
    recording: &RecordingStream,
    info: &RunInfo,
    names: &Names,
    method: usize,
    estimates: impl Iterator<Item = (&'a usize, &'a Estimates)> + Clone,
) -> Result {
    let [red, green, blue] = colors::of_method(method);
    let own = Style { color: [red, green, blue, 255], width: 2.5, name: &info.methods[method].name };
    for variable in info.layout.variables.iter().map(|variable| variable.name) {
        let points = |key: &str| {
            let at = |(cycle, it): (&usize, &Estimates)| Some((*cycle, it.time, *it.scores.get(key)?));
            estimates.clone().filter_map(at).collect::<Vec<_>>()
        };
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
    let estimates = || history.methods[method].range(since..);
    let chi2 = estimates().filter_map(|(&cycle, it)| Some((cycle, it.time, *it.scores.get("innovation_chi2")?)));
    log(recording, &names.innovation("chi2", method), &style, &chi2.collect::<Vec<_>>())?;
    let mean = |cycle: usize, departures: &[f32]| {
        let reports = history.observed.get(&cycle)?.iter().flat_map(|platform| &platform.reports);
        let mapped = reports.filter(|report| report.1 == history.mapped).filter_map(|report| departures.get(report.0));
        let (count, sum) = mapped.fold((0.0, 0.0), |(count, sum), &it| (count + 1.0, sum + f64::from(it)));
        (count > 0.0).then(|| sum / count)
    };
    let means = estimates().filter_map(|(&cycle, it)| Some((cycle, it.time, mean(cycle, &it.departures)?)));
    log(recording, &names.innovation("departure", method), &style, &means.collect::<Vec<_>>())
}

fn log_parameter(
    recording: &RecordingStream,
    history: &History,
    names: &Names,
    method: usize,
    parameter: usize,
    since: usize,
) -> Result {
    let truth: Vec<_> = history
        .truth
        .range(since..)
        .filter_map(|(cycle, truth)| Some((*cycle, truth.time, *truth.calibration.get(parameter)?)))
        .collect();
    let estimates: Vec<_> = history.methods[method]
        .range(since..)
        .filter_map(|(cycle, it)| {
            let sigma = it.calibration_spread.as_ref().map(|spread| spread[parameter]);
            Some((*cycle, it.time, *it.calibration.get(parameter)?, sigma))
        })
        .collect();
    let path = |part: &str| names.parameter(method, parameter, part);
    for (part, name, factor) in [("below", "−2σ", -2.0), ("above", "+2σ", 2.0)] {
        let bound = |&(cycle, time, value, sigma): &(usize, Time, f64, Option<f64>)| {
            Some((cycle, time, value + factor * sigma?))
        };
        let points: Vec<_> = estimates.iter().filter_map(bound).collect();
        log(recording, &path(part), &Style { color: ANALYSIS_SPREAD, width: 1.0, name }, &points)?;
    }
    log(recording, &path("truth"), &Style { color: TRUTH, width: 1.5, name: "truth" }, &truth)?;
    let points: Vec<_> = estimates.iter().map(|&(cycle, time, value, _)| (cycle, time, value)).collect();
    log(recording, &path("estimate"), &Style { color: ANALYSIS, width: 2.5, name: "estimate" }, &points)
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
