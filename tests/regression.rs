//! The accepted scores of the scenarios: the small ones are run, and all of them must say what the project claims. That the
//! others are what the program computes is held by `isobar regress`, which runs beside these tests.

use crate::runs::{run_options, scenarios};
use isobar::event::Event;
use isobar::kinds::methods::Method;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use isobar::scores::Regression;
use isobar_assim::BiasTreatment;

/// The largest grid for which this takes seconds.
const MOST_CELLS: usize = 200;

struct Deaf;

impl Sink for Deaf {
    fn record(&mut self, _: &Event<'_>) -> Result<(), SinkError> {
        Ok(())
    }
}

#[test]
fn small_scenarios_have_their_accepted_scores() {
    let mut ran = 0;
    for scenario in scenarios() {
        if scenario.grid.grid.cells() > MOST_CELLS {
            continue;
        }
        let directory = tempfile::tempdir().unwrap();
        let options = run_options(directory.path(), scenario.cycle.count);
        let summary = isobar::run::run(&scenario, &options, &mut Deaf).unwrap();
        let comparison = Regression::new(&scenario.expected, &summary);
        assert!(comparison.passed(), "{}: {}", scenario.name, comparison.describe(100));
        ran += 1;
    }
    assert!(ran >= 1);
}

/// Names of the methods that satisfy a condition.
fn methods(scenario: &Scenario, condition: impl Fn(&Method) -> bool) -> Vec<&str> {
    let all = scenario.methods.iter();
    all.filter(|(_, method)| condition(method)).map(|(name, _)| name.as_str()).collect()
}

/// Scenarios in which the Kalman filter does not know the statistics of the world, or in which one draw says nothing of them:
/// where mean height and bias cannot be told apart, only luck makes one method better than another; where the model makes no error,
/// a few analyses determine everything; and `observation_times`, where the filter takes an error within the window for the one at
/// the analysis. `forecast_skill`, `linear_forecasts`,
/// `observation_times` and `sensor_care` have no full Kalman filter.
const NOT_OPTIMAL: [&str; 16] = [
    "compared_sensors",
    "diurnal_bias",
    "first_calibration",
    "forcing",
    "forecast_skill",
    "linear_advection",
    "linear_forecasts",
    "local_factors",
    "local_wrong_model",
    "model_patterns",
    "no_reference_station",
    "observation_times",
    "pdaf_2d",
    "sensor_care",
    "wrong_errors",
    "wrong_model",
];

#[test]
fn the_kalman_filter_is_the_best_of_those_who_know_as_much() {
    for scenario in scenarios() {
        if scenario.truth.is_none() || NOT_OPTIMAL.contains(&scenario.name.as_str()) {
            continue;
        }
        let expected = &scenario.expected.methods;
        let rmse = |name: &str| expected[name][&format!("rmse_analysis.{}", scenario.model.variables()[0].0)];
        let kalman =
            |method: &Method| method.kind == "kf" && method.estimates_biases() && method.uses_error_correlation;
        let [best] = methods(&scenario, kalman)[..] else { panic!("{} has not one kf", scenario.name) };
        for other in methods(&scenario, |method| method.bias != BiasTreatment::Known) {
            assert!(rmse(other) > 0.999 * rmse(best), "{}: {other} beats {best}", scenario.name);
        }
    }
}

#[test]
fn the_spread_of_the_kalman_filter_matches_its_error_on_linear_scenarios() {
    let mut checked = 0;
    for scenario in scenarios() {
        if scenario.truth.is_none()
            || !scenario.model.equations.is_linear()
            || NOT_OPTIMAL.contains(&scenario.name.as_str())
        {
            continue;
        }
        let scores = &scenario.expected.methods["kf"];
        for variable in scenario.model.variables().iter().map(|variable| variable.0) {
            let [spread, rmse] = ["spread", "rmse"].map(|kind| scores[&format!("{kind}_analysis.{variable}")]);
            let ratio = spread / rmse;
            assert!((ratio - 1.0).abs() < 0.15, "{}: spread over error of {variable} is {ratio}", scenario.name);
        }
        checked += 1;
    }
    assert!(checked >= 2);
}

#[test]
fn estimating_the_biases_pays() {
    let mut checked = 0;
    for scenario in scenarios() {
        let expected = &scenario.expected.methods;
        // Without a truth what it is worth shows at passive observations, whose random errors are no smaller for it.
        let (score, most) = match scenario.truth {
            Some(_) => ("bias_rmse".to_string(), 0.65),
            None => (format!("passive_departure_analysis.{}", scenario.model.variables()[0].0), 0.95),
        };
        let score_of = |name: &str| expected[name].get(&score).copied();
        let ignores_biases =
            |method: &Method| method.settings.uses_observations() && method.bias == BiasTreatment::Ignore;
        let blind = methods(&scenario, ignores_biases);
        for blind in blind {
            let full = |method: &Method| {
                let is_block_of_a_cell = method.kind == "fkf" && method.describe().contains("blocks of one cell");
                method.estimates_biases() && !is_block_of_a_cell
            };
            for sighted in methods(&scenario, full) {
                let Some((with, without)) = score_of(sighted).zip(score_of(blind)) else {
                    panic!("{}: no {score}", scenario.name)
                };
                assert!(with < most * without, "{}: {sighted} {with}, {blind} {without}", scenario.name);
                checked += 1;
            }
        }
    }
    assert!(checked >= 6);
}

#[test]
fn however_a_component_is_cut_the_scores_stay_and_factors_by_energy_come_near_the_kalman_filter() {
    let scenario = scenarios().into_iter().find(|scenario| scenario.name == "dense_footprints").unwrap();
    let expected = &scenario.expected.methods;
    let scores = |name: &str| -> Vec<f64> { expected[name].values().copied().collect() };
    let difference =
        |a: &str, b: &str| scores(a).iter().zip(scores(b)).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
    // Nested elimination drops the same covariance as merging; separators keep some of it in the factors.
    assert!(difference("nested", "merged") < 1e-4);
    assert!(difference("separated", "merged") < 2e-3);
    assert!(expected["adaptive"]["rmse_analysis.h"] < 1.01 * expected["kf"]["rmse_analysis.h"]);
}
