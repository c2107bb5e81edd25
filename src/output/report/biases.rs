//! The last estimates of all biases: in one figure, and where they are those of stations as a map.

use super::maps::Maps;
use super::section::Drawing;
use crate::event::{RunInfo, StationInfo};
use crate::output::bias_errors::of_stations;
use crate::output::history::{Cycle, History, MethodCycle};
use crate::output::netcdf::coordinates::safe_name;
use crate::plot::colors::{difference, of_method_on_paper};
use crate::plot::intervals::{Known, Row};
use crate::plot::map::both_signs;
use crate::plot::range::round_up;
use crate::plot::{FieldMap, IntervalPlot, Mark, unit};
use crate::tables::figure;

/// The most biases in the figure.
const MOST_ROWS: usize = 60;

/// The most methods in it.
const MOST_METHODS: usize = 6;

/// The steps of colours on a map, as parts of the largest bias.
const STEPS: [f32; 3] = [0.1, 0.3, 0.6];

/// The last cycle with results, and those of the methods that estimate biases, with the methods' numbers.
fn last<'a>(info: &RunInfo, history: &'a History) -> Option<(&'a Cycle, Vec<(usize, &'a MethodCycle)>)> {
    let cycle = history.cycles.iter().rfind(|cycle| cycle.methods.iter().any(Option::is_some))?;
    let estimates = cycle.methods.iter().enumerate().filter(|(number, _)| info.methods[*number].estimates_biases);
    let methods: Vec<_> =
        estimates.filter_map(|(number, own)| Some((number, own.as_ref()?))).take(MOST_METHODS).collect();
    (!methods.is_empty()).then_some((cycle, methods))
}

/// All biases below each other, each divided by the standard deviation of its prior, less the truth where it is known. Those are
/// above whose error is furthest beyond what is claimed or, without a truth, that are largest.
pub fn last_estimates(info: &RunInfo, history: &History) -> Option<Drawing<IntervalPlot>> {
    let (cycle, methods) = last(info, history)?;
    let has_truth = history.knows_biases();
    let mut rows: Vec<(f64, Row)> = Vec::new();
    for (number, parameter) in info.calibration.parameters.iter().enumerate() {
        let prior = info.calibration.prior_covariance(number, number).sqrt();
        let truth = cycle.true_bias(number);
        if prior <= 0.0 || has_truth && truth.is_none() {
            continue;
        }
        let (mut values, mut rank) = (Vec::new(), 0.0_f64);
        for (series, &(method, own)) in methods.iter().enumerate() {
            let (Some(estimate), sigma) = (own.bias(number), own.bias_spread(number)) else { continue };
            let value = estimate - truth.unwrap_or(0.0);
            let beyond = value.abs() / sigma.filter(|sigma| has_truth && *sigma > 0.0).unwrap_or(prior);
            rank = rank.max(if beyond.is_finite() { beyond } else { 0.0 });
            let interval = sigma.map(|sigma| [value - 2.0 * sigma, value + 2.0 * sigma].map(|end| end / prior));
            let name = &info.methods[method].name;
            let of_truth = truth.map_or(String::new(), |truth| format!(", truth {}", figure(truth)));
            let title = format!("{name}: {} {}{of_truth}", figure(estimate), unit(&parameter.unit));
            values.push(Known { series, value: value / prior, interval, claimed: None, title });
        }
        rows.push((rank, Row { label: parameter.name.clone(), values }));
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let left_out = rows.len().saturating_sub(MOST_ROWS);
    rows.truncate(MOST_ROWS);
    let series = methods.iter().map(|&(it, _)| (Some(info.methods[it].name.clone()), of_method_on_paper(it)));
    let (title, label, order) = if has_truth {
        (
            "Errors of the bias estimates",
            "(estimate − truth) / σ of the prior",
            "Those are above whose error is furthest beyond what a method claims.",
        )
    } else {
        ("Bias estimates", "estimate / σ of the prior", "The largest are above.")
    };
    let more = if left_out > 0 { format!(" {left_out} more are in the table.") } else { String::new() };
    (!rows.is_empty()).then(|| Drawing {
        stem: "biases".into(),
        caption: format!("The last estimates of all methods with ±2σ. {order}{more}"),
        plot: IntervalPlot {
            title: title.into(),
            label: label.into(),
            series: series.collect(),
            rows: rows.into_iter().map(|(_, row)| row).collect(),
            reference: Some(0.0),
            from_zero: false,
            width: 880.0,
        },
    })
}

/// Maps of the stations, coloured by the error of their bias or, without a truth, by its estimate: for each variable with biases
/// of stations or of their groups, of the last of the methods that estimate biases and claim an error, or else of the last.
pub fn stations(info: &RunInfo, history: &History, maps: &Maps<'_>) -> Vec<Drawing<FieldMap>> {
    let Some((cycle, methods)) = last(info, history) else { return Vec::new() };
    let has_truth = history.knows_biases();
    let claiming = methods.iter().rfind(|(_, own)| own.calibration_spread.is_some());
    let Some(&(method, own)) = claiming.or(methods.last()) else { return Vec::new() };
    let mut drawings = Vec::new();
    for (number, variable) in info.layout.variables.iter().enumerate() {
        let all = of_stations(history, (cycle, own), number);
        let Some(largest) = all.iter().map(|it| it.2.abs()).reduce(f32::max) else { continue };
        let (name, limit, units) = (&info.methods[method].name, round_up(Some(largest)), unit(variable.unit));
        let mark = |(station, _, value): &(&StationInfo, usize, f32)| Mark {
            x_m: station.x_m,
            y_m: station.y_m,
            color: Some(difference(*value, limit)),
            title: format!(
                "{} {} ({}): {} {units}",
                station.network,
                station.name,
                station.group,
                figure((*value).into())
            ),
        };
        let what = if has_truth { "error of the bias" } else { "bias" };
        let map = maps.empty(format!("{name}: {what} of {}", variable.name), variable.unit.to_string(), limit);
        let (steps, marks) = (both_signs(&STEPS.map(|part| part * limit)), all.iter().map(mark).collect());
        drawings.push(Drawing {
            stem: format!("biases_of_stations_{}", safe_name(variable.name, "_")),
            caption: format!("Stations in the colour of the {what} of {} that {name} has at the end.", variable.name),
            plot: FieldMap { marks, steps, ..map },
        });
    }
    drawings
}
