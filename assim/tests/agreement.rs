//! Methods that must agree exactly, on a small linear problem.

use crate::common::*;
use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::variational::{ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem, covariance};
use isobar_model::State;
use isobar_model::random::{standard_normals, stream};
use isobar_obs::ObservationWindow;

fn fast_kalman(problem: &Problem, blocks: BlockShape, bias_coupling: BiasCoupling) -> FastKalmanFilter {
    FastKalmanFilter::new(problem.clone(), settings(blocks, bias_coupling)).unwrap()
}

/// A method that has the covariance of (x, c) as a matrix.
trait Dense: Assimilator {
    fn matrix(&self) -> Mat<f64>;
}

impl Dense for FastKalmanFilter {
    fn matrix(&self) -> Mat<f64> {
        self.dense_covariance()
    }
}

impl Dense for KalmanFilter {
    fn matrix(&self) -> Mat<f64> {
        self.covariance().to_owned()
    }
}

/// Largest relative difference from the Kalman filter in estimates, claimed variances and χ² over some cycles.
fn difference(problem: &Problem, fast: &mut impl Dense, within_cell: bool) -> f64 {
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let mut largest: f64 = 0.0;
    for cycle in 1..=8 {
        let observed = window(problem, 14, within_cell, cycle, 5);
        let (background, expected_background) = (fast.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
        largest = largest.max(relative_difference(
            background.estimate.state_spread.as_ref().unwrap(),
            expected_background.estimate.state_spread.as_ref().unwrap(),
        ));
        let (analysis, expected) = (
            fast.analyse(&background, &observed).unwrap(),
            reference.analyse(&expected_background, &observed).unwrap(),
        );
        largest = largest
            .max(relative_difference(analysis.estimate.state.values(), expected.estimate.state.values()))
            .max(relative_difference(&flat(&fast.matrix()), &flat(&reference.covariance().to_owned())))
            .max((analysis.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs());
        if !problem.calibration.is_empty() {
            largest = largest.max(relative_difference(&analysis.estimate.calibration, &expected.estimate.calibration));
        }
    }
    largest
}

#[test]
fn one_block_over_the_domain_equals_the_kalman_filter() {
    for (shared, local) in [(0, 0), (3, 0), (0, 4), (3, 4)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        assert_eq!(problem.calibration.len(), shared + local);
        let mut fast = fast_kalman(&problem, BlockShape::Domain, BiasCoupling::Carry);
        let found = difference(&problem, &mut fast, false);
        assert!(found < 1e-8, "{shared} shared, {local} local: {found:e}");
    }
}

#[test]
fn one_observation_at_a_time_equals_all_at_once() {
    for (shared, local) in [(0, 0), (3, 0), (0, 4), (3, 4)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        let mut serial = KalmanFilter::serial(problem.clone()).unwrap();
        let found = difference(&problem, &mut serial, false);
        assert!(found < 1e-11, "{shared} shared, {local} local: {found:e}");
        let covariance = serial.covariance();
        assert!((0..covariance.nrows()).all(|i| (0..i).all(|j| covariance[(i, j)] == covariance[(j, i)])));
    }
}

#[test]
fn without_coupling_in_the_model_any_blocks_equal_the_kalman_filter() {
    // Without drift: with one, the walk's part of the covariance between blocks needs factors of its own.
    for (shared, local) in [(0, 0), (2, 0), (2, 3)] {
        let problem = problem(false, calibration(shared, local, 0.0), 3);
        for blocks in [BlockShape::Cell, BlockShape::Tile { nx: 2, ny: 3 }, BlockShape::Domain] {
            let mut fast = fast_kalman(&problem, blocks, BiasCoupling::Carry);
            let found = difference(&problem, &mut fast, true);
            assert!(found < 1e-8, "{blocks:?}, {shared} shared, {local} local: {found:e}");
        }
    }
}

#[test]
fn observations_across_blocks_merge_them_and_the_analysis_stays_exact() {
    // One analysis from a block-diagonal background equals the Kalman filter's, however the observations link blocks.
    let problem = problem(false, calibration(2, 2, 0.0), 3);
    let mut fast = fast_kalman(&problem, BlockShape::Cell, BiasCoupling::Carry);
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let observed = window(&problem, 9, false, 1, 5);
    let from_fast = fast.forecast(WINDOW).unwrap();
    let from_reference = reference.forecast(WINDOW).unwrap();
    let (analysis, expected) =
        (fast.analyse(&from_fast, &observed).unwrap(), reference.analyse(&from_reference, &observed).unwrap());
    assert!(relative_difference(analysis.estimate.state.values(), expected.estimate.state.values()) < 1e-10);
    let covariance = reference.covariance().to_owned();
    assert!(relative_difference(&flat(&fast.dense_covariance()), &flat(&covariance)) < 1e-10);
    let report = analysis.partition.unwrap();
    assert_eq!((report.blocks, report.border), (20, 2));
    assert!(report.merged_components >= 1 && report.largest_component_blocks > 1);
    assert!(report.unobserved_blocks > 0);
}

#[test]
fn dropping_the_coupling_with_the_biases_costs_bias_accuracy_and_spoils_its_claim() {
    // Friedland's two-stage filter with the bias sensitivity of the forecast left out. Without drift and coupling
    // between cells "carry" is the Kalman filter. One truth after the other, both filters on the same observations.
    let problem = problem(false, calibration(2, 0, 0.0), 4);
    let (runs, cycles) = (150, 30);
    let mut squared_error = [0.0; 2];
    let mut claims = [0.0; 2];
    for run in 0..runs {
        let random = &mut stream(run, "truth");
        let initial = covariance::randomize(&*problem.background_error, random);
        let mut truth = State::from_values(problem.background.layout(), initial);
        let normals = standard_normals(random, 2);
        let bias: Vec<f64> =
            problem.calibration.parameters.iter().zip(normals).map(|(own, draw)| own.sigma_prior * draw).collect();
        let mut filters =
            [BiasCoupling::Carry, BiasCoupling::Drop].map(|coupling| fast_kalman(&problem, BlockShape::Cell, coupling));
        for cycle in 1..=cycles {
            problem.model.step(&mut truth);
            let error = covariance::randomize(problem.model_error.as_deref().unwrap(), random);
            truth.values_mut().iter_mut().zip(error).for_each(|(value, error)| *value += error);
            let mut observed = window(&problem, 14, true, cycle, 6);
            let exact = observed.operator.simulate(&truth, &bias);
            let errors = standard_normals(random, 14);
            observed.values = (0..14).map(|i| exact[i] + observed.sigma[i] * errors[i]).collect();
            for (number, filter) in filters.iter_mut().enumerate() {
                let from_filter = filter.forecast(WINDOW).unwrap();
                let estimate = filter.analyse(&from_filter, &observed).unwrap().estimate;
                if cycle == cycles {
                    let errors = estimate.calibration.iter().zip(&bias);
                    squared_error[number] += errors.map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                    let claimed = estimate.calibration_spread.unwrap();
                    claims[number] += claimed.iter().map(|sigma| sigma * sigma).sum::<f64>();
                }
            }
        }
    }
    let loss = (squared_error[1] / squared_error[0]).sqrt();
    let [carry, drop] = [0, 1].map(|number| (claims[number] / squared_error[number]).sqrt());
    let claim = (claims[1] / claims[0]).sqrt();
    println!("dropped: bias RMSE ×{loss:.3}, claimed σ ×{claim:.3}; claimed over actual {carry:.3} carried, {drop:.3}");
    // Both see the same observations: the loss, 5 %, is significant although 300 errors know an RMSE to 4 % only. The claims
    // do not depend on the data.
    assert!((1.03..1.07).contains(&loss), "{loss}");
    assert!((carry - 1.0).abs() < 0.12, "the Kalman filter's claim is right: {carry}");
    assert!((1.035..1.045).contains(&claim), "{claim}");
}

#[test]
fn three_d_var_equals_the_dense_analysis_with_static_covariance() {
    let problem = problem(true, calibration(2, 1, 0.5), 8);
    let settings = ThreeDVarSettings { covariance_scale: 0.4, tolerance: 1e-12, max_iterations: 500 };
    let mut method = ThreeDVar::new(problem.clone(), settings).unwrap();
    let m = problem.background.values().len();
    let b = covariance::dense(&*problem.background_error);
    let mut bias_covariance =
        Mat::from_fn(3, 3, |i, j| if i == j { problem.calibration.parameters[i].sigma_prior.powi(2) } else { 0.0 });
    for cycle in 1..=4 {
        let background = method.forecast(WINDOW).unwrap();
        let observed = window(&problem, 20, false, cycle, 9);
        let mut p = Mat::<f64>::zeros(m + 3, m + 3);
        let kept = problem.calibration.kept(WINDOW);
        bias_covariance = Mat::from_fn(3, 3, |i, j| kept[i] * bias_covariance[(i, j)] * kept[j]);
        for (i, parameter) in problem.calibration.parameters.iter().enumerate() {
            bias_covariance[(i, i)] += parameter.drift.added_variance(WINDOW);
        }
        p.as_mut().submatrix_mut(0, 0, m, m).copy_from(&b * faer::Scale(0.4));
        p.as_mut().submatrix_mut(m, m, 3, 3).copy_from(&bias_covariance);
        let h = dense_jacobian(&observed, &background.estimate);
        let mut innovation = &h * &p * h.transpose();
        (0..20).for_each(|i| innovation[(i, i)] += observed.sigma[i].powi(2));
        let inverse = innovation.llt(Side::Lower).unwrap().inverse();
        let gain = &p * h.transpose() * inverse.as_ref();
        let analysis = method.analyse(&background, &observed).unwrap();
        let d = Mat::from_fn(20, 1, |i, _| analysis.background_departures[i]);
        let increment = &gain * &d;
        let found: Vec<f64> = (&analysis.estimate.state - &background.estimate.state).values().to_vec();
        assert!(relative_difference(&found, &increment.col_as_slice(0)[..m]) < 1e-8);
        let found: Vec<f64> =
            analysis.estimate.calibration.iter().zip(&background.estimate.calibration).map(|(a, b)| a - b).collect();
        assert!(relative_difference(&found, &increment.col_as_slice(0)[m..]) < 1e-8);
        let chi2 = (d.transpose() * &inverse * &d)[(0, 0)];
        assert!((analysis.innovation_chi2.unwrap() / chi2 - 1.0).abs() < 1e-8);
        let posterior = &p - &gain * &h * &p;
        bias_covariance = posterior.as_ref().submatrix(m, m, 3, 3).to_owned();
        let claimed = analysis.estimate.calibration_spread.unwrap();
        for i in 0..3 {
            assert!((claimed[i] / bias_covariance[(i, i)].sqrt() - 1.0).abs() < 1e-8);
        }
    }
}

#[test]
fn biases_are_estimated_ignored_or_known() {
    let mut problem = problem(true, calibration(2, 0, 0.0), 8);
    let mut observed = window(&problem, 20, false, 1, 9);
    let run = |problem: &Problem, observed: &ObservationWindow| -> Vec<State> {
        let settings = ThreeDVarSettings { covariance_scale: 1.0, tolerance: 1e-12, max_iterations: 500 };
        let mut methods: Vec<Box<dyn Assimilator>> = vec![
            Box::new(KalmanFilter::new(problem.clone()).unwrap()),
            Box::new(fast_kalman(problem, BlockShape::Domain, BiasCoupling::Carry)),
            Box::new(KalmanFilter::serial(problem.clone()).unwrap()),
            Box::new(ThreeDVar::new(problem.clone(), settings).unwrap()),
        ];
        methods
            .iter_mut()
            .map(|method| {
                let from = method.forecast(WINDOW).unwrap();
                let analysis = method.analyse(&from, observed).unwrap();
                assert_eq!(analysis.estimate.calibration.len(), 2);
                assert_eq!(analysis.estimate.calibration_spread.is_some(), problem.bias == BiasTreatment::Estimate);
                analysis.estimate.state
            })
            .collect()
    };
    let estimated = run(&problem, &observed);
    problem.bias = BiasTreatment::Ignore;
    let ignored = run(&problem, &observed);
    problem.bias = BiasTreatment::Known;
    observed.values.iter_mut().for_each(|value| *value -= 1.0);
    let known = run(&problem, &observed);
    for method in 0..3 {
        // Filters with the same treatment agree; treatments differ.
        assert!(relative_difference(ignored[method].values(), ignored[0].values()) < 1e-8);
        assert!(relative_difference(known[method].values(), known[0].values()) < 1e-8);
    }
    for method in 0..4 {
        for (a, b) in [(&estimated, &ignored), (&ignored, &known), (&known, &estimated)] {
            assert!(relative_difference(a[method].values(), b[method].values()) > 1e-3);
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let problem = problem(true, calibration(2, 3, 0.2), 8);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut filter = fast_kalman(&problem, BlockShape::Cell, BiasCoupling::Carry);
            let mut bits = Vec::new();
            for cycle in 1..=5 {
                let from_filter = filter.forecast(WINDOW).unwrap();
                let analysis = filter.analyse(&from_filter, &window(&problem, 14, false, cycle, 6)).unwrap();
                bits.extend(analysis.estimate.state.values().iter().map(|value| value.to_bits()));
                bits.extend(analysis.estimate.calibration_spread.unwrap().iter().map(|value| value.to_bits()));
            }
            bits
        })
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(8));
}

#[test]
fn what_does_not_fit_into_memory_is_refused_with_the_figure() {
    let mut problem = problem(true, calibration(2, 0, 0.2), 8);
    problem.memory_limit_bytes = 10_000;
    let error = KalmanFilter::new(problem.clone()).err().unwrap();
    assert!(matches!(error, Error::TooLarge { needed_bytes: 70_560, limit_bytes: 10_000, .. }), "{error}");
    assert_eq!(KalmanFilter::serial(problem.clone()).err().unwrap(), error);
    let settings = settings(BlockShape::Cell, BiasCoupling::Carry);
    assert!(matches!(FastKalmanFilter::new(problem.clone(), settings).err(), Some(Error::TooLarge { .. })));
    // Blocks that fit, but not the component into which the observations merge them.
    problem.memory_limit_bytes = 45_000;
    let mut filter = FastKalmanFilter::new(problem.clone(), settings).unwrap();
    let from_filter = filter.forecast(WINDOW).unwrap();
    let error = filter.analyse(&from_filter, &window(&problem, 60, false, 1, 6)).unwrap_err();
    let message = error.to_string();
    assert!(message.starts_with("the component of 16 blocks (32 variables) that 55 observations link"), "{message}");
    assert!(message.ends_with("would need 0.1 MB, more than the limit of 0.0 MB"), "{message}");
}

/// Where a covariance has been lost, the failure says in which block: a whole state is no place to look.
#[test]
fn the_fast_kalman_filter_names_the_blocks_of_a_failure() {
    let mut problem = problem(true, calibration(0, 0, 0.0), 8);
    (problem.background_error, problem.model_error) = (white(problem.background.layout(), 0.0), None);
    let mut observed = window(&problem, 1, false, 1, 6);
    observed.sigma[0] = 0.0;
    for (blocks, expected) in [
        (BlockShape::Tile { nx: 5, ny: 2 }, "block 0 (rows 0 to 1, columns 0 to 4)"),
        (BlockShape::Domain, "block 0 (rows 0 to 3, columns 0 to 4)"),
        (BlockShape::Cell, "and 1 more, which observations link"),
    ] {
        let mut filter = fast_kalman(&problem, blocks, BiasCoupling::Carry);
        let from_filter = filter.forecast(WINDOW).unwrap();
        let error = filter.analyse(&from_filter, &observed).unwrap_err().to_string();
        assert!(error.starts_with("the innovation covariance H P H' + R of block "), "{error}");
        assert!(error.contains(expected), "{blocks:?}: {error}");
    }
}
