//! The Kalman filter with a banded covariance against the dense one.

use crate::common::*;
use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::covariance::dense;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem};
use isobar_obs::{Calibration, ObservationWindow};

/// (H, R) of observations, dense.
fn operator(problem: &Problem, observed: &ObservationWindow) -> (Mat<f64>, Mat<f64>) {
    let (m, p, n) = (problem.background.values().len(), problem.calibration.len(), observed.len());
    let jacobian = observed.operator.linearize(&problem.background, &vec![0.0; p]);
    let mut h = Mat::zeros(n, m + p);
    for row in 0..n {
        jacobian.state.row(row).iter().for_each(|&(index, weight)| h[(row, index)] += weight);
        jacobian.calibration.row(row).iter().for_each(|&(number, weight)| h[(row, m + number)] += weight);
    }
    (h, Mat::from_fn(n, n, |i, j| if i == j { observed.sigma[i].powi(2) } else { 0.0 }))
}

#[test]
fn the_full_band_is_the_kalman_filter() {
    for (shared, local, drift) in [(0, 0, 0.0), (3, 0, 0.7), (3, 4, 0.7), (2, 1, 0.0)] {
        let problem = problem(true, calibration(shared, local, drift), 2);
        let (m, p) = (problem.background.values().len(), problem.calibration.len());
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        let mut banded = BandedKalmanFilter::new(problem.clone(), usize::MAX).unwrap();
        assert_eq!(banded.half_bandwidth(), m - 1);
        for cycle in 1..=8 {
            let observed = window(&problem, 14, false, cycle, 5);
            let (background, expected) = (banded.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
            let spreads = [&background, &expected].map(|it| it.estimate.state_spread.clone().unwrap());
            assert!(relative_difference(&spreads[0], &spreads[1]) < 1e-9, "cycle {cycle}");
            let (analysis, expected) =
                (banded.analyse(&background, &observed).unwrap(), reference.analyse(&expected, &observed).unwrap());
            let (found, wanted) = (&analysis.estimate, &expected.estimate);
            assert!(relative_difference(found.state.values(), wanted.state.values()) < 1e-9, "cycle {cycle}");
            assert!((analysis.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
            let found = flat(&covariance_matrix(&banded, m, p));
            assert!(relative_difference(&found, &flat(&reference.covariance().to_owned())) < 1e-9, "cycle {cycle}");
            if p > 0 {
                assert!(relative_difference(&analysis.estimate.calibration, &wanted.calibration) < 1e-9);
                let accuracies = [accuracy(&banded).unwrap(), accuracy(&reference).unwrap()];
                let [(found, _), (wanted, _)] = accuracies.map(|it| {
                    let means: Vec<f64> = it.of_means().flat_map(|(with, own)| [with, &[own]].concat()).collect();
                    (means, it)
                });
                assert!(relative_difference(&found, &wanted) < 1e-9, "cycle {cycle}");
            }
            assert_eq!(parameters(&banded)[0].value, 0.0);
        }
    }
}

/// Nothing is kept from forecast to forecast but the variances: diag(A P Aᵀ + Q), each analysis being exact.
#[test]
fn without_a_band_the_forecast_keeps_the_variances_alone() {
    let problem = problem(true, Calibration::default(), 2);
    let m = problem.background.values().len();
    let mut banded = BandedKalmanFilter::new(problem.clone(), 0).unwrap();
    let mut p = dense(&*problem.background_error);
    let q = dense(&**problem.model_error.as_ref().unwrap());
    let mut columns: Vec<f64> = flat(&Mat::identity(m, m));
    problem.model.step_tl(&problem.background, &mut columns);
    let a = faer::MatRef::from_column_major_slice(&columns, m, m);
    for cycle in 1..=5 {
        p = a * &p * a.transpose() + &q;
        p = Mat::from_fn(m, m, |i, j| if i == j { p[(i, i)] } else { 0.0 });
        let from_banded = banded.forecast(WINDOW).unwrap();
        assert!(relative_difference(&flat(&covariance_matrix(&banded, m, 0)), &flat(&p)) < 1e-12, "cycle {cycle}");
        let observed = window(&problem, 14, false, cycle, 5);
        let (h, r) = operator(&problem, &observed);
        let s = (&h * &p * h.transpose() + r).llt(Side::Lower).unwrap().inverse();
        p = &p - &p * h.transpose() * s * &h * &p;
        banded.analyse(&from_banded, &observed).unwrap();
        assert!(relative_difference(&flat(&covariance_matrix(&banded, m, 0)), &flat(&p)) < 1e-12, "cycle {cycle}");
    }
}

/// Whatever the band, the analysis is that of the covariance that the forecast has left.
#[test]
fn every_analysis_is_exact_for_the_covariance_of_its_forecast() {
    let problem = problem(true, calibration(2, 2, 0.7), 2);
    let (m, p) = (problem.background.values().len(), problem.calibration.len());
    for half_bandwidth in [0, 3, 11, 25] {
        let mut banded = BandedKalmanFilter::new(problem.clone(), half_bandwidth).unwrap();
        for cycle in 1..=6 {
            let background = banded.forecast(WINDOW).unwrap();
            let prior = covariance_matrix(&banded, m, p);
            let least = prior.self_adjoint_eigenvalues(Side::Lower).unwrap()[0];
            assert!(least > -1e-12, "half-bandwidth {half_bandwidth}, cycle {cycle}: {least:e}");
            let observed = window(&problem, 14, false, cycle, 5);
            let (h, r) = operator(&problem, &observed);
            let inverse = (&h * &prior * h.transpose() + r).llt(Side::Lower).unwrap().inverse();
            let gain = &prior * h.transpose() * &inverse;
            let analysis = banded.analyse(&background, &observed).unwrap();
            let d = Mat::from_fn(observed.len(), 1, |i, _| analysis.background_departures[i]);
            let increment = &gain * &d;
            let values = |it: &isobar_assim::Estimate| [it.state.values(), &it.calibration].concat();
            let expected: Vec<f64> =
                values(&background.estimate).iter().enumerate().map(|(i, value)| value + increment[(i, 0)]).collect();
            assert!(relative_difference(&values(&analysis.estimate), &expected) < 1e-10);
            let posterior = &prior - &gain * &h * &prior;
            assert!(relative_difference(&flat(&covariance_matrix(&banded, m, p)), &flat(&posterior)) < 1e-10);
            let spread =
                [analysis.estimate.state_spread.unwrap(), analysis.estimate.calibration_spread.unwrap()].concat();
            let expected: Vec<f64> = (0..m + p).map(|i| posterior[(i, i)].sqrt()).collect();
            assert!(relative_difference(&spread, &expected) < 1e-10);
            let chi2 = (d.transpose() * inverse * &d)[(0, 0)];
            assert!((analysis.innovation_chi2.unwrap() / chi2 - 1.0).abs() < 1e-10);
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_and_biases_may_be_known() {
    let mut problem = problem(true, calibration(2, 0, 0.2), 8);
    problem.bias = BiasTreatment::Known;
    let (mut banded, mut reference) =
        (BandedKalmanFilter::new(problem.clone(), 39).unwrap(), KalmanFilter::new(problem.clone()).unwrap());
    let observed = window(&problem, 14, false, 1, 5);
    let from_banded = banded.forecast(WINDOW).unwrap();
    let from_reference = reference.forecast(WINDOW).unwrap();
    let found = banded.analyse(&from_banded, &observed).unwrap().estimate;
    assert!(found.calibration_spread.is_none() && accuracy(&banded).is_none());
    assert!(
        relative_difference(
            found.state.values(),
            reference.analyse(&from_reference, &observed).unwrap().estimate.state.values()
        ) < 1e-9
    );
    // The same observations once more: independent of the first.
    let found = banded.analyse(&from_banded, &observed).unwrap();
    let expected = reference.analyse(&from_reference, &observed).unwrap();
    assert!(relative_difference(found.estimate.state.values(), expected.estimate.state.values()) < 1e-9);
    assert!((found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
    problem.memory_limit_bytes = 50_000;
    let error = BandedKalmanFilter::new(problem, 39).err().unwrap();
    assert!(matches!(error, Error::TooLarge { needed_bytes: 120_320, .. }), "{error}");
}
