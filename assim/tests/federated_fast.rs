//! The federated filter of Fast Kalman Filters against that of dense ones.

use crate::common::*;
use crate::federated::{SHARES, SYSTEMS, biases, observations, observations_of};
use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Scale, Side};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedKalmanFilter, FederatedSettings};
use isobar_assim::{Assimilator, BiasTreatment, Error, Estimate, Problem};
use isobar_obs::{ObservationWindow, Placement};

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

/// Before any observation all local filters together know the state as well as one filter with the same blocks and factors:
/// what they share counts once.
#[test]
fn what_local_filters_share_counts_once() {
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

fn inverse(matrix: &Mat<f64>) -> Mat<f64> {
    matrix.llt(Side::Lower).unwrap().inverse()
}

/// What the posteriors of all systems, each with the prior P and its observations alone, make of P without what they share,
///
/// ```text
/// P_f⁻¹ = Σ P_i⁻¹ − (N − 1) P⁻¹,    P_f⁻¹ x̂_f = Σ P_i⁻¹ x̂_i − (N − 1) P⁻¹ x̂,    P_i⁻¹ = P⁻¹ + H_iᵀ R_i⁻¹ H_i,
/// ```
///
/// in dense matrices: x̂_f − x̂ and P_f, for observations with these departures from x̂.
fn sum_of_information(
    problem: &Problem,
    prior: &Mat<f64>,
    observed: &ObservationWindow,
    d: &[f64],
) -> (Vec<f64>, Mat<f64>) {
    let (m, size) = (problem.background.values().len(), prior.nrows());
    let jacobian = observed.operator.linearize(&problem.background, &vec![0.0; problem.calibration.len()]);
    let of_prior = inverse(prior);
    let shared_by_others = 1.0 - SYSTEMS.len() as f64;
    let (mut information, mut weighted) = (&of_prior * Scale(shared_by_others), Mat::<f64>::zeros(size, 1));
    for system in SYSTEMS {
        let (mut own, mut seen) = (of_prior.clone(), Mat::<f64>::zeros(size, 1));
        for row in (0..observed.len()).filter(|&row| *observed.reports[row].network == *system) {
            let mut h = Mat::<f64>::zeros(size, 1);
            jacobian.state.row(row).iter().for_each(|&(i, weight)| h[(i, 0)] += weight);
            let of_biases = jacobian.calibration.row(row).iter().filter(|_| size > m);
            of_biases.for_each(|&(i, weight)| h[(m + i, 0)] += weight);
            let precision = observed.sigma[row].powi(-2);
            own += &h * h.transpose() * Scale(precision);
            seen += &h * Scale(precision * d[row]);
        }
        let posterior = inverse(&own);
        let increment = &posterior * &seen;
        information += inverse(&posterior);
        weighted += inverse(&posterior) * increment;
    }
    let covariance = inverse(&information);
    ((&covariance * weighted).col_as_slice(0).to_vec(), covariance)
}

/// The fused estimate and its covariance are those of dense matrices: with biases in the first cycle, and without any in all
/// cycles, each of which starts from a division. Observations of a cell leave an analysis in blocks and factors exact.
#[test]
fn a_fusion_is_the_sum_of_information() {
    for (bias, cycles) in [(BiasTreatment::Estimate, 1), (BiasTreatment::Known, 5)] {
        let problem = Problem { bias, ..problem(true, biases(0.5), 2) };
        for factors in [0, 7, 20] {
            let mut filter = fast(&problem, Some(1), cells(factors));
            for cycle in 1..=cycles {
                let observed = observations_of(&problem, true, cycle);
                let from = filter.forecast(WINDOW).unwrap();
                let prior = filter.dense_covariance();
                let analysis = filter.analyse(&from, &observed).unwrap();
                let (increment, covariance) =
                    sum_of_information(&problem, &prior, &observed, &analysis.background_departures);
                let found: Vec<f64> = all(&analysis.estimate)
                    .iter()
                    .zip(all(&from.estimate))
                    .map(|(after, before)| after - before)
                    .collect();
                let error = relative_difference(&found[..increment.len()], &increment)
                    .max(relative_difference(&flat(&filter.dense_covariance()), &flat(&covariance)));
                assert!(error < 1e-8, "{bias:?}, {factors} factors, cycle {cycle}: {error:e}");
            }
        }
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
                    filter.recall(&mut &memory[..]).unwrap();
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
