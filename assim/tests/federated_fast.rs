//! The federated filter of Fast Kalman Filters against that of dense ones.

use crate::common::*;
use crate::federated::{SHARES, SYSTEMS, biases, observations};
use faer::{Mat, Side};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedKalmanFilter, FederatedSettings};
use isobar_assim::{Assimilator, BiasTreatment, Error, Estimate, Problem};
use isobar_obs::Placement;

/// One block, whose forecast is exact.
fn one_block() -> FastKalmanSettings {
    settings(BlockShape::Domain, BiasCoupling::Carry)
}

/// Blocks of a cell, and this number of factors.
fn cells(factors: usize) -> FastKalmanSettings {
    FastKalmanSettings {
        factors,
        residual: Residual::Probe { count: 3 },
        ..settings(BlockShape::Cell, BiasCoupling::Carry)
    }
}

fn of_systems(shares: [f64; 3], reset_every_cycles: Option<usize>) -> FederatedSettings {
    let systems = SYSTEMS.iter().zip(shares).map(|(name, share)| (name.to_string(), share)).collect();
    FederatedSettings { systems, reset_every_cycles }
}

fn fast(problem: &Problem, reset: Option<usize>, settings: FastKalmanSettings) -> FederatedFastKalmanFilter {
    FederatedFastKalmanFilter::of_fast_filters(problem.clone(), of_systems(SHARES, reset), settings).unwrap()
}

fn all(estimate: &Estimate) -> Vec<f64> {
    estimate.state.values().iter().chain(&estimate.calibration).copied().collect()
}

/// Largest relative difference from the federated filter of dense filters in estimates, covariance and χ², in each cycle.
fn differences(problem: &Problem, reset: Option<usize>, settings: FastKalmanSettings, cycles: usize) -> Vec<f64> {
    let mut filter = fast(problem, reset, settings);
    let mut reference = FederatedKalmanFilter::new(problem.clone(), of_systems(SHARES, reset)).unwrap();
    let mut differences = Vec::new();
    for cycle in 1..=cycles {
        let observed = observations(problem, cycle);
        let (background, expected) = (filter.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
        let before = relative_difference(&all(&background.estimate), &all(&expected.estimate));
        let found = filter.analyse(&background, &observed).unwrap();
        let expected = reference.analyse(&expected, &observed).unwrap();
        let covariance =
            relative_difference(&flat(&filter.dense_covariance()), &flat(&reference.covariance().to_owned()));
        let chi2 = (found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs();
        let after = relative_difference(&all(&found.estimate), &all(&expected.estimate));
        differences.push([before, after, covariance, chi2].into_iter().fold(0.0, f64::max));
    }
    differences
}

/// With one block there is nothing between blocks that a fusion, a division or a forecast could drop; with as many factors as
/// unknowns there is nothing in the blocks.
#[test]
fn with_one_block_or_all_factors_it_is_the_federated_filter_of_dense_ones() {
    for bias in [BiasTreatment::Estimate, BiasTreatment::Known] {
        let problem = Problem { bias, ..problem(true, biases(0.5), 2) };
        let m = problem.background.values().len();
        for reset in [None, Some(1), Some(2)] {
            for (settings, tolerance) in [(one_block(), 1e-8), (cells(m), 1e-7)] {
                let found = differences(&problem, reset, settings, 6);
                assert!(found.iter().all(|it| *it < tolerance), "{bias:?}, reset {reset:?}, {settings:?}: {found:?}");
            }
        }
    }
}

/// One system, with biases of many places and of one.
#[test]
fn with_one_system_it_is_the_fast_kalman_filter() {
    let mut calibration = biases(0.5);
    calibration.parameters.iter_mut().for_each(|parameter| parameter.name = format!("n/{}", parameter.name));
    let problem = problem(true, calibration, 2);
    for reset_every_cycles in [None, Some(1)] {
        let systems = FederatedSettings { systems: vec![("n".into(), 1.0)], reset_every_cycles };
        let mut filter = FederatedFastKalmanFilter::of_fast_filters(problem.clone(), systems, cells(20)).unwrap();
        let mut reference = FastKalmanFilter::new(problem.clone(), cells(20)).unwrap();
        for cycle in 1..=4 {
            let observed = window(&problem, 14, false, cycle, 5);
            let from = filter.forecast(WINDOW).unwrap();
            assert_eq!(from, reference.forecast(WINDOW).unwrap());
            let (found, expected) =
                (filter.analyse(&from, &observed).unwrap(), reference.analyse(&from, &observed).unwrap());
            assert_eq!(found.estimate, expected.estimate);
            assert_eq!(found.innovation_chi2, expected.innovation_chi2);
        }
    }
}

/// A fusion is the sum of the information of the local filters, whatever their blocks and factors: before any observation
/// all of them together know the state as well as one filter with the same biases as shared ones.
#[test]
fn a_fusion_is_the_sum_of_information() {
    let mut calibration = biases(0.5);
    calibration.parameters.iter_mut().for_each(|parameter| parameter.placement = Placement::Shared);
    let problem = problem(true, calibration, 2);
    let m = problem.background.values().len();
    for factors in [0, 7, 20] {
        let mut filter = fast(&problem, None, cells(factors));
        let mut one = FastKalmanFilter::new(problem.clone(), cells(factors)).unwrap();
        let (found, expected) = (filter.forecast(WINDOW).unwrap(), one.forecast(WINDOW).unwrap());
        assert!(relative_difference(&all(&found.estimate), &all(&expected.estimate)) < 1e-12);
        let [found, expected] = [filter.dense_covariance(), one.dense_covariance()];
        let part = |matrix: &Mat<f64>| flat(&matrix.get(..m, ..m).to_owned());
        let error = relative_difference(&part(&found), &part(&expected));
        assert!(error < 1e-8, "{factors} factors: {error:e}");
    }
}

/// What is dropped between blocks leaves a covariance.
#[test]
fn with_blocks_and_factors_its_covariance_stays_one() {
    let problem = problem(true, biases(0.5), 2);
    for (factors, reset) in [(0, 1), (10, 1), (25, 2)] {
        let mut filter = fast(&problem, Some(reset), cells(factors));
        for cycle in 1..=8 {
            let from = filter.forecast(WINDOW).unwrap();
            filter.analyse(&from, &observations(&problem, cycle)).unwrap();
            let eigenvalues = filter.dense_covariance().self_adjoint_eigenvalues(Side::Lower).unwrap();
            let largest = eigenvalues[eigenvalues.len() - 1];
            assert!(
                eigenvalues[0] > -1e-12 * largest,
                "{factors} factors, cycle {cycle}: {} of {largest}",
                eigenvalues[0]
            );
        }
    }
}

#[test]
fn its_results_are_the_same_bits_on_any_number_of_threads_and_from_its_memory() {
    let problem = problem(true, biases(0.5), 2);
    let run = |threads: usize, interrupted: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut filter = fast(&problem, Some(2), cells(9));
            let mut estimates = Vec::new();
            for cycle in 1..=5 {
                let from = filter.forecast(WINDOW).unwrap();
                estimates.push(filter.analyse(&from, &observations(&problem, cycle)).unwrap().estimate);
                if interrupted {
                    let memory = filter.memory().unwrap();
                    filter = fast(&problem, Some(2), cells(9));
                    filter.recall(&memory).unwrap();
                }
            }
            estimates
        })
    };
    let once = run(1, false);
    assert!(once == run(3, false) && once == run(1, true));
}

#[test]
fn what_does_not_fit_into_memory_is_refused() {
    let problem = Problem { memory_limit_bytes: 20_000, ..problem(true, biases(0.5), 2) };
    let systems = of_systems(SHARES, None);
    let error = FederatedFastKalmanFilter::of_fast_filters(problem, systems, cells(20)).err().unwrap();
    assert!(matches!(error, Error::TooLarge { .. }));
    assert!(error.to_string().contains("3 Fast Kalman Filters for 40 values each"), "{error}");
}
