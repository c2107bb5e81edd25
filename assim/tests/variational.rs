//! Variational methods and optimal interpolation against the Kalman filter and each other, on a small linear problem.

use crate::common::*;
use isobar_assim::ensemble::{
    EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers, LocalSettings, ModelErrorTreatment,
};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::variational::{
    FourDVar, FourDVarSettings, HybridSettings, HybridThreeDVar, ThreeDVar, ThreeDVarSettings,
};
use isobar_assim::{Assimilator, BiasTreatment, Estimate, Problem};

const TO_ROUNDING: ThreeDVarSettings =
    ThreeDVarSettings { covariance_scale: 0.4, tolerance: 1e-13, max_iterations: 500 };

fn four_d_var(window_cycles: usize, outer_loops: usize) -> FourDVarSettings {
    FourDVarSettings { window_cycles, covariance_scale: 1.0, outer_loops, tolerance: 1e-13, max_iterations: 500 }
}

/// Largest relative difference of two estimates, with the claims on biases.
fn difference(a: &Estimate, b: &Estimate) -> f64 {
    let mut largest = relative_difference(a.state.values(), b.state.values());
    if let (Some(own), Some(other)) = (&a.calibration_spread, &b.calibration_spread) {
        largest = largest.max(relative_difference(own, other)).max(relative_difference(&a.calibration, &b.calibration));
    }
    largest
}

/// Without model error the Kalman smoother's trajectory is one of the model, and its end the Kalman filter's analysis.
#[test]
fn four_d_var_is_the_kalman_smoother_of_a_perfect_linear_model() {
    for (calibration, outer_loops) in
        [(calibration(0, 0, 0.0), 1), (calibration(3, 2, 0.0), 1), (calibration(2, 0, 0.0), 3)]
    {
        let problem = Problem { model_error: None, ..problem(true, calibration, 2) };
        let mut variational = FourDVar::new(problem.clone(), four_d_var(5, outer_loops)).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        let mut chi2 = [0.0; 2];
        for cycle in 1..=5 {
            let observed = window(&problem, 14, false, cycle, 5);
            let from_variational = variational.forecast(WINDOW).unwrap();
            let from_reference = reference.forecast(WINDOW).unwrap();
            let found = variational.analyse(&from_variational, &observed).unwrap();
            let expected = reference.analyse(&from_reference, &observed).unwrap();
            let error = difference(&found.estimate, &expected.estimate);
            assert!(error < 1e-8, "cycle {cycle}, {outer_loops} outer loops: {error:e}");
            // χ² of all observations so far is the sum of the filter's, and each cycle gets its share.
            chi2[0] = found.innovation_chi2.unwrap() * cycle as f64;
            chi2[1] += expected.innovation_chi2.unwrap();
            assert!((chi2[0] / chi2[1] - 1.0).abs() < 1e-8, "cycle {cycle}: {chi2:?}");
        }
    }
}

/// A window that is full starts from an earlier analysis, with the static covariance again.
#[test]
fn the_window_of_four_d_var_slides() {
    let problem = Problem { model_error: None, ..problem(true, calibration(2, 0, 0.0), 2) };
    let mut variational = FourDVar::new(problem.clone(), four_d_var(2, 1)).unwrap();
    let mut last = None;
    for cycle in 1..=3 {
        let from_variational = variational.forecast(WINDOW).unwrap();
        last = Some(variational.analyse(&from_variational, &window(&problem, 14, false, cycle, 5)).unwrap().estimate);
    }
    let last = last.unwrap();
    // The same by hand: the window's background is the analysis of the first cycle, with B again. Given the biases as
    // analysed, the minimum over the state alone is where the joint minimum is.
    let mut filter = KalmanFilter::new(problem.clone()).unwrap();
    let from_filter = filter.forecast(WINDOW).unwrap();
    let start = filter.analyse(&from_filter, &window(&problem, 14, false, 1, 5)).unwrap().estimate;
    let again = Problem { background: start.state.clone(), bias: BiasTreatment::Known, ..problem.clone() };
    let mut again = KalmanFilter::new(again).unwrap();
    let mut expected = None;
    for cycle in 2..=3 {
        let from_again = again.forecast(WINDOW).unwrap();
        let mut observed = window(&problem, 14, false, cycle, 5);
        let jacobian = observed.operator.linearize(&start.state, &start.calibration);
        let biases = jacobian.apply(&vec![0.0; start.state.values().len()], &last.calibration);
        observed.values.iter_mut().zip(biases).for_each(|(value, bias)| *value -= bias);
        expected = Some(again.analyse(&from_again, &observed).unwrap().estimate);
    }
    let error = relative_difference(last.state.values(), expected.unwrap().state.values());
    assert!(error < 1e-8, "{error:e}");
}

#[test]
fn optimal_interpolation_is_what_3d_var_converges_to() {
    let problem = problem(true, calibration(2, 1, 0.5), 8);
    let mut interpolation = OptimalInterpolation::new(problem.clone(), 0.4).unwrap();
    let mut variational = ThreeDVar::new(problem.clone(), TO_ROUNDING).unwrap();
    for cycle in 1..=4 {
        let from_interpolation = interpolation.forecast(WINDOW).unwrap();
        let from_variational = variational.forecast(WINDOW).unwrap();
        let observed = window(&problem, 20, false, cycle, 9);
        let found = interpolation.analyse(&from_interpolation, &observed).unwrap();
        let expected = variational.analyse(&from_variational, &observed).unwrap();
        let error = difference(&found.estimate, &expected.estimate);
        assert!(error < 1e-9, "cycle {cycle}: {error:e}");
        assert!((found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
    }
}

/// The spread that it claims at the first analysis is the Kalman filter's.
#[test]
fn optimal_interpolation_claims_what_the_kalman_filter_does() {
    let problem = Problem { model_error: None, ..problem(true, calibration(2, 1, 0.0), 8) };
    let observed = window(&problem, 20, false, 1, 9);
    let found =
        OptimalInterpolation::new(problem.clone(), 1.0).unwrap().analyse(&start(&problem), &observed).unwrap().estimate;
    let expected = KalmanFilter::new(problem.clone()).unwrap().analyse(&start(&problem), &observed).unwrap().estimate;
    assert!(difference(&found, &expected) < 1e-10);
    assert!(relative_difference(&found.state_spread.unwrap(), &expected.state_spread.unwrap()) < 1e-10);
}

#[test]
fn a_hybrid_of_weight_zero_or_one_is_one_of_its_parts() {
    let problem = problem(true, calibration(2, 1, 0.5), 8);
    let ensemble = EnsembleSettings {
        members: 20,
        initial_members: InitialMembers::Random,
        model_error: ModelErrorTreatment::Random,
        inflation: Inflation::NONE,
        seed: 0,
    };
    let settings = |ensemble_weight: f64| HybridSettings {
        ensemble_weight,
        variational: TO_ROUNDING,
        ensemble,
        local: LocalSettings { localization_radius_m: f64::INFINITY, analysis_spacing_cells: 1 },
    };
    let mut hybrid = HybridThreeDVar::new(problem.clone(), settings(0.0)).unwrap();
    let mut variational = ThreeDVar::new(problem.clone(), TO_ROUNDING).unwrap();
    for cycle in 1..=3 {
        let from_hybrid = hybrid.forecast(WINDOW).unwrap();
        let from_variational = variational.forecast(WINDOW).unwrap();
        let observed = window(&problem, 14, false, cycle, 5);
        let found = hybrid.analyse(&from_hybrid, &observed).unwrap().estimate;
        let expected = variational.analyse(&from_variational, &observed).unwrap().estimate;
        let error = difference(&found, &expected);
        assert!(error < 1e-9, "cycle {cycle}: {error:e}");
    }
    // With all weight on the members, its analysis is that of their mean; biases known, as 3D-Var keeps their covariance
    // with the state's apart.
    let problem = Problem { bias: BiasTreatment::Known, ..problem };
    let mut hybrid = HybridThreeDVar::new(problem.clone(), settings(1.0)).unwrap();
    let mut filter = EnsembleTransformKalmanFilter::new(problem.clone(), ensemble).unwrap();
    for cycle in 1..=3 {
        let from_hybrid = hybrid.forecast(WINDOW).unwrap();
        let from_filter = filter.forecast(WINDOW).unwrap();
        let observed = window(&problem, 14, false, cycle, 5);
        let found = hybrid.analyse(&from_hybrid, &observed).unwrap().estimate;
        let expected = filter.analyse(&from_filter, &observed).unwrap().estimate;
        let error = difference(&found, &expected);
        assert!(error < 1e-8, "cycle {cycle}: {error:e}");
        assert!(relative_difference(&found.state_spread.unwrap(), &expected.state_spread.unwrap()) < 1e-8);
    }
}
