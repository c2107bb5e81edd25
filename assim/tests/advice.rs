//! The predicted reduction of a variance is the one that an analysis achieves.

use crate::common::*;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Advice, Assimilator, Problem, Unknown};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

type Row = (Vec<(Unknown, f64)>, f64);

/// The rows of a window as combinations of unknowns, with error variances.
fn rows(problem: &Problem, window: &ObservationWindow) -> Vec<Row> {
    let bias = vec![0.0; problem.calibration.len()];
    let Jacobian { state, calibration } = window.operator.linearize(&problem.background, &bias);
    let row = |row: usize| {
        let of_state = state.row(row).iter().map(|&(number, weight)| (Unknown::Value(number), weight));
        let of_biases = calibration.row(row).iter().map(|&(number, weight)| (Unknown::Parameter(number), weight));
        (of_state.chain(of_biases).collect(), window.sigma[row].powi(2))
    };
    (0..window.len()).map(row).collect()
}

/// The observations of a window with these numbers.
fn part(window: &ObservationWindow, problem: &Problem, numbers: &[usize]) -> ObservationWindow {
    let bias = vec![0.0; problem.calibration.len()];
    let all = window.operator.linearize(&problem.background, &bias);
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for &number in numbers {
        state.push_row(all.state.row(number).iter().copied());
        calibration.push_row(all.calibration.row(number).iter().copied());
    }
    let pick = |values: &[f64]| numbers.iter().map(|&number| values[number]).collect::<Vec<f64>>();
    ObservationWindow {
        reports: numbers.iter().map(|&number| window.reports[number].clone()).collect(),
        times: numbers.iter().map(|&number| window.times[number]).collect(),
        values: pick(&window.values),
        sigma: pick(&window.sigma),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
        ..window.clone()
    }
}

fn variance(method: &dyn Assimilator, functional: &[(Unknown, f64)]) -> f64 {
    Advice::new(method.can().joint_errors.unwrap(), functional).unwrap().variance()
}

/// The predicted reduction is the difference of vᵀ P v before and after an analysis of one observation, or of several together.
#[test]
fn the_reduction_is_that_of_an_analysis_with_the_observations() {
    let problem = problem(true, calibration(2, 2, 0.4), 4);
    let functional = [(Unknown::Value(3), 0.7), (Unknown::Value(22), -0.4), (Unknown::Parameter(1), 0.5)];
    let bias = [(Unknown::Parameter(0), 1.0)];
    let fast = |factors: usize| {
        let settings = FastKalmanSettings { factors, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
        FastKalmanFilter::new(problem.clone(), settings).unwrap()
    };
    let methods: [(&str, Box<dyn Assimilator>); 3] = [
        ("kf", Box::new(KalmanFilter::new(problem.clone()).unwrap())),
        ("serial", Box::new(KalmanFilter::serial(problem.clone()).unwrap())),
        ("fkf", Box::new(fast(6))),
    ];
    for (name, mut method) in methods {
        for cycle in 1..=2 {
            let from = method.forecast(WINDOW).unwrap();
            method.analyse(&from, &window(&problem, 9, false, cycle, 3)).unwrap();
        }
        let from = method.forecast(WINDOW).unwrap();
        let next = window(&problem, 9, false, 3, 3);
        let rows = rows(&problem, &next);
        for numbers in [&[0][..], &[4], &[7], &[1, 2, 8], &[0, 1, 2, 3, 4, 5, 6, 7, 8]] {
            for functional in [&functional[..], &bias] {
                let errors = method.can().joint_errors.unwrap();
                let advice = Advice::new(errors, functional).unwrap();
                let proposed: Vec<Row> = numbers.iter().map(|&number| rows[number].clone()).collect();
                let said = advice.reduction(&proposed).unwrap().unwrap();
                let mut with_it = method.boxed_clone();
                with_it.analyse(&from, &part(&next, &problem, numbers)).unwrap();
                let before = advice.variance();
                let found = before - variance(&*with_it, functional);
                assert!(said >= 0.0 && (said - found).abs() < 1e-9 * before, "{name}, {numbers:?}: {said}, {found}");
            }
        }
    }
}

/// aᵀ P b without a column of P is that with one.
#[test]
fn covariances_of_combinations_are_those_of_columns() {
    let problem = problem(true, calibration(2, 2, 0.4), 4);
    let a = [(Unknown::Value(3), 0.7), (Unknown::Value(23), 2.0), (Unknown::Parameter(1), 0.5)];
    let b = [(Unknown::Value(3), -0.2), (Unknown::Parameter(0), 1.0), (Unknown::Parameter(2), -1.0)];
    for residual in [Residual::Exact, Residual::Persist] {
        let settings = FastKalmanSettings { factors: 6, residual, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
        let mut method = FastKalmanFilter::new(problem.clone(), settings).unwrap();
        let from = method.forecast(WINDOW).unwrap();
        method.analyse(&from, &window(&problem, 9, false, 1, 3)).unwrap();
        let errors = method.can().joint_errors.unwrap();
        let mut by_columns = 0.0;
        for &(unknown, weight) in &a {
            by_columns += weight * errors.covariance_column(unknown).unwrap().with_combination(&b);
        }
        let with_product = errors.covariance_with(&a).unwrap().with_combination(&b);
        let between = errors.covariance_between(&a, &b).unwrap();
        assert!((by_columns - with_product).abs() < 1e-12 && (by_columns - between).abs() < 1e-12, "{residual:?}");
        let swapped = errors.covariance_between(&b, &a).unwrap();
        assert!((between - swapped).abs() < 1e-12);
        assert!(errors.covariance_between(&a, &[(Unknown::Parameter(9), 1.0)]).is_none());
        assert!(
            errors.covariance_with(&[]).is_none() && errors.covariance_with(&[(Unknown::Value(400), 1.0)]).is_none()
        );
    }
}

/// An exact observation of the functional removes all of its variance; an observation of something known exactly removes none.
#[test]
fn exact_knowledge_has_no_reduction() {
    let problem = problem(false, calibration(1, 0, 0.0), 4);
    let mut method = KalmanFilter::new(problem.clone()).unwrap();
    method.forecast(WINDOW).unwrap();
    let errors = method.can().joint_errors.unwrap();
    let value = vec![(Unknown::Value(3), 1.0)];
    let advice = Advice::new(errors, &value).unwrap();
    let exact = advice.reduction(&[(value, 0.0)]).unwrap().unwrap();
    assert!((exact / advice.variance() - 1.0).abs() < 1e-14);
    let difference = vec![(Unknown::Value(3), 1.0), (Unknown::Value(3), -1.0)];
    assert_eq!(advice.reduction(&[(difference, 0.0)]).unwrap(), Some(0.0));
    assert_eq!(advice.reduction(&[]).unwrap(), Some(0.0));
    assert!(Advice::new(errors, &[(Unknown::Parameter(7), 1.0)]).is_none());
}
