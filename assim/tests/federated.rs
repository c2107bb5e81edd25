//! The federated Kalman filter against the centralised one.

use crate::common::*;
use faer::{Mat, Side};
use isobar_assim::federated::{FederatedKalmanFilter, FederatedSettings};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Problem, Unknown};
use isobar_obs::{Calibration, Jacobian, LinearOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

pub const SYSTEMS: [&str; 3] = ["sondes", "polar", "ships"];

/// Three biases of sondes, two of polar, none of ships.
pub fn biases(drift: f64) -> Calibration {
    let mut calibration = calibration(3, 2, drift);
    let names = ["sondes/0", "polar/0", "sondes/1", "polar/1", "sondes/2"];
    calibration.parameters.iter_mut().zip(names).for_each(|(parameter, name)| parameter.name = name.into());
    calibration
}

/// Random observations of the three systems, each with biases of its own.
pub fn observations(problem: &Problem, cycle: usize) -> ObservationWindow {
    observations_of(problem, false, cycle)
}

/// The same, each of one cell if `within_cell`.
pub fn observations_of(problem: &Problem, within_cell: bool, cycle: usize) -> ObservationWindow {
    let mut observed = window(problem, 30, within_cell, cycle, 5);
    let old = observed.operator.linearize(&problem.background, &[]);
    let mut calibration = SparseRows::new();
    for row in 0..observed.len() {
        let system = SYSTEMS[row % 3];
        observed.reports[row].network = system.into();
        let parameters = problem.calibration.parameters.iter().enumerate();
        let own: Vec<usize> =
            parameters.filter(|(_, it)| it.name.starts_with(system)).map(|(number, _)| number).collect();
        let entries = old.calibration.row(row).iter().filter(|_| !own.is_empty());
        calibration.push_row(entries.map(|&(number, weight)| (own[number % own.len()], weight)));
    }
    observed.operator = Arc::new(LinearOperator { jacobian: Jacobian { state: old.state, calibration } });
    observed
}

fn federated(problem: &Problem, shares: [f64; 3], reset_every_cycles: Option<usize>) -> FederatedKalmanFilter {
    let systems = SYSTEMS.iter().zip(shares).map(|(name, share)| (name.to_string(), share)).collect();
    FederatedKalmanFilter::new(problem.clone(), FederatedSettings { systems, reset_every_cycles }).unwrap()
}

pub const SHARES: [f64; 3] = [0.5, 0.2, 0.3];

/// Largest relative difference from the centralised filter in estimates, covariance and χ² over some cycles.
fn difference(problem: &Problem, mut filter: FederatedKalmanFilter, cycles: usize) -> f64 {
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let mut largest: f64 = 0.0;
    for cycle in 1..=cycles {
        let observed = observations(problem, cycle);
        let (background, expected) = (filter.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
        let spreads = [&background, &expected].map(|it| it.estimate.state_spread.clone().unwrap());
        let (analysis, expected) =
            (filter.analyse(&background, &observed).unwrap(), reference.analyse(&expected, &observed).unwrap());
        largest = largest
            .max(relative_difference(&spreads[0], &spreads[1]))
            .max(relative_difference(analysis.estimate.state.values(), expected.estimate.state.values()))
            .max(relative_difference(&flat(&filter.covariance().to_owned()), &flat(&reference.covariance().to_owned())))
            .max((analysis.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs());
        if problem.bias == BiasTreatment::Estimate && !problem.calibration.is_empty() {
            largest = largest.max(relative_difference(&analysis.estimate.calibration, &expected.estimate.calibration));
        }
    }
    largest
}

#[test]
fn one_system_is_the_kalman_filter() {
    let mut calibration = biases(0.5);
    calibration.parameters.iter_mut().for_each(|parameter| parameter.name = format!("n/{}", parameter.name));
    let problem = problem(true, calibration, 2);
    for reset_every_cycles in [None, Some(1)] {
        let settings = FederatedSettings { systems: vec![("n".into(), 1.0)], reset_every_cycles };
        let mut filter = FederatedKalmanFilter::new(problem.clone(), settings).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        for cycle in 1..=4 {
            let observed = window(&problem, 14, false, cycle, 5);
            let from = filter.forecast(WINDOW).unwrap();
            assert_eq!(from, reference.forecast(WINDOW).unwrap());
            let found = filter.analyse(&from, &observed).unwrap();
            let expected = reference.analyse(&from, &observed).unwrap();
            assert_eq!(found.estimate, expected.estimate);
            assert!((found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-12);
        }
        let unknown = Unknown::Parameter(1);
        assert_eq!(column(&filter, unknown), column(&reference, unknown));
    }
}

/// WO 90/13794, p. 14: fused and divided after every analysis, the filter is the centralised one, if there are no biases.
#[test]
fn with_a_reset_in_every_cycle_and_without_biases_it_is_the_kalman_filter() {
    let estimated = problem(true, Calibration::default(), 2);
    let found = difference(&estimated, federated(&estimated, SHARES, Some(1)), 8);
    assert!(found < 1e-8, "{found:e}");
    for bias in [BiasTreatment::Known, BiasTreatment::Ignore] {
        let problem = Problem { bias, ..problem(true, biases(0.5), 2) };
        let found = difference(&problem, federated(&problem, SHARES, Some(1)), 8);
        assert!(found < 1e-8, "{bias:?}: {found:e}");
        let found = difference(&problem, federated(&problem, SHARES, None), 8);
        assert!(found > 1e-3, "{bias:?}, without reset: {found:e}");
    }
}

/// Information adds up where nothing happens to it on the way.
#[test]
fn without_model_error_it_is_the_kalman_filter_with_biases_and_with_any_reset() {
    let problem = Problem { model_error: None, ..problem(true, biases(0.0), 2) };
    // The model contracts, so that each cycle leaves directions with less variance beside the largest; in these the fusion has
    // fewer digits.
    for reset in [None, Some(1), Some(3)] {
        for (cycles, tolerance) in [(1, 1e-9), (3, 1e-7)] {
            let found = difference(&problem, federated(&problem, SHARES, reset), cycles);
            assert!(found < tolerance, "reset {reset:?}, {cycles} cycles: {found:e}");
        }
    }
}

/// Smallest eigenvalue of a difference, relative to the largest of the first.
fn least_excess(larger: &Mat<f64>, smaller: &Mat<f64>) -> f64 {
    let largest = *larger.self_adjoint_eigenvalues(Side::Lower).unwrap().last().unwrap();
    (larger - smaller).self_adjoint_eigenvalues(Side::Lower).unwrap()[0] / largest
}

#[test]
fn its_covariance_is_nowhere_less_than_that_of_the_kalman_filter() {
    let problem = problem(true, biases(0.5), 2);
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let mut filters = [Some(1), Some(3), None].map(|reset| federated(&problem, SHARES, reset));
    let trace = |matrix: &Mat<f64>| (0..matrix.nrows()).map(|i| matrix[(i, i)]).sum::<f64>();
    let mut losses = [0.0; 3];
    for cycle in 1..=10 {
        let observed = observations(&problem, cycle);
        let from_reference = reference.forecast(WINDOW).unwrap();
        reference.analyse(&from_reference, &observed).unwrap();
        let optimal = reference.covariance().to_owned();
        for (filter, loss) in filters.iter_mut().zip(&mut losses) {
            let from_filter = filter.forecast(WINDOW).unwrap();
            filter.analyse(&from_filter, &observed).unwrap();
            let claimed = filter.covariance().to_owned();
            let least = least_excess(&claimed, &optimal);
            assert!(least > -1e-10, "cycle {cycle}: {least:e}");
            *loss = trace(&claimed) / trace(&optimal) - 1.0;
        }
    }
    let [reset, seldom, never] = losses;
    assert!(0.0 < reset && reset < seldom && seldom < never, "{losses:?}");
}

/// What the master claims, and what its gains make of the actual errors: `ActualErrors` on the same observations.
#[test]
fn its_errors_are_nowhere_more_than_it_claims() {
    use isobar_assim::actual_errors::ActualErrors;
    use isobar_assim::covariance::dense;
    use isobar_assim::response::Responder;
    let problem = problem(true, biases(0.5), 2);
    let parameters = &problem.calibration.parameters;
    let variance: Vec<f64> = parameters.iter().map(|it| it.sigma_prior.powi(2)).collect();
    let kept = problem.calibration.kept(WINDOW);
    let added: Vec<f64> = parameters.iter().map(|it| it.drift.added_variance(WINDOW)).collect();
    let mut actual = ActualErrors::new(dense(&*problem.background_error).as_ref(), &[0.0; 5], &variance);
    let a = ActualErrors::propagator(&*problem.model, &problem.background, 1).unwrap();
    let q = dense(&**problem.model_error.as_ref().unwrap());
    let mut filter = federated(&problem, SHARES, Some(1));
    for cycle in 1..=6 {
        let observed = observations(&problem, cycle);
        let background = filter.forecast(WINDOW).unwrap();
        actual.forecast(a.as_ref(), Some(q.as_ref()), &kept, &added, &[0.0; 5]);
        let responder = Responder::new(&filter, &background, &observed);
        let gain = responder.gain().unwrap();
        filter.analyse(&background, &observed).unwrap();
        let jacobian = observed.operator.linearize(&problem.background, &[0.0; 5]);
        let error_covariance = observed.error_regression.covariance(&observed.sigma);
        actual.analyse(&gain, &jacobian, &error_covariance, true);
        let claimed = filter.covariance();
        for (i, actual) in actual.mean_squares().into_iter().enumerate() {
            let claimed = claimed[(i, i)];
            assert!(actual <= claimed * (1.0 + 1e-9), "cycle {cycle}, unknown {i}: {actual} beside {claimed}");
        }
    }
}

#[test]
fn what_cannot_be_divided_is_refused() {
    let message = |problem: &Problem, systems: &[(&str, f64)]| {
        let systems = systems.iter().map(|&(name, share)| (name.to_string(), share)).collect();
        let settings = FederatedSettings { systems, reset_every_cycles: None };
        FederatedKalmanFilter::new(problem.clone(), settings).err().unwrap().to_string()
    };
    let mut problem = problem(true, biases(0.0), 2);
    let text = message(&problem, &[("sondes", 0.5), ("polar", 0.6)]);
    assert!(text.contains("must be positive and sum to 1, but sum to 1.1"), "{text}");
    let text = message(&problem, &[("sondes", 0.5), ("polars", 0.5)]);
    assert!(text.contains("the bias polar/0 is of no observing system"), "{text}");
    let mut filter = federated(&problem, SHARES, None);
    let from_filter = filter.forecast(WINDOW).unwrap();
    let mut observed = observations(&problem, 1);
    observed.reports[3].network = "buoys".into();
    let text = filter.analyse(&from_filter, &observed).unwrap_err().to_string();
    assert!(text.contains("no local filter for the network buoys"), "{text}");
    observed.reports.iter_mut().for_each(|report| report.network = "ships".into());
    let text = filter.analyse(&from_filter, &observed).unwrap_err().to_string();
    assert!(text.contains("an observation of ships has the bias"), "{text}");
    problem.calibration.covariances.insert((1, 0), 0.5);
    let text = message(&problem, &[("sondes", 0.5), ("polar", 0.5)]);
    assert!(text.contains("the biases polar/0 and sondes/0 are known to be correlated"), "{text}");
    problem.calibration.covariances = [((2, 0), 0.5)].into();
    problem.memory_limit_bytes = 100_000;
    assert!(message(&problem, &[("sondes", 0.5), ("polar", 0.5)]).contains("2 dense Kalman filters for 40 values"));
}

/// A recalibration reaches the local filter whose bias it is: the fused covariance is wider by what it adds, and nothing
/// else in it changes. What goes together between systems has no place.
#[test]
fn a_recalibration_widens_the_fused_covariance_by_just_that() {
    let problem = problem(true, biases(0.5), 2);
    let m = problem.background.values().len();
    for reset_every_cycles in [None, Some(1)] {
        let [mut widened, mut same] = [(); 2].map(|()| federated(&problem, SHARES, reset_every_cycles));
        for filter in [&mut widened, &mut same] {
            let from_filter = filter.forecast(WINDOW).unwrap();
            filter.analyse(&from_filter, &observations(&problem, 1)).unwrap();
        }
        let mut added = Mat::<f64>::zeros(5, 5);
        (added[(0, 0)], added[(2, 2)], added[(3, 3)]) = (0.7, 0.4, 1.1);
        (added[(0, 2)], added[(2, 0)]) = (0.3, 0.3);
        widen(&mut widened, added.as_ref()).unwrap();
        // Once at once, and once out of the local filters, by a forecast that mixes nothing into the biases but their drift.
        for cycle in 1..=2 {
            if cycle == 2 {
                let kept = problem.calibration.kept(WINDOW);
                added = Mat::from_fn(5, 5, |i, j| kept[i] * added[(i, j)] * kept[j]);
            }
            let difference = widened.covariance() - same.covariance();
            for (i, j) in (0..m + 5).flat_map(|i| (0..m + 5).map(move |j| (i, j))) {
                let expected = if i >= m && j >= m { added[(i - m, j - m)] } else { 0.0 };
                assert!((difference[(i, j)] - expected).abs() < 1e-10, "{i} {j}: {}", difference[(i, j)]);
            }
            if cycle == 1 {
                widened.forecast(WINDOW).unwrap();
                same.forecast(WINDOW).unwrap();
            }
        }
        // The biases 0 and 1 are of sondes and polar.
        (added[(0, 1)], added[(1, 0)], added[(1, 1)]) = (0.1, 0.1, 0.5);
        let refused = widen(&mut widened, added.as_ref()).expect_err("it is refused").to_string();
        assert!(refused.contains("between the biases sondes/0 and polar/0"), "{refused}");
    }
}
