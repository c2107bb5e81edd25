//! Columns of a method's covariance, found without the matrix, are those of the matrix.

use crate::common::*;
use isobar_assim::ensemble::EnsembleTransformKalmanFilter;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Unknown, correlation};

/// The matrix of all columns, and the greatest difference from `dense`, relative to its largest entry.
fn difference(method: &dyn Assimilator, m: usize, p: usize, dense: impl Fn(usize, usize) -> f64) -> f64 {
    let unknown = |i: usize| if i < m { Unknown::Value(i) } else { Unknown::Parameter(i - m) };
    let (mut largest, mut off) = (0.0_f64, 0.0_f64);
    for j in 0..m + p {
        let column = column(method, unknown(j)).unwrap();
        assert_eq!((column.state.len(), column.calibration.len()), (m, p));
        for i in 0..m + p {
            largest = largest.max(dense(i, j).abs());
            off = off.max((column.with(unknown(i)) - dense(i, j)).abs());
        }
    }
    off / largest
}

#[test]
fn they_are_the_columns_of_the_matrix() {
    let problem = problem(true, calibration(2, 2, 0.4), 4);
    let (m, p) = (problem.background.values().len(), problem.calibration.len());
    let cycle = |method: &mut dyn Assimilator| {
        for cycle in 1..=2 {
            let from = method.forecast(WINDOW).unwrap();
            method.analyse(&from, &window(&problem, 9, false, cycle, 3)).unwrap();
        }
    };
    // Exact forecasts keep what observations link beyond the blocks, the others do not.
    for (residual, factors) in [(Residual::Exact, 0), (Residual::Exact, 6), (Residual::Persist, 6)] {
        let settings = FastKalmanSettings { factors, residual, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
        let mut fast = FastKalmanFilter::new(problem.clone(), settings).unwrap();
        cycle(&mut fast);
        let dense = fast.dense_covariance();
        // The dense matrix has the local parameters before the shared ones only inside; outside they are as they come.
        assert!(difference(&fast, m, p, |i, j| dense[(i, j)]) < 1e-12, "{residual:?}, {factors} factors");
    }
    let mut kalman = KalmanFilter::new(problem.clone()).unwrap();
    let mut serial = KalmanFilter::serial(problem.clone()).unwrap();
    cycle(&mut kalman);
    cycle(&mut serial);
    assert_eq!(difference(&kalman, m, p, |i, j| kalman.covariance()[(i, j)]), 0.0);
    assert!(difference(&serial, m, p, |i, j| kalman.covariance()[(i, j)]) < 1e-10);
    let (a, b) = (Unknown::Value(3), Unknown::Parameter(1));
    let p_of = |i: usize, j: usize| kalman.covariance()[(i, j)];
    let expected = p_of(3, m + 1) / (p_of(3, 3) * p_of(m + 1, m + 1)).sqrt();
    assert!((correlation(&kalman, a, b).unwrap() - expected).abs() < 1e-14);
    assert!((correlation(&kalman, a, a).unwrap() - 1.0).abs() < 1e-14);
}

#[test]
fn those_of_an_ensemble_are_of_its_members() {
    let problem = problem(true, calibration(1, 1, 0.4), 4);
    let (m, p) = (problem.background.values().len(), problem.calibration.len());
    let mut filter = EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(7)).unwrap();
    let from_filter = filter.forecast(WINDOW).unwrap();
    filter.analyse(&from_filter, &window(&problem, 9, false, 1, 3)).unwrap();
    let (members, mean) = (filter.ensemble().values(), filter.ensemble().mean());
    let dense = |i: usize, j: usize| {
        (0..7).map(|k| (members[(i, k)] - mean[i]) * (members[(j, k)] - mean[j])).sum::<f64>() / 6.0
    };
    assert!(difference(&filter, m, p, dense) < 1e-12);
}
