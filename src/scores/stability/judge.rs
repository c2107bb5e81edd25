//! The verdicts.

use super::doubt::Doubt;
use super::needs::of_parameter;
use super::{InseparableMean, ParameterStability, Stability, Undetermined, Watch};
use isobar_assim::{Assimilator, Calibrated, CalibrationAccuracy, Combination, Error, Observability};
use isobar_model::Layout;
use isobar_obs::Calibration;

/// More parameters than these are judged each by itself: their combinations would take too long.
const MOST_TOGETHER: usize = 1000;

/// Innovations that go together from one cycle to the next by more than this keep a parameter from being stable.
const RED: f64 = 0.5;

/// Beyond this number of 95 % tolerances it is not chance, with some hundred parameters: one in a thousand.
const BEYOND_CHANCE: f64 = 1.68;

/// Parts of a direction below this, beside the largest of 1, are left out of its name.
const SMALL: f64 = 0.3;

/// What there is to say of a method that may have been judged before, when parameters were frozen: of these, and of what was
/// not determined then, the verdict of that time stands. A parameter that keeps more than `variance_ratio` of its prior
/// variance has no stable update.
///
/// # Errors
/// If the prior of the biases is no covariance.
pub fn judge(
    watch: &Watch,
    method: &Calibrated,
    calibration: &Calibration,
    layout: &Layout,
    variance_ratio: f64,
    when_frozen: Option<&Stability>,
) -> Result<Stability, Error> {
    let mut stability = Stability {
        innovation_chi2: watch.innovation_chi2(),
        lag_correlation: watch.lag_correlation(),
        variances: watch.variances(layout),
        ..Stability::default()
    };
    let prior = method.prior_covariance();
    let Some(claims) = method.can().calibration.filter(|_| prior.nrows() > 0) else { return Ok(stability) };
    let accuracy = claims.calibration_accuracy();
    let ratios = if prior.nrows() <= MOST_TOGETHER {
        let observability = Observability::new(prior, &accuracy, variance_ratio)?;
        let named = |it: &Combination| named(it, calibration, layout);
        stability.undetermined = observability.undetermined.iter().map(named).collect();
        let name = |number: &usize| calibration.parameters[*number].name.clone();
        stability.references = observability.references.iter().map(name).collect();
        observability.variance_ratios
    } else {
        alone(&accuracy, prior.nrows(), |j| prior[(j, j)])
    };
    let parameters = calibration.parameters.iter().enumerate();
    stability.parameters = parameters
        .map(|(number, parameter)| {
            let frozen = method.frozen()[number];
            let would_be = method.variance_if_adjusted(number).map(|variance| variance / prior[(number, number)]);
            let ratio = would_be.unwrap_or(ratios[number]);
            let doubts: Vec<Doubt> = doubts(watch, (number, frozen), ratio, variance_ratio).collect();
            let why: Vec<String> = doubts.iter().map(Doubt::to_string).collect();
            let needs = (!doubts.is_empty()).then(|| {
                let information = watch.information_of(number);
                let own = (number, prior[(number, number)]);
                of_parameter(own, variance_ratio, &information, &doubts, &accuracy, calibration)
            });
            ParameterStability {
                name: parameter.name.clone(),
                unit: parameter.unit.clone(),
                observations: watch.observations_of(number),
                variance_ratio: ratio,
                lag_correlation: watch.lag_correlation_of(number),
                stable: why.is_empty(),
                frozen,
                why,
                needs,
            }
        })
        .collect();
    if let Some(before) = when_frozen.filter(|_| method.frozen().contains(&true)) {
        stability.undetermined.clone_from(&before.undetermined);
        stability.references.clone_from(&before.references);
        let frozen = stability.parameters.iter_mut().zip(&before.parameters).filter(|(own, _)| own.frozen);
        frozen.for_each(|(own, before)| *own = ParameterStability { frozen: true, ..before.clone() });
    }
    Ok(stability)
}

/// Why a parameter with this share of its prior variance has no stable update; nothing if it has one. Innovations of a filter
/// that does not adjust a bias go together from cycle to cycle, and are no reason.
pub(super) fn doubts(
    watch: &Watch,
    (number, frozen): (usize, bool),
    ratio: f64,
    most: f64,
) -> impl Iterator<Item = Doubt> {
    let seen = watch.observations_of(number) > 0;
    let undetermined = match (seen, ratio > most) {
        (false, _) => Some(Doubt::Unobserved),
        (true, true) => Some(Doubt::Undetermined(ratio)),
        (true, false) => None,
    };
    let lag = watch.lag_correlation_of(number).filter(|_| !frozen);
    let red = lag.filter(|lag| lag.value > RED.max(BEYOND_CHANCE * lag.tolerance)).map(Doubt::Red);
    undetermined.into_iter().chain(red)
}

fn alone(accuracy: &CalibrationAccuracy, p: usize, prior: impl Fn(usize) -> f64) -> Vec<f64> {
    (0..p).map(|j| accuracy.covariance()[(j, j)] / prior(j)).collect()
}

/// A combination in the user's words.
fn named(combination: &Combination, calibration: &Calibration, layout: &Layout) -> Undetermined {
    let parts = combination.direction.iter().zip(&calibration.parameters);
    Undetermined {
        direction: parts
            .filter(|(part, _)| part.abs() >= SMALL)
            .map(|(part, parameter)| (parameter.name.clone(), *part))
            .collect(),
        variance_ratio: combination.variance_ratio,
        mean: combination.mean.map(|mean| InseparableMean {
            variable: layout.variables[mean.variable].name.to_string(),
            unit: layout.variables[mean.variable].unit.to_string(),
            correlation: mean.correlation,
            sigma_needed: mean.sigma_needed,
        }),
    }
}
