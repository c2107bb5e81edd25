//! The ranges that colours and axes of the whole run share.

use super::frame::Frame;
use crate::event::RunInfo;
use crate::output::bias_errors::of_stations;
use crate::output::history::{Cycle, History, MethodMaps};
use crate::plot::range::{quantile, round_up};

/// The ranges of the run's pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranges {
    /// Those of each variable.
    pub variables: Vec<VariableRanges>,
    /// Highest wind speed of the truth, or of the analyses without one; 0 without wind.
    pub wind: f32,
}

/// The ranges of a variable.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableRanges {
    /// Lowest and highest value.
    pub state: [f32; 2],
    /// Largest difference that is told apart by its colour; the smallest is its negative.
    pub difference: f32,
    /// Largest spread.
    pub spread: f32,
    /// Largest error of a station's bias, or bias without a truth, that has its own colour.
    pub station_bias: f32,
    /// Highest error or spread of the curves, for each method.
    pub score: Vec<f64>,
}

impl Ranges {
    /// The ranges of a run.
    pub fn of_run(info: &RunInfo, history: &History) -> Self {
        let (names, frame) = (info.layout.variables.iter().map(|variable| variable.name), Frame::new(&info.layout));
        Self {
            variables: names.enumerate().map(|(number, name)| of_variable(history, number, name)).collect(),
            wind: history.states().map(|fields| frame.highest_speed(fields)).fold(0.0, f32::max),
        }
    }
}

fn of_variable(history: &History, number: usize, name: &str) -> VariableRanges {
    // The first cycles, in which all methods know little, must not make the maps of all others pale: nine tenths of the
    // values, and a little more.
    let usual =
        |values: &dyn Fn(&Cycle, &MethodMaps) -> Vec<f32>| round_up(history.usual(0.9, values).map(|it| 1.2 * it));
    // Without a truth the differences are increments.
    let difference = |cycle: &Cycle, maps: &MethodMaps| {
        let other = cycle.truth.as_ref().unwrap_or(&maps.analysis);
        maps.background[number].iter().zip(&other[number]).map(|(a, b)| (a - b).abs()).collect()
    };
    VariableRanges {
        state: history.state_range(number),
        difference: usual(&difference),
        spread: usual(&|_, maps| maps.spread.as_ref().map_or_else(Vec::new, |it| it[number].clone())),
        station_bias: station_bias(history, number),
        score: (0..history.info.methods.len()).map(|method| score(history, method, name)).collect(),
    }
}

/// The limit of colours of stations: of the median method nine tenths of all values, and a little more.
fn station_bias(history: &History, variable: usize) -> f32 {
    let of_cycle = |own| of_stations(history, own, variable).into_iter().map(|it| it.2.abs());
    let of_method = |method| quantile(history.of_method(method).flat_map(of_cycle).collect(), 0.9);
    let methods = &history.info.methods;
    let estimating = (0..methods.len()).filter(|&method| methods[method].estimates_biases);
    round_up(quantile(estimating.filter_map(of_method).collect(), 0.5).map(|it| 1.2 * it))
}

/// The highest error or spread of a variable that a method's curves show.
fn score(history: &History, method: usize, variable: &str) -> f64 {
    let all = history
        .info
        .drawn(true)
        .flat_map(|(kind, _)| history.scores(method, &kind.key(variable), 0).map(|it| it.1 as f32).collect::<Vec<_>>());
    let values: Vec<f32> = all.filter(|value| value.is_finite()).collect();
    let highest = values.iter().copied().fold(0.0, f32::max);
    let usual = quantile(values, 0.95).filter(|&usual| usual > 0.0).unwrap_or(1.0);
    f64::from(if highest > 0.0 { 1.05 * highest.min(2.0 * usual) } else { usual })
}
