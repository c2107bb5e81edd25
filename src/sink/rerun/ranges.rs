//! The ranges that colours and axes of the whole run share.

use super::history::{Estimates, History, Truth};
use crate::event::RunInfo;
use crate::plot::range::{around, quantile, round_up};
use crate::summary::PerVariable;

/// The ranges of the run's pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranges {
    /// Those of each variable.
    pub variables: Vec<VariableRanges>,
    /// Highest wind speed of the truth; 0 without wind.
    pub wind: f32,
    /// Highest wind speed of the common factors; 0 without wind.
    pub factor_wind: f32,
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
    /// Largest change by a common factor.
    pub factor: f32,
    /// Highest error or spread of the curves.
    pub score: f64,
}

impl Ranges {
    /// The ranges of a run.
    pub fn of_run(info: &RunInfo, history: &History) -> Self {
        let names = info.layout.variables.iter().map(|variable| variable.name);
        let factors = history.methods.iter().flat_map(|method| method.values()).flat_map(factors_of);
        Self {
            variables: names.enumerate().map(|(number, name)| of_variable(history, number, name)).collect(),
            wind: highest_speed(history, history.truth.values().map(|truth| &truth.fields)),
            factor_wind: highest_speed(history, factors),
        }
    }
}

fn of_variable(history: &History, number: usize, name: &str) -> VariableRanges {
    let (low, high) = history
        .truth
        .values()
        .flat_map(|truth| &truth.fields[number])
        .filter(|value| value.is_finite())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    // A method that goes astray must not make the pictures of all others pale: the median over the methods. Nor may the
    // first cycles, in which all know little: nine tenths of the values, and a little more.
    let median = |of_method: &dyn Fn(&Estimates, &Truth) -> Option<Vec<f32>>| {
        let quantiles = history.methods.iter().filter_map(|method| {
            let values = method.iter().filter_map(|(cycle, it)| of_method(it, history.truth.get(cycle)?));
            quantile(values.flatten().collect(), 0.9)
        });
        round_up(quantile(quantiles.collect(), 0.5).map(|it| 1.2 * it))
    };
    let difference = |it: &Estimates, truth: &Truth| {
        let pairs = it.background[number].iter().zip(&truth.fields[number]);
        Some(pairs.map(|(a, b)| (a - b).abs()).collect())
    };
    let factors = history.methods.iter().flat_map(|method| method.values()).flat_map(factors_of);
    let factors: Vec<f32> = factors.flat_map(|fields| &fields[number]).map(|value| value.abs()).collect();
    VariableRanges {
        state: if low <= high { around(low, high) } else { [0.0, 1.0] },
        difference: median(&difference),
        spread: median(&|it, _| Some(it.spread.as_ref()?[number].clone())),
        factor: round_up(quantile(factors, 0.99)),
        score: score(history, name),
    }
}

/// The fields of the common factors.
fn factors_of(estimates: &Estimates) -> impl Iterator<Item = &Vec<Vec<f32>>> {
    estimates.structure.iter().flat_map(|it| &it.factors).map(|factor| &factor.fields)
}

fn highest_speed<'a>(history: &History, all: impl Iterator<Item = &'a Vec<Vec<f32>>>) -> f32 {
    let winds = all.filter_map(|fields| history.wind(fields));
    let speeds = winds.flat_map(|[u, v]| u.iter().zip(v)).map(|(u, v)| u.hypot(*v));
    speeds.filter(|speed| speed.is_finite()).fold(0.0, f32::max)
}

/// The highest error or spread of a variable that its curves shall show.
fn score(history: &History, variable: &str) -> f64 {
    let scores = history.methods.iter().flat_map(|method| method.values()).map(|estimates| &estimates.scores);
    let parts = scores.flat_map(|it| {
        [Some(&it.rmse_background), Some(&it.rmse_analysis), it.spread_background.as_ref(), it.spread_analysis.as_ref()]
    });
    let values: Vec<f32> = parts
        .flatten()
        .filter_map(|part: &PerVariable| part.get(variable))
        .map(|&value| value as f32)
        .filter(|value| value.is_finite())
        .collect();
    let highest = values.iter().copied().fold(0.0, f32::max);
    let usual = quantile(values, 0.95).filter(|&usual| usual > 0.0).unwrap_or(1.0);
    f64::from(if highest > 0.0 { 1.05 * highest.min(2.0 * usual) } else { usual })
}
