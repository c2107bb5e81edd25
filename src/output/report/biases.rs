//! The last estimates of all biases: in one figure, and where they are those of stations as a map.

use super::headline::Drawing;
use super::maps::{self, Maps};
use crate::event::{RunInfo, StationInfo};
use crate::output::history::{Cycle, History, MethodCycle};
use crate::output::netcdf::coordinates::safe_name;
use crate::plot::colors::{difference, of_method_on_paper};
use crate::plot::intervals::{Known, Row};
use crate::plot::range::round_up;
use crate::plot::{FieldMap, IntervalPlot, Mark, unit};
use crate::tables::figure;

/// The most biases in the figure.
const MOST_ROWS: usize = 60;

/// The most methods in it.
const MOST_METHODS: usize = 6;

/// The least share of the largest bias that has a colour of its own on a map.
const STEPS: [f32; 3] = [0.1, 0.3, 0.6];

/// The estimate of a bias by a method.
struct Estimate {
    value: f64,
    sigma: Option<f64>,
}

/// The methods that estimate biases, by number, with their last estimates.
fn last(info: &RunInfo, history: &History) -> Option<(usize, Vec<usize>)> {
    let place = history.cycles.iter().rposition(|cycle| cycle.methods.iter().any(Option::is_some))?;
    let cycle = &history.cycles[place];
    let estimates = |number: &usize| {
        info.methods[*number].estimates_biases && cycle.methods.get(*number).is_some_and(Option::is_some)
    };
    let methods: Vec<usize> = (0..info.methods.len()).filter(estimates).take(MOST_METHODS).collect();
    (!methods.is_empty()).then_some((place, methods))
}

fn estimate(own: &MethodCycle, number: usize) -> Option<Estimate> {
    let sigma = own.calibration_spread.as_ref().and_then(|spread| spread.get(number)).copied();
    Some(Estimate { value: *own.calibration.get(number)?, sigma })
}

fn of_method(cycle: &Cycle, method: usize) -> Option<&MethodCycle> {
    cycle.methods.get(method)?.as_ref()
}

/// All biases below each other, each divided by the standard deviation of its prior, less the truth where it is known. Those are
/// above whose error is furthest beyond what is claimed or, without a truth, that are largest.
pub fn last_estimates(info: &RunInfo, history: &History) -> Option<Drawing> {
    let (place, methods) = last(info, history)?;
    let (cycle, has_truth) = (&history.cycles[place], history.knows_biases());
    let mut rows: Vec<(f64, Row)> = Vec::new();
    for (number, parameter) in info.calibration.parameters.iter().enumerate() {
        let prior = info.calibration.prior_covariance(number, number).sqrt();
        let truth = cycle.true_bias(number);
        if prior <= 0.0 || has_truth && truth.is_none() {
            continue;
        }
        let (mut values, mut rank) = (Vec::new(), 0.0_f64);
        for (series, &method) in methods.iter().enumerate() {
            let Some(it) = of_method(cycle, method).and_then(|own| estimate(own, number)) else { continue };
            let value = it.value - truth.unwrap_or(0.0);
            let beyond = value.abs() / it.sigma.filter(|sigma| has_truth && *sigma > 0.0).unwrap_or(prior);
            rank = rank.max(if beyond.is_finite() { beyond } else { 0.0 });
            let interval = it.sigma.map(|sigma| [value - 2.0 * sigma, value + 2.0 * sigma].map(|end| end / prior));
            let name = &info.methods[method].name;
            let of_truth = truth.map_or(String::new(), |truth| format!(", truth {}", figure(truth)));
            let title = format!("{name}: {} {}{of_truth}", figure(it.value), unit(&parameter.unit));
            values.push(Known { series, value: value / prior, interval, claimed: None, title });
        }
        rows.push((rank, Row { label: parameter.name.clone(), values }));
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let left_out = rows.len().saturating_sub(MOST_ROWS);
    rows.truncate(MOST_ROWS);
    let series = methods.iter().map(|&it| (Some(info.methods[it].name.clone()), of_method_on_paper(it)));
    let (title, label, told) = if has_truth {
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
        caption: format!("The last estimates of all methods with ±2σ. {told}{more}"),
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
pub fn stations(info: &RunInfo, history: &History, maps: &Maps<'_>) -> Vec<maps::Drawing> {
    let Some((place, methods)) = last(info, history) else { return Vec::new() };
    let (cycle, has_truth) = (&history.cycles[place], history.knows_biases());
    let claims = |method: &&usize| of_method(cycle, **method).is_some_and(|own| own.calibration_spread.is_some());
    let Some(&method) = methods.iter().rfind(claims).or(methods.last()) else { return Vec::new() };
    let Some(own) = of_method(cycle, method) else { return Vec::new() };
    let mut drawings = Vec::new();
    for variable in &info.layout.variables {
        let value = |station: &StationInfo| {
            let names = [&station.group, &station.name].map(|of| format!("{}/{}/{of}", station.network, variable.name));
            let number = info.calibration.parameters.iter().position(|parameter| names.contains(&parameter.name))?;
            let value = estimate(own, number)?.value - if has_truth { cycle.true_bias(number)? } else { 0.0 };
            Some(value as f32).filter(|value| value.is_finite())
        };
        let all = info.stations.iter().filter_map(|station| Some((station, value(station)?)));
        let all: Vec<(&StationInfo, f32)> = all.collect();
        let Some(largest) = all.iter().map(|it| it.1.abs()).reduce(f32::max) else { continue };
        let (name, limit, units) = (&info.methods[method].name, round_up(Some(largest)), unit(variable.unit));
        let mark = |(station, value): &(&StationInfo, f32)| Mark {
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
        let steps: Vec<f32> =
            STEPS.iter().rev().map(|part| -part * limit).chain(STEPS.map(|part| part * limit)).collect();
        let marks: Vec<Mark> = all.iter().map(mark).collect();
        drawings.push(maps::Drawing {
            stem: format!("biases_of_stations_{}", safe_name(variable.name, "_")),
            caption: format!("Stations in the colour of the {what} of {} that {name} has at the end.", variable.name),
            map: FieldMap { marks, steps, ..map },
        });
    }
    drawings
}
