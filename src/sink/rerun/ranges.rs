//! The ranges that colours and axes of the whole run share.

use super::history::History;
use crate::event::RunInfo;
use crate::plot::range::{around, quantile, round_up};
use crate::summary::PerVariable;

/// The ranges of the run's pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranges {
    /// Lowest and highest value of the mapped variable.
    pub state: [f32; 2],
    /// Largest difference that is told apart by its colour; the smallest is its negative.
    pub difference: f32,
    /// Largest spread.
    pub spread: f32,
    /// Highest wind speed of the truth; 0 without wind.
    pub wind: f32,
    /// Highest error or spread of the curves, for each variable.
    pub score: Vec<f64>,
}

impl Ranges {
    /// The ranges of a run.
    pub fn of_run(info: &RunInfo, history: &History) -> Self {
        let variables: Vec<&str> = info.layout.variables.iter().map(|variable| variable.name).collect();
        let truth = || history.truth.values();
        let (low, high) = truth()
            .flat_map(|truth| &truth.field)
            .filter(|value| value.is_finite())
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
        let state = if low <= high { around(low, high) } else { [0.0, 1.0] };
        let wind = truth().filter_map(|truth| truth.wind.as_ref());
        let speeds =
            wind.flat_map(|[u, v]| u.iter().zip(v)).map(|(u, v)| u.hypot(*v)).filter(|speed| speed.is_finite());
        // A method that goes astray must not make the pictures of all others pale: the median over the methods.
        let differences = history.methods.iter().map(|method| {
            let estimates =
                method.iter().filter_map(|(cycle, it)| Some((&it.background, &history.truth.get(cycle)?.field)));
            quantile(estimates.flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| (a - b).abs()).collect(), 0.98)
        });
        let spreads = history.methods.iter().map(|method| {
            quantile(method.values().filter_map(|it| it.spread.as_ref()).flatten().copied().collect(), 0.98)
        });
        Self {
            state,
            difference: round_up(quantile(differences.flatten().collect(), 0.5)),
            spread: round_up(quantile(spreads.flatten().collect(), 0.5)),
            wind: speeds.fold(0.0, f32::max),
            score: variables.iter().map(|variable| score(history, variable)).collect(),
        }
    }
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
