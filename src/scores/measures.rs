//! What is measured of a method in one cycle. Only here do estimate and truth meet.

use super::truths::Truth;
use crate::outcome::Outcome;
use isobar_assim::{Estimate, EstimatedParameter};
use isobar_model::Layout;
use isobar_obs::ObservationWindow;
use serde::{Deserialize, Serialize};

/// The estimates of one method and the truth of the same time.
#[derive(Clone, Copy)]
pub struct Verified<'a> {
    /// Grid and variables.
    pub layout: &'a Layout,
    /// The truth; `None` in a world of recorded observations, or if it is not known any more.
    pub truth: Option<Truth<'a>>,
    /// Number of calibration parameters, 0 if they are not scored, since the method is given them.
    pub scored_parameters: usize,
    /// The estimate before the observations of the cycle; `None` where a smoothed one is verified, as the next.
    pub background: Option<&'a Estimate>,
    /// That after them.
    pub analysis: Option<&'a Estimate>,
    /// The observations of the cycle, and what the method made of them.
    pub departures: Option<(&'a ObservationWindow, &'a Outcome)>,
    /// The estimate that later observations have revised; `None` where an analysis is verified.
    pub smoothed: Option<&'a Estimate>,
    /// Squares of (estimate − truth)/σ of the corrections of the model, and their number; `None` where no truth of them is known.
    pub corrections: Option<Sum>,
}

/// A measure that is averaged over cycles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sum {
    /// What is summed: a mean square over grid points, or a sum over observations.
    pub total: f64,
    /// The number by which the sum over cycles is divided: of cycles, or of observations.
    pub weight: f64,
}

/// The mean square error of each variable of an estimate; `None` without a truth.
pub fn error(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let errors = estimate?.state.values().iter().zip(it.truth?.state).map(|(value, truth)| value - truth);
    Some(mean_squares(it.layout, errors))
}

/// The mean claimed variance of each variable of an estimate; `None` if it claims none.
pub fn spread(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    Some(mean_squares(it.layout, estimate?.state_spread.as_ref()?.iter().copied()))
}

/// The mean square error of the bias parameters whose truth is known; `None` without one that is scored.
pub fn bias_error(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let parameters = estimate?.calibration.iter().zip(it.truth?.calibration).take(it.scored_parameters);
    mean_square(parameters.filter_map(|(value, truth)| Some(value - (*truth)?)))
}

/// The mean claimed variance of the same bias parameters, or of all if no truth is known; `None` without a parameter that is
/// scored, or without a claim.
pub fn bias_spread(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let spread = estimate?.calibration_spread.as_ref()?.iter().copied().take(it.scored_parameters);
    let truth = it.truth.map(|truth| truth.calibration).filter(|truth| truth.iter().any(Option::is_some));
    match truth {
        Some(truth) => mean_square(spread.zip(truth).filter_map(|(sigma, truth)| truth.map(|_| sigma))),
        None => mean_square(spread),
    }
}

/// The normalised innovation squared, χ² of the n observations of the cycle; its average is that per observation.
pub fn chi2(it: &Verified<'_>) -> Option<Vec<Sum>> {
    let (_, Outcome { analysis, .. }) = it.departures?;
    let weight = analysis.background_departures.len() as f64;
    Some(vec![Sum { total: analysis.innovation_chi2?, weight }])
}

/// The squares of (estimate − truth)/σ of the corrections of the model that claim a σ, of those whose truth is known, by their names.
pub fn of_corrections(estimated: &[EstimatedParameter], truth: &[(String, f64)]) -> Sum {
    let mut sum = Sum { total: 0.0, weight: 0.0 };
    for (name, truth) in truth {
        let Some(own) = estimated.iter().find(|own| own.name == *name) else { continue };
        if let Some(sigma) = own.sigma.filter(|sigma| *sigma > 0.0) {
            sum.total += ((own.value - truth) / sigma).powi(2);
            sum.weight += 1.0;
        }
    }
    sum
}

/// An estimate from which observations depart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// That before the observations.
    Background,
    /// That after them.
    Analysis,
}

/// The squares of the departures of the observations that are used, for each variable.
pub fn departures(it: &Verified<'_>, stage: Stage) -> Option<Vec<Sum>> {
    let (observed, Outcome { analysis, .. }) = it.departures?;
    let departures = match stage {
        Stage::Background => &analysis.background_departures,
        Stage::Analysis => &analysis.analysis_departures,
    };
    let variables = observed.reports.iter().map(|report| report.variable);
    Some(squares_by_variable(it.layout, variables.zip(departures.iter().copied())))
}

/// The same of passive observations.
pub fn passive_departures(it: &Verified<'_>, stage: Stage) -> Option<Vec<Sum>> {
    let (observed, Outcome { unused, .. }) = it.departures?;
    let departures = match stage {
        Stage::Background => &unused.background,
        Stage::Analysis => &unused.analysis,
    };
    let departures = observed.aside.passive().filter_map(|(at, it)| Some((it.report.variable, departures[at]?)));
    Some(squares_by_variable(it.layout, departures))
}

/// The sums of squares of values of these variables, and their numbers.
pub(super) fn squares_by_variable(layout: &Layout, values: impl Iterator<Item = (usize, f64)>) -> Vec<Sum> {
    let mut sums = vec![Sum { total: 0.0, weight: 0.0 }; layout.variables.len()];
    for (variable, value) in values {
        sums[variable].total += value * value;
        sums[variable].weight += 1.0;
    }
    sums
}

fn mean_square(values: impl Iterator<Item = f64>) -> Option<Vec<Sum>> {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (count > 0).then(|| vec![Sum { total: sum / f64::from(count), weight: 1.0 }])
}

/// The mean of the squares of each variable's values.
pub(super) fn mean_squares(layout: &Layout, values: impl Iterator<Item = f64>) -> Vec<Sum> {
    let cells = layout.grid.cells();
    let mut sums = vec![Sum { total: 0.0, weight: 1.0 }; layout.variables.len()];
    for (index, value) in values.enumerate() {
        sums[index / cells].total += value * value;
    }
    sums.iter_mut().for_each(|sum| sum.total /= cells as f64);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_count_whose_truth_is_known_and_whose_error_is_claimed() {
        let own = |name: &str, value: f64, sigma: Option<f64>| EstimatedParameter {
            name: name.into(),
            unit: "1".into(),
            value,
            sigma,
            verdict: String::new(),
        };
        let estimated =
            [own("a", 3.0, Some(0.5)), own("b", 1.0, None), own("c", 9.0, Some(2.0)), own("d", 0.0, Some(1.0))];
        let truth = [("c".to_string(), 4.0), ("b".to_string(), 0.0), ("a".to_string(), 2.0), ("e".to_string(), 1.0)];
        assert_eq!(of_corrections(&estimated, &truth), Sum { total: 6.25 + 4.0, weight: 2.0 });
    }
}
