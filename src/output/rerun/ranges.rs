//! The ranges that colours and axes of the whole run share.

use super::history::{Estimates, History, Truth};
use super::series::drawn;
use crate::event::RunInfo;
use crate::plot::range::{around, quantile, round_up};

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
    /// Highest error or spread of the curves, for each method.
    pub score: Vec<f64>,
}

impl Ranges {
    /// The ranges of a run.
    pub fn of_run(info: &RunInfo, history: &History) -> Self {
        let names = info.layout.variables.iter().map(|variable| variable.name);
        Self {
            variables: names.enumerate().map(|(number, name)| of_variable(history, number, name)).collect(),
            wind: shown(history).map(|fields| history.highest_speed(fields)).fold(0.0, f32::max),
        }
    }
}

/// The fields whose range all maps of states have: those of the truth, without one those of the analyses.
fn shown(history: &History) -> impl Iterator<Item = &Vec<Vec<f32>>> {
    let analyses = history.methods.iter().flat_map(|method| method.values().map(|it| &it.analysis));
    let of_truth = history.truth.values().map(|truth| &truth.fields);
    of_truth.chain(analyses.filter(move |_| history.truth.is_empty()))
}

/// Values of a map that estimates make, beside the truth if there is one.
type OfEstimates<'a> = dyn Fn(&Estimates, Option<&Truth>) -> Option<Vec<f32>> + 'a;

fn of_variable(history: &History, number: usize, name: &str) -> VariableRanges {
    let (low, high) = shown(history)
        .flat_map(|fields| &fields[number])
        .filter(|value| value.is_finite())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
    // A method that goes astray must not make the pictures of all others pale: the median over the methods. Nor may the
    // first cycles, in which all know little: nine tenths of the values, and a little more.
    let median = |of_method: &OfEstimates<'_>| {
        let quantiles = history.methods.iter().filter_map(|method| {
            let values = method.iter().filter_map(|(cycle, it)| of_method(it, history.truth.get(cycle)));
            quantile(values.flatten().collect(), 0.9)
        });
        round_up(quantile(quantiles.collect(), 0.5).map(|it| 1.2 * it))
    };
    // Without a truth the differences are increments.
    let difference = |it: &Estimates, truth: Option<&Truth>| {
        let other = truth.map_or(&it.analysis, |truth| &truth.fields);
        Some(it.background[number].iter().zip(&other[number]).map(|(a, b)| (a - b).abs()).collect())
    };
    VariableRanges {
        state: if low <= high { around(low, high) } else { [0.0, 1.0] },
        difference: median(&difference),
        spread: median(&|it, _| Some(it.spread.as_ref()?[number].clone())),
        score: history.methods.iter().map(|method| score(method.values(), name)).collect(),
    }
}

/// The highest error or spread of a variable that its curves show.
fn score<'a>(cycles: impl Iterator<Item = &'a Estimates>, variable: &str) -> f64 {
    let keys: Vec<String> = drawn().map(|kind| kind.key(variable)).collect();
    let values = cycles.flat_map(|estimates| keys.iter().filter_map(|key| estimates.scores.get(key)));
    let values: Vec<f32> = values.map(|&value| value as f32).filter(|value| value.is_finite()).collect();
    let highest = values.iter().copied().fold(0.0, f32::max);
    let usual = quantile(values, 0.95).filter(|&usual| usual > 0.0).unwrap_or(1.0);
    f64::from(if highest > 0.0 { 1.05 * highest.min(2.0 * usual) } else { usual })
}
