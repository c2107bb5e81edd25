//! Factors stored and forecast in single precision: the filter in double precision but for some 2⁻²⁴ of each step of a factor's
//! forecast, and wherever a factor is written.

use crate::common::*;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::time_volume::{Target, TimeShape, TimeVolume};
use isobar_assim::{Assimilator, Error, Estimate, Problem};

fn filter(problem: &Problem, factors: usize, residual: Residual, factor_precision: Precision) -> FastKalmanFilter {
    let settings =
        FastKalmanSettings { factors, residual, factor_precision, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
    FastKalmanFilter::new(problem.clone(), settings).unwrap()
}

/// As many factors as variables: the Kalman filter, up to what is rounded away in a cycle and amplified by none.
#[test]
fn as_many_factors_as_variables_are_the_kalman_filter_to_single_precision() {
    for (shared, local) in [(0, 0), (2, 0), (2, 3)] {
        let problem = problem(true, calibration(shared, local, 0.4), 2);
        let variables = problem.background.values().len() + local;
        for residual in [Residual::Exact, Residual::Persist] {
            let mut fast = filter(&problem, variables, residual, Precision::Single);
            let mut reference = KalmanFilter::new(problem.clone()).unwrap();
            let mut largest: f64 = 0.0;
            for cycle in 1..=6 {
                let observed = window(&problem, 14, false, cycle, 5);
                let from_fast = fast.forecast(WINDOW).unwrap();
                let from_reference = reference.forecast(WINDOW).unwrap();
                let found = fast.analyse(&from_fast, &observed).unwrap().estimate;
                let expected = reference.analyse(&from_reference, &observed).unwrap().estimate;
                let expected_covariance = flat(&reference.covariance().to_owned());
                let covariance = relative_difference(&flat(&fast.dense_covariance()), &expected_covariance);
                let state = relative_difference(found.state.values(), expected.state.values());
                largest = largest.max(covariance).max(state);
            }
            println!("{shared} shared, {local} local, {residual:?}: {largest:e}");
            assert!(largest < 2e-6, "{shared} shared, {local} local, {residual:?}: {largest:e}");
        }
    }
}

fn cycles(mut filter: FastKalmanFilter, problem: &Problem) -> Vec<Estimate> {
    let cycle = |cycle: usize| {
        let from_filter = filter.forecast(WINDOW).unwrap();
        filter.analyse(&from_filter, &around(problem, cycle)).unwrap().estimate
    };
    (1..=5).map(cycle).collect()
}

/// The largest difference of two estimates, of values and of claimed standard deviations, in the largest standard deviation
/// of the variable, and in that of the bias.
fn difference(found: &Estimate, expected: &Estimate) -> f64 {
    let largest = |values: &[f64]| values.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
    let apart = |a: &[f64], b: &[f64]| largest(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>());
    let of = |estimate: &Estimate| {
        let Estimate { state, calibration, state_spread, calibration_spread } = estimate.clone();
        [state.values().to_vec(), state_spread.unwrap(), calibration, calibration_spread.unwrap()]
    };
    let ([state, spread, bias, bias_spread], [own_state, own_spread, own_bias, own_bias_spread]) =
        (of(expected), of(found));
    let cells = expected.state.layout().grid.cells();
    let of_variable = (0..3).map(|variable| {
        let part = variable * cells..(variable + 1) * cells;
        let sigma = largest(&spread[part.clone()]);
        let of_values = apart(&own_state[part.clone()], &state[part.clone()]);
        of_values.max(apart(&own_spread[part.clone()], &spread[part])) / sigma
    });
    let of_bias = apart(&own_bias, &bias).max(apart(&own_bias_spread, &bias_spread)) / largest(&bias_spread);
    of_variable.fold(of_bias, f64::max)
}

#[test]
fn a_nonlinear_run_is_that_in_double_precision_but_for_rounding() {
    let problem = jet_problem(16);
    for grid in [1, 2] {
        let [found, expected] = [Precision::Single, Precision::Double].map(|precision| {
            let filter = filter(&problem, 30, Residual::Probe { count: 4 }, precision);
            let on_grid =
                |filter: FastKalmanFilter| filter.with_factors_on(channel_jet(16 / grid, 600 * grid as i64).0).unwrap();
            cycles(if grid > 1 { on_grid(filter) } else { filter }, &problem)
        });
        for (cycle, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let difference = difference(found, expected);
            println!("grid {grid}, cycle {cycle}: {difference:e}");
            assert!(0.0 < difference && difference < 2e-5, "grid {grid}, cycle {cycle}: {difference:e}");
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_after_an_interruption() {
    let problem = jet_problem(12);
    let new = || filter(&problem, 14, Residual::Probe { count: 3 }, Precision::Single);
    let run = |threads: usize, interrupted: bool| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut filter = new();
            let mut bits = Vec::new();
            for cycle in 1..=4 {
                let from_filter = filter.forecast(WINDOW).unwrap();
                let estimate = filter.analyse(&from_filter, &around(&problem, cycle)).unwrap().estimate;
                bits.extend(estimate.state.values().iter().map(|value| value.to_bits()));
                bits.extend(estimate.state_spread.unwrap().iter().map(|value| value.to_bits()));
                if interrupted {
                    let saved = filter.memory().unwrap();
                    filter = new();
                    filter.recall(&mut &saved[..]).unwrap();
                }
            }
            bits
        })
    };
    let expected = run(1, false);
    assert_eq!(run(2, false), expected);
    assert_eq!(run(8, true), expected);
    let mut double = filter(&problem, 14, Residual::Probe { count: 3 }, Precision::Double);
    assert!(matches!(double.recall(&mut &new().memory().unwrap()[..]), Err(Error::Memory { .. })));
}

#[test]
fn factors_in_single_precision_fit_where_those_in_double_do_not() {
    let mut problem = jet_problem(16);
    let variables = problem.background.values().len() + 3;
    // Blocks of three variables and of those with a station's bias; F_Q and Φ with two shared biases and oversampling.
    let factors = 100;
    problem.memory_limit_bytes = (variables * (3 * 3 * 8 + (2 * factors + 2 + 10) * 6)) as u64;
    let new = |factor_precision| {
        let residual = Residual::Probe { count: 4 };
        let settings = FastKalmanSettings {
            factors,
            residual,
            factor_precision,
            ..settings(BlockShape::Cell, BiasCoupling::Carry)
        };
        FastKalmanFilter::new(problem.clone(), settings)
    };
    assert!(new(Precision::Single).is_ok());
    assert!(matches!(new(Precision::Double), Err(Error::TooLarge { .. })));
}

#[test]
fn a_time_volume_wants_double_precision() {
    let problem = problem(true, calibration(2, 0, 0.0), 2);
    let mut settings =
        volume_settings(3, vec![factor("offset", Target::Observations(vec![0]), TimeShape::Constant, constant(None))]);
    settings.filter.factor_precision = Precision::Single;
    let error = TimeVolume::new(problem, settings, None).err().unwrap().to_string();
    assert!(error.contains("double precision"), "{error}");
}
