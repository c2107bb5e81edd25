//! The Fast Kalman Filter with local factors in the limits in which it is exact.

use crate::common::*;
use isobar_assim::fast_kalman::{BlockShape, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::{Assimilator, Unknown};

/// Three tiles by two, the factors of each with the whole domain as their support, and as many as there can be.
fn everything() -> LocalFactorSettings {
    LocalFactorSettings {
        blocks: BlockShape::Cell,
        per_tile: 40,
        model_error_per_tile: 40,
        tile_m: 2.0,
        support_tiles: 3,
        mixed: 0,
        residual: Residual::Persist,
    }
}

/// With all factors, every tile next to every other, and biases that do not drift, nothing is approximated: neither
/// forecast nor analysis. (Of a drift, what two blocks have in common through it is dropped.)
#[test]
fn with_all_factors_it_is_the_kalman_filter() {
    for (shared, local) in [(0, 0), (3, 0), (0, 4), (3, 4)] {
        for within_cell in [true, false] {
            let problem = problem(true, calibration(shared, local, 0.0), 2);
            let mut tiled = LocalFastKalmanFilter::with_local_factors(problem.clone(), everything()).unwrap();
            let mut reference = KalmanFilter::new(problem.clone()).unwrap();
            for cycle in 1..=6 {
                let observed = window(&problem, 14, within_cell, cycle, 5);
                let (background, expected) = (tiled.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
                let spread = |background: &isobar_assim::Background| background.estimate.state_spread.clone().unwrap();
                let error = relative_difference(&spread(&background), &spread(&expected));
                assert!(
                    error < 1e-9,
                    "{shared} shared, {local} local, cycle {cycle}: spread of the background {error:e}"
                );
                let found = tiled.analyse(&background, &observed).unwrap();
                let expected = reference.analyse(&expected, &observed).unwrap();
                let pairs = [
                    (found.estimate.state.values(), expected.estimate.state.values()),
                    (found.estimate.state_spread.as_ref().unwrap(), expected.estimate.state_spread.as_ref().unwrap()),
                    (&found.estimate.calibration, &expected.estimate.calibration),
                ];
                for (what, (found, expected)) in ["state", "spread", "biases"].iter().zip(pairs) {
                    if !expected.is_empty() {
                        let error = relative_difference(found, expected);
                        assert!(error < 1e-9, "{shared} shared, {local} local, cycle {cycle}: {what} {error:e}");
                    }
                }
                assert!((found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
            }
            let unknowns = [Unknown::Value(7)].into_iter().chain((0..shared + local).map(Unknown::Parameter));
            for unknown in unknowns {
                let column =
                    |method: &dyn Assimilator| method.can().joint_errors.unwrap().covariance_column(unknown).unwrap();
                let (found, expected) = (column(&tiled), column(&reference));
                let error = relative_difference(&found.state, &expected.state);
                assert!(error < 1e-8, "{shared} shared, {local} local: covariance with {unknown:?} {error:e}");
            }
        }
    }
}
