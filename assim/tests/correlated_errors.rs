//! Observations whose errors are correlated within reports: every method solves the same least-squares problem as with
//! independent errors, with the full R.

use crate::common::*;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_assim::actual_errors::ActualErrors;
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::ensemble::EnsembleTransformKalmanFilter;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedKalmanFilter, FederatedSettings};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::response::Responder;
use isobar_assim::variational::{FourDVar, FourDVarSettings, ThreeDVar, ThreeDVarSettings};
use isobar_assim::{
    AdaptedCovariance, Adaptive, AdaptiveSettings, Analysis, Assimilator, Background, Problem, Whitened,
};
use isobar_obs::{ErrorRegression, ObservationWindow};
use std::collections::HashSet;
use std::sync::Arc;

/// The first six observations are a scan line, the next five a report whose errors all depend on each other, the last three
/// stand alone.
fn regression() -> ErrorRegression {
    let mut regression = ErrorRegression::default();
    regression.push([], 1.0);
    (1..6).for_each(|row| regression.push([(row - 1, 0.8)], 1.0 - 0.64));
    regression.push([], 1.0);
    for row in 7..11 {
        regression.push((6..row).map(|before| (before, 0.7 / (row - 6) as f64)), 0.4);
    }
    (11..14).for_each(|_| regression.push([], 1.0));
    regression
}

fn correlated(problem: &Problem, cycle: usize) -> ObservationWindow {
    ObservationWindow { error_regression: regression(), ..window(problem, 14, false, cycle, 5) }
}

/// The dense solution: δs = P Hᵀ S⁻¹ d, P − P Hᵀ S⁻¹ H P and dᵀ S⁻¹ d, with S = H P Hᵀ + R.
struct Solution {
    increment: Vec<f64>,
    covariance: Mat<f64>,
    chi2: f64,
}

fn dense(p: &Mat<f64>, from: &Background, observed: &ObservationWindow) -> Solution {
    let (n, h) = (observed.len(), dense_jacobian(observed, &from.estimate));
    let r = observed.error_regression.covariance(&observed.sigma);
    let cross = p * h.transpose();
    let s = &h * &cross + Mat::from_fn(n, n, |i, j| r[i][j]);
    let simulated = observed.operator.simulate(&from.estimate.state, &from.estimate.calibration);
    let d = Mat::from_fn(n, 1, |i, _| observed.values[i] - simulated[i]);
    let factor = s.llt(Side::Lower).unwrap();
    let w = factor.solve(&d);
    let increment = &cross * &w;
    let covariance = p - &cross * factor.solve(cross.transpose().to_owned());
    Solution { increment: increment.col_as_slice(0).to_vec(), covariance, chi2: (d.transpose() * w)[(0, 0)] }
}

/// The covariance of the errors of (x, c) that a method claims.
fn claimed(method: &dyn Assimilator, problem: &Problem) -> Mat<f64> {
    covariance_matrix(method, problem.background.values().len(), problem.calibration.len())
}

/// Largest relative difference of an analysis from the dense solution, in increment, χ² and departures.
fn difference(from: &Background, observed: &ObservationWindow, analysis: &Analysis, expected: &Solution) -> f64 {
    let (before, after) = (&from.estimate, &analysis.estimate);
    let increment: Vec<f64> = after.state.values().iter().chain(&after.calibration).copied().collect();
    let background: Vec<f64> = before.state.values().iter().chain(&before.calibration).copied().collect();
    let increment: Vec<f64> = increment.iter().zip(background).map(|(a, b)| a - b).collect();
    let departures = |estimate: &isobar_assim::Estimate| -> Vec<f64> {
        let simulated = observed.operator.simulate(&estimate.state, &estimate.calibration);
        observed.values.iter().zip(simulated).map(|(value, simulated)| value - simulated).collect()
    };
    let chi2 = analysis.innovation_chi2.map_or(0.0, |chi2| (chi2 / expected.chi2 - 1.0).abs());
    relative_difference(&increment, &expected.increment)
        .max(chi2)
        .max(relative_difference(&analysis.background_departures, &departures(before)))
        .max(relative_difference(&analysis.analysis_departures, &departures(after)))
}

#[test]
fn filters_equal_the_dense_solution_with_the_full_matrix() {
    for (shared, local) in [(0, 0), (3, 4)] {
        let mut problem = problem(true, calibration(shared, local, 0.7), 2);
        problem.calibration.parameters.iter_mut().for_each(|it| it.name = format!("n/{}", it.name));
        let own = || problem.clone();
        let system = FederatedSettings { systems: vec![("n".into(), 1.0)], reset_every_cycles: Some(1) };
        let one_block = settings(BlockShape::Domain, BiasCoupling::Carry);
        let m = problem.background.values().len();
        let all_factors = isobar_assim::fast_kalman::FastKalmanSettings {
            factors: m,
            ..settings(BlockShape::Cell, BiasCoupling::Carry)
        };
        let methods: Vec<(&str, Box<dyn Assimilator>)> = vec![
            ("kf", Box::new(KalmanFilter::new(own()).unwrap())),
            ("serial", Box::new(KalmanFilter::serial(own()).unwrap())),
            ("fkf of one block", Box::new(FastKalmanFilter::new(own(), one_block).unwrap())),
            ("fkf of cells", Box::new(FastKalmanFilter::new(own(), all_factors).unwrap())),
            ("banded", Box::new(BandedKalmanFilter::new(own(), m - 1).unwrap())),
            ("federated", Box::new(FederatedKalmanFilter::new(own(), system.clone()).unwrap())),
            (
                "federated of one block",
                Box::new(FederatedFastKalmanFilter::of_fast_filters(own(), system, one_block).unwrap()),
            ),
        ];
        for (name, method) in methods {
            let mut method = Whitened::new(method);
            let mut largest: f64 = 0.0;
            for cycle in 1..=6 {
                let from = method.forecast(WINDOW).unwrap();
                let observed = correlated(&problem, cycle);
                let expected = dense(&claimed(&method, &problem), &from, &observed);
                let analysis = method.analyse(&from, &observed).unwrap();
                let after = relative_difference(&flat(&claimed(&method, &problem)), &flat(&expected.covariance));
                // Cells with factors lose a little in the next forecast, not in the analysis.
                largest = largest.max(difference(&from, &observed, &analysis, &expected)).max(after);
            }
            println!("{name} with {shared} shared and {local} local biases: {largest:.1e}");
            assert!(largest < 1e-8, "{name}, {shared} shared, {local} local: {largest:e}");
        }
    }
}

/// The first analysis of methods with a static covariance, and of an ensemble that holds all of the covariance.
#[test]
fn methods_without_a_covariance_of_their_own_equal_it_too() {
    let problem = problem(true, calibration(3, 0, 0.0), 2);
    let own = || problem.clone();
    let (m, p) = (problem.background.values().len(), 3);
    let three = ThreeDVarSettings { covariance_scale: 0.7, tolerance: 1e-13, max_iterations: 500 };
    let four = FourDVarSettings {
        window_cycles: 1,
        covariance_scale: 0.7,
        outer_loops: 2,
        tolerance: 1e-13,
        max_iterations: 500,
    };
    let mut statics = Mat::<f64>::zeros(m + p, m + p);
    (0..m).for_each(|i| statics[(i, i)] = 0.7 * problem.background_error.covariance(i, i));
    (0..p).for_each(|i| statics[(m + i, m + i)] = problem.calibration.parameters[i].sigma_prior.powi(2));
    // That of a strong constraint, A B Aᵀ.
    let a = ActualErrors::propagator(&*problem.model, &problem.background, 1).unwrap();
    let mut propagated = statics.clone();
    propagated
        .as_mut()
        .submatrix_mut(0, 0, m, m)
        .copy_from(&(&a * statics.as_ref().submatrix(0, 0, m, m) * a.transpose()));
    let kalman = {
        let mut kalman = KalmanFilter::new(own()).unwrap();
        kalman.forecast(WINDOW).unwrap();
        kalman.covariance().to_owned()
    };
    let members = ensemble_settings(m + p + 1);
    let methods: Vec<(&str, Box<dyn Assimilator>, &Mat<f64>)> = vec![
        ("oi", Box::new(OptimalInterpolation::new(own(), 0.7).unwrap()), &statics),
        ("3dvar", Box::new(ThreeDVar::new(own(), three).unwrap()), &statics),
        ("4dvar", Box::new(FourDVar::new(own(), four).unwrap()), &propagated),
        ("etkf", Box::new(EnsembleTransformKalmanFilter::new(own(), members).unwrap()), &kalman),
    ];
    for (name, method, covariance) in methods {
        let mut method = Whitened::new(method);
        let from = method.forecast(WINDOW).unwrap();
        let observed = correlated(&problem, 1);
        let analysis = method.analyse(&from, &observed).unwrap();
        let found = difference(&from, &observed, &analysis, &dense(covariance, &from, &observed));
        println!("{name}: {found:.1e}");
        assert!(found < 1e-7, "{name}: {found:e}");
    }
}

/// Ignoring a strong correlation changes the analysis. Windows with independent errors give the same analysis to the bit.
#[test]
fn a_correlation_changes_the_analysis_and_independence_changes_nothing() {
    let problem = problem(true, calibration(2, 1, 0.7), 2);
    let analysis = |method: &mut dyn Assimilator, observed: &ObservationWindow| {
        let from = method.forecast(WINDOW).unwrap();
        method.analyse(&from, observed).unwrap()
    };
    let kalman = || Box::new(KalmanFilter::new(problem.clone()).unwrap());
    let (with, without) = (correlated(&problem, 1), window(&problem, 14, false, 1, 5));
    let ignored = analysis(&mut *kalman(), &with);
    let known = analysis(&mut Whitened::new(kalman()), &with);
    assert!(relative_difference(ignored.estimate.state.values(), known.estimate.state.values()) > 0.05);
    let plain = analysis(&mut *kalman(), &without);
    let wrapped = analysis(&mut Whitened::new(kalman()), &without);
    assert_eq!(plain.estimate, wrapped.estimate);
    assert_eq!(plain.background_departures, wrapped.background_departures);
    assert_eq!(plain.innovation_chi2, wrapped.innovation_chi2);
    assert_eq!(ignored.estimate, plain.estimate);
}

/// The factor on a type's R scales it with its correlations: with factors of 1 it stays the method, and its verdicts are those of
/// the whitened innovations, in which two methods that see the same R agree.
#[test]
fn adapted_errors_keep_their_correlations() {
    let problem = problem(true, calibration(2, 0, 0.7), 2);
    let settings = AdaptiveSettings {
        observation_error: true,
        state_error: Some(AdaptedCovariance {
            name: "model_error",
            covariance: Arc::clone(problem.model_error.as_ref().unwrap()),
            scale: 1.0,
        }),
        memory_cycles: 10,
    };
    let around = |method: Box<dyn Assimilator>| {
        let layout = problem.background.layout().clone();
        Whitened::new(Box::new(Adaptive::new(method, layout, settings.clone()).unwrap()))
    };
    let mut methods = [
        around(Box::new(KalmanFilter::new(problem.clone()).unwrap())),
        around(Box::new(KalmanFilter::serial(problem.clone()).unwrap())),
    ];
    for cycle in 1..=5 {
        let [a, b] = methods.each_mut().map(|method| {
            let from = method.forecast(WINDOW).unwrap();
            method.analyse(&from, &correlated(&problem, cycle)).unwrap().estimate
        });
        assert!(relative_difference(a.state.values(), b.state.values()) < 1e-9);
    }
    let [a, b] = methods.each_ref().map(|method| parameters(method));
    assert!(a.len() == 2 && (a[1].value - 1.0).abs() > 0.05, "{a:?}");
    assert!(a.iter().zip(&b).all(|(a, b)| (a.value / b.value - 1.0).abs() < 1e-8), "{a:?} {b:?}");
}

/// In a world with the full R, gains that know it have the errors that they claim; others have larger errors, and claim wrong
/// ones.
#[test]
fn gains_with_the_full_matrix_have_the_errors_that_they_claim_and_others_larger_ones() {
    let problem = problem(true, calibration(3, 0, 0.5), 2);
    let parameters = &problem.calibration.parameters;
    let variance: Vec<f64> = parameters.iter().map(|it| it.sigma_prior.powi(2)).collect();
    let kept = problem.calibration.kept(WINDOW);
    let added: Vec<f64> = parameters.iter().map(|it| it.drift.added_variance(WINDOW)).collect();
    let a = ActualErrors::propagator(&*problem.model, &problem.background, 1).unwrap();
    let q = isobar_assim::covariance::dense(&**problem.model_error.as_ref().unwrap());
    let b = isobar_assim::covariance::dense(&*problem.background_error);
    let kalman = || Box::new(KalmanFilter::new(problem.clone()).unwrap());
    let methods: [Box<dyn Assimilator>; 2] = [Box::new(Whitened::new(kalman())), kalman()];
    let [known, ignored] = methods.map(|mut method| {
        let mut actual = ActualErrors::new(b.as_ref(), &[0.0; 3], &variance);
        for cycle in 1..=6 {
            let observed = correlated(&problem, cycle);
            let background = method.forecast(WINDOW).unwrap();
            actual.forecast(a.as_ref(), Some(q.as_ref()), &kept, &added, &[0.0; 3]);
            let gain = Responder::new(&*method, &background, &observed).gain().unwrap();
            method.analyse(&background, &observed).unwrap();
            let jacobian = observed.operator.linearize(&problem.background, &[0.0; 3]);
            let error_covariance = observed.error_regression.covariance(&observed.sigma);
            actual.analyse(&gain, &jacobian, &error_covariance, true);
        }
        let claimed = claimed(&*method, &problem);
        (actual.mean_squares(), (0..claimed.nrows()).map(|i| claimed[(i, i)]).collect::<Vec<f64>>())
    });
    assert!(relative_difference(&known.0, &known.1) < 1e-9);
    let sum = |values: &[f64]| values.iter().sum::<f64>();
    println!(
        "ignored: actual {:.4} of known, claimed {:.4}",
        sum(&ignored.0) / sum(&known.0),
        sum(&ignored.1) / sum(&known.0)
    );
    assert!(sum(&ignored.0) > 1.1 * sum(&known.0) && (sum(&ignored.1) / sum(&ignored.0) - 1.0).abs() > 0.02);
}

/// For viewers a report links the blocks that its observations read.
#[test]
fn a_report_links_blocks() {
    let problem = problem(false, calibration(0, 0, 0.0), 3);
    let parts = |observed: &ObservationWindow| {
        let blocks = FastKalmanFilter::new(problem.clone(), settings(BlockShape::Cell, BiasCoupling::Carry)).unwrap();
        let mut method = Whitened::new(Box::new(blocks));
        let from = method.forecast(WINDOW).unwrap();
        method.analyse(&from, observed).unwrap();
        let structure = method.can().blocks.unwrap().structure(observed, 0);
        structure.part_of_cell.into_iter().collect::<HashSet<_>>().len()
    };
    let independent = window(&problem, 14, true, 1, 5);
    let linked = ObservationWindow { error_regression: regression(), ..independent.clone() };
    assert_eq!(parts(&independent), 20);
    assert!(parts(&linked) <= 20 - 4, "{}", parts(&linked));
}
