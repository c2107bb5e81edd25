//! The gain of a method that is found by asking is that of its formula, and asking leaves no trace.

use crate::common::*;
use faer::Mat;
use isobar_assim::ensemble::{
    EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers, LocalEnsembleTransformKalmanFilter,
    LocalSettings, ModelErrorTreatment, StochasticEnsembleKalmanFilter,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::response::Responder;
use isobar_assim::variational::{FourDVar, FourDVarSettings, ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, BiasTreatment, Problem};

/// K = A Hᵀ R⁻¹ with the covariance A of the analysis (Kalman 1960; Jazwinski 1970, eq. 7.3.12).
fn gain_of(analysis: &Mat<f64>, observed: &isobar_obs::ObservationWindow, problem: &Problem) -> Mat<f64> {
    let m = problem.background.values().len();
    let jacobian = observed.operator.linearize(&problem.background, &[]);
    Mat::from_fn(analysis.nrows(), observed.len(), |i, row| {
        let of_state: f64 = jacobian.state.row(row).iter().map(|&(j, weight)| weight * analysis[(i, j)]).sum();
        let of_biases: f64 =
            jacobian.calibration.row(row).iter().map(|&(j, weight)| weight * analysis[(i, m + j)]).sum();
        (of_state + of_biases) / observed.sigma[row].powi(2)
    })
}

#[test]
fn the_gain_of_the_kalman_filter_is_that_of_its_covariance() {
    let problem = problem(true, calibration(2, 1, 0.7), 2);
    let m = problem.background.values().len();
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let whole = settings(BlockShape::Domain, BiasCoupling::Carry);
    let mut others: Vec<(&str, Box<dyn Assimilator>)> = vec![
        ("kf", Box::new(KalmanFilter::new(problem.clone()).unwrap())),
        ("serial", Box::new(KalmanFilter::serial(problem.clone()).unwrap())),
        ("fkf", Box::new(FastKalmanFilter::new(problem.clone(), whole).unwrap())),
    ];
    for cycle in 1..=3 {
        let observed = window(&problem, 14, false, cycle, 5);
        let from_reference = reference.forecast(WINDOW).unwrap();
        reference.analyse(&from_reference, &observed).unwrap();
        let expected = gain_of(&reference.covariance().to_owned(), &observed, &problem);
        for (name, method) in &mut others {
            let background = method.forecast(WINDOW).unwrap();
            let responder = Responder::new(&**method, &background, &observed);
            let gain = responder.gain().unwrap();
            method.analyse(&background, &observed).unwrap();
            let found = Mat::from_fn(expected.nrows(), 14, |i, j| {
                if i < m { gain.state[(i, j)] } else { gain.calibration[(i - m, j)] }
            });
            let difference = relative_difference(&flat(&found), &flat(&expected));
            assert!(difference < 1e-9, "{name}, cycle {cycle}: {difference:e}");
        }
    }
}

/// A method of every kind.
fn all(problem: &Problem) -> Vec<(&'static str, Box<dyn Assimilator>)> {
    let own = || problem.clone();
    let ensemble = EnsembleSettings {
        members: 16,
        initial_members: InitialMembers::SecondOrderExact,
        model_error: ModelErrorTreatment::SquareRoot,
        inflation: Inflation::NONE,
        seed: 0,
    };
    let local = LocalSettings { localization_radius_m: 3.0, analysis_spacing_cells: 1 };
    let probed = isobar_assim::fast_kalman::FastKalmanSettings {
        residual: Residual::Probe { count: 3 },
        factors: 5,
        ..settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    let variational = ThreeDVarSettings { covariance_scale: 0.7, tolerance: 1e-12, max_iterations: 200 };
    let window = FourDVarSettings {
        window_cycles: 2,
        covariance_scale: 1.0,
        outer_loops: 1,
        tolerance: 1e-10,
        max_iterations: 200,
    };
    vec![
        ("oi", Box::new(OptimalInterpolation::new(own(), 0.7).unwrap())),
        ("3dvar", Box::new(ThreeDVar::new(own(), variational).unwrap())),
        ("4dvar", Box::new(FourDVar::new(own(), window).unwrap())),
        ("kf", Box::new(KalmanFilter::new(own()).unwrap())),
        ("serial", Box::new(KalmanFilter::serial(own()).unwrap())),
        ("fkf", Box::new(FastKalmanFilter::new(own(), probed).unwrap())),
        ("etkf", Box::new(EnsembleTransformKalmanFilter::new(own(), ensemble).unwrap())),
        ("letkf", Box::new(LocalEnsembleTransformKalmanFilter::new(own(), ensemble, local).unwrap())),
        ("enkf", Box::new(StochasticEnsembleKalmanFilter::new(own(), ensemble, 3.0).unwrap())),
    ]
}

#[test]
fn asking_changes_no_bit_of_what_follows() {
    for bias in [BiasTreatment::Estimate, BiasTreatment::Known] {
        let problem = Problem { bias, ..problem(true, calibration(2, 1, 0.7), 2) };
        for ((name, mut asked), (_, mut plain)) in all(&problem).into_iter().zip(all(&problem)) {
            for cycle in 1..=4 {
                let observed = window(&problem, 9, false, cycle, 5);
                let background = asked.forecast(WINDOW).unwrap();
                assert_eq!(background, plain.forecast(WINDOW).unwrap(), "{name}, cycle {cycle}");
                let responder = Responder::new(&*asked, &background, &observed);
                let response = responder.to(&[1.0; 9]).unwrap();
                assert!(response.state.iter().any(|change| change.abs() > 1e-6), "{name} does nothing");
                let (a, b) =
                    (asked.analyse(&background, &observed).unwrap(), plain.analyse(&background, &observed).unwrap());
                assert_eq!(a, b, "{name}, cycle {cycle}");
            }
        }
    }
}

#[test]
fn the_responses_to_parts_add_up_to_that_to_the_whole() {
    let problem = problem(true, calibration(2, 1, 0.7), 2);
    for (name, mut method) in all(&problem) {
        let observed = window(&problem, 9, false, 1, 5);
        let background = method.forecast(WINDOW).unwrap();
        let responder = Responder::new(&*method, &background, &observed);
        let innovations: Vec<f64> = (0..9).map(|i| (1.3 * f64::from(i)).sin()).collect();
        let part =
            |first: bool| innovations.iter().enumerate().map(move |(i, &d)| if (i < 4) == first { d } else { 0.0 });
        let [first, second] = [true, false].map(|own| responder.to(&part(own).collect::<Vec<_>>()).unwrap());
        let whole = responder.to(&innovations).unwrap();
        let sum: Vec<f64> = first.state.iter().zip(&second.state).map(|(a, b)| a + b).collect();
        let difference = relative_difference(&sum, &whole.state);
        assert!(difference < 1e-8, "{name}: {difference:e}");
    }
}
