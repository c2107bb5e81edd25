//! The Kalman filter with the whole covariance, in either form of its analysis.

use crate::common::*;
use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Error, Problem, covariance};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Grid, Layout, State};
use std::sync::Arc;

/// The filter that takes in all observations at once, and the one that takes in one after the other.
const DENSE: [fn(Problem) -> Result<KalmanFilter, Error>; 2] = [KalmanFilter::new, KalmanFilter::serial];

/// Observations so accurate that what they leave is near the rounding of what was there.
#[test]
fn serial_updates_stay_positive_under_nearly_perfect_observations() {
    let problem = problem(true, calibration(3, 0, 0.0), 2);
    let mut serial = KalmanFilter::serial(problem.clone()).unwrap();
    for cycle in 1..=20 {
        let from_serial = serial.forecast(WINDOW).unwrap();
        let mut observed = window(&problem, 60, false, cycle, 5);
        observed.sigma.fill(1e-7);
        // Of one state, for such observations must not contradict each other.
        let layout = problem.background.layout();
        let state = State::from_values(layout, standard_normals(&mut stream(cycle as u64, "state"), layout.len()));
        observed.values = observed.operator.simulate(&state, &[0.0; 3]);
        serial.analyse(&from_serial, &observed).unwrap();
        let eigenvalues = serial.covariance().self_adjoint_eigenvalues(Side::Lower).unwrap();
        let (least, largest) = (eigenvalues[0], eigenvalues[eigenvalues.len() - 1]);
        assert!(least > -1e-15 * largest.max(1.0), "cycle {cycle}: {least:e} beside {largest:e}");
    }
}

#[test]
fn gain_form_equals_regression_form_of_the_kalman_filter() {
    let problem = problem(true, calibration(2, 1, 0.3), 8);
    let mut filter = KalmanFilter::new(problem.clone()).unwrap();
    let background = filter.forecast(WINDOW).unwrap();
    let p = filter.covariance().to_owned();
    let observed = window(&problem, 20, false, 1, 9);
    let h = dense_jacobian(&observed, &background.estimate);
    // Cov = (H' R⁻¹ H + P⁻¹)⁻¹, δ = Cov H' R⁻¹ d: eqs. (12)–(14) of WO 93/22625.
    let weighted = Mat::from_fn(20, p.nrows(), |i, j| h[(i, j)] / observed.sigma[i].powi(2));
    let information = p.llt(Side::Lower).unwrap().inverse() + h.transpose() * &weighted;
    let covariance = information.llt(Side::Lower).unwrap().inverse();
    let analysis = filter.analyse(&background, &observed).unwrap();
    let d = Mat::from_fn(20, 1, |i, _| analysis.background_departures[i]);
    let increment = &covariance * (weighted.transpose() * d);
    let found: Vec<f64> = (&analysis.estimate.state - &background.estimate.state)
        .values()
        .iter()
        .copied()
        .chain(analysis.estimate.calibration.iter().zip(&background.estimate.calibration).map(|(a, b)| a - b))
        .collect();
    assert!(relative_difference(&found, increment.col_as_slice(0)) < 1e-10);
    assert!(relative_difference(&flat(&filter.covariance().to_owned()), &flat(&covariance)) < 1e-10);
}

/// A problem with more unknowns than one thread takes at a time and than a band of the covariance has; the tests add more
/// observations than are taken in between two updates of the covariance.
fn large_problem() -> Problem {
    let mut problem = problem(true, calibration(2, 3, 0.2), 8);
    let grid = Grid { nx: 16, ny: 12, ..problem.background.layout().grid.clone() };
    let layout = Arc::new(Layout { grid, ..(**problem.background.layout()).clone() });
    problem.model = Arc::new(model(&layout, true, 8));
    problem.background = State::zeros(&layout);
    problem.background_error = white(&layout, 1.5);
    problem.model_error = Some(white(&layout, 0.4));
    problem
}

#[test]
fn dense_updates_are_the_same_bits_on_any_number_of_threads() {
    let problem = large_problem();
    for build in DENSE {
        let run = |threads: usize| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
                let mut filter = build(problem.clone()).unwrap();
                let from_filter = filter.forecast(WINDOW).unwrap();
                filter.analyse(&from_filter, &window(&problem, 150, false, 1, 6)).unwrap();
                flat(&filter.covariance().to_owned()).iter().map(|value| value.to_bits()).collect::<Vec<_>>()
            })
        };
        assert_eq!(run(1), run(2));
        assert_eq!(run(1), run(8));
    }
}

/// P ← A P Aᵀ + Q and P ← P − P Hᵀ (H P Hᵀ + R)⁻¹ H P, written as dense algebra.
#[test]
fn forecast_and_analysis_in_place_are_those_of_dense_algebra() {
    let problem = large_problem();
    for build in DENSE {
        let mut filter = build(problem.clone()).unwrap();
        let m = problem.background.values().len();
        let (size, kept) = (filter.covariance().nrows(), problem.calibration.kept(WINDOW));
        let mut columns = Mat::<f64>::identity(m, m);
        (0..m).for_each(|j| problem.model.step_tl(&problem.background, columns.col_as_slice_mut(j)));
        let a = Mat::from_fn(size, size, |i, j| match (i < m, j < m) {
            (true, true) => columns[(i, j)],
            (false, false) if i == j => kept[i - m],
            _ => 0.0,
        });
        for cycle in 1..=2 {
            let mut expected = &a * filter.covariance() * a.transpose();
            let q = covariance::dense(problem.model_error.as_deref().unwrap());
            let mut of_state = expected.as_mut().get_mut(..m, ..m);
            of_state += q;
            for (i, parameter) in problem.calibration.parameters.iter().enumerate() {
                expected[(m + i, m + i)] += parameter.drift.added_variance(WINDOW);
            }
            let from_filter = filter.forecast(WINDOW).unwrap();
            let difference = (filter.covariance() - &expected).norm_max() / expected.norm_max();
            assert!(difference < 1e-13, "forecast {cycle}: {difference:e}");
            let observed = window(&problem, 150, false, cycle, 6);
            let h = dense_jacobian(&observed, &from_filter.estimate);
            let cross = &expected * h.transpose();
            let mut innovation = &h * &cross;
            (0..observed.len()).for_each(|row| innovation[(row, row)] += observed.sigma[row].powi(2));
            expected -= &cross * innovation.llt(Side::Lower).unwrap().solve(cross.transpose());
            filter.analyse(&from_filter, &observed).unwrap();
            let difference = (filter.covariance() - &expected).norm_max() / expected.norm_max();
            assert!(difference < 1e-12, "analysis {cycle}: {difference:e}");
        }
    }
}

#[test]
fn an_observation_that_is_not_finite_is_named() {
    let problem = problem(true, calibration(1, 0, 0.0), 8);
    let filters: [Box<dyn Assimilator>; 2] = [
        Box::new(KalmanFilter::new(problem.clone()).unwrap()),
        Box::new(KalmanFilter::serial(problem.clone()).unwrap()),
    ];
    for mut filter in filters {
        let from_filter = filter.forecast(WINDOW).unwrap();
        let mut observed = window(&problem, 3, false, 1, 6);
        observed.values[1] = f64::NAN;
        assert_eq!(
            filter.analyse(&from_filter, &observed).unwrap_err().to_string(),
            "the innovation of n/p is not finite"
        );
    }
}

/// Without variance in state and observation there is nothing to divide by.
#[test]
fn an_observation_of_what_is_known_without_error_is_refused() {
    let mut problem = problem(true, calibration(0, 0, 0.0), 8);
    (problem.background_error, problem.model_error) = (white(problem.background.layout(), 0.0), None);
    let mut filter = KalmanFilter::serial(problem.clone()).unwrap();
    let from_filter = filter.forecast(WINDOW).unwrap();
    let mut observed = window(&problem, 3, false, 1, 6);
    observed.sigma[2] = 0.0;
    let error = filter.analyse(&from_filter, &observed).unwrap_err();
    assert!(matches!(error, Error::NotPositiveDefinite { pivot: 2, size: 3, .. }), "{error}");
}
