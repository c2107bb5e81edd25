//! The smoother of a time volume is that of a filter that has the unknowns of the window among its own.

use crate::common::{self, *};
use isobar_assim::Assimilator;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::time_volume::{AmplitudeEvolution, Target, TimeShape, TimeVolume, TimeVolumeSettings};
use isobar_obs::{Drift, Jacobian, LinearOperator, ObservationWindow, Placement, SparseRows};
use std::sync::Arc;

const LAG: usize = 3;

/// Two amplitudes of a daily cycle in the first bias, and an AR(1) process in the second, of which the dense filter has a column
/// each; with as many common factors as values nothing is lost.
#[test]
fn smoothed_estimates_are_those_of_the_recursion_with_all_unknowns() {
    let base = problem(true, calibration(3, 0, 0.3), 5);
    let process = Drift::FirstOrder { sigma: 1.1, correlation_time: WINDOW * 2 };
    let mut extended = base.clone();
    for (sigma_prior, drift) in [(0.9, Drift::CONSTANT), (0.9, Drift::CONSTANT), (1.1, process)] {
        let mut parameter = base.calibration.parameters[0].clone();
        parameter.name = format!("c{}", extended.calibration.len());
        (parameter.sigma_prior, parameter.drift, parameter.placement) = (sigma_prior, drift, Placement::Shared);
        extended.calibration.parameters.push(parameter);
    }
    let shape = TimeShape::Sinusoid { period: DAY };
    let with_columns = |observed: &ObservationWindow| {
        let own = observed.operator.linearize(&base.background, &[0.0; 3]);
        let mut rows = SparseRows::new();
        for row in 0..observed.len() {
            let entries = own.calibration.row(row).to_vec();
            let weight = |number| entries.iter().filter(|entry| entry.0 == number).map(|entry| entry.1).sum::<f64>();
            let daily = (0..2).map(|f| (3 + f, weight(0) * shape.value(f, observed.time)));
            rows.push_row(entries.iter().copied().chain(daily).chain([(5, weight(1))]));
        }
        let operator = Arc::new(LinearOperator { jacobian: Jacobian { state: own.state, calibration: rows } });
        ObservationWindow { operator, ..observed.clone() }
    };
    let first_order = AmplitudeEvolution::FirstOrder { sigma: 1.1, correlation_time: WINDOW * 2 };
    let factors = vec![
        factor("day", Target::Observations(vec![0]), shape, constant(Some(0.9))),
        factor("process", Target::Observations(vec![1]), TimeShape::Constant, first_order),
    ];
    let filter = FastKalmanSettings {
        factors: base.background.values().len(),
        residual: Residual::Probe { count: 2 },
        ..common::settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    let settings = TimeVolumeSettings { keep_before: true, filter, ..volume_settings(3, factors) };
    let mut volume = TimeVolume::new(base.clone(), settings, None).unwrap().smoothing(LAG).unwrap();
    let mut recursion = KalmanFilter::new(extended).unwrap().smoothing(LAG).unwrap();
    assert_eq!(lag(&volume), Some(LAG));
    let windows: Vec<ObservationWindow> = (1..=7).map(|cycle| window(&base, 14, false, cycle, 5)).collect();
    for (number, observed) in windows.iter().enumerate() {
        let from = volume.forecast(WINDOW).unwrap();
        volume.analyse(&from, observed).unwrap();
        let from = recursion.forecast(WINDOW).unwrap();
        recursion.analyse(&from, &with_columns(observed)).unwrap();
        for ago in 0..=number.min(LAG) {
            let (found, expected) = (smoothed(&volume, ago).unwrap(), smoothed(&recursion, ago).unwrap());
            let time = windows[number - ago].time;
            let c = &expected.calibration;
            let day: f64 = (0..2).map(|f| c[3 + f] * shape.value(f, time)).sum();
            let sigma = expected.calibration_spread.as_ref().unwrap()[2];
            let errors = [
                relative_difference(found.state.values(), expected.state.values()),
                relative_difference(found.state_spread.as_ref().unwrap(), expected.state_spread.as_ref().unwrap()),
                relative_difference(&found.calibration, &[c[0] + day, c[1] + c[5], c[2]]),
                (found.calibration_spread.unwrap()[2] / sigma - 1.0).abs(),
            ];
            assert!(errors.iter().all(|error| *error < 1e-8), "cycle {}, {ago} ago: {errors:?}", number + 1);
        }
        assert!(smoothed(&volume, number.min(LAG) + 1).is_none());
    }
    // The memory holds the past.
    let mut other = volume.boxed_clone();
    other.recall(&mut &volume.memory().unwrap()[..]).unwrap();
    assert_eq!(smoothed(&*other, LAG), smoothed(&volume, LAG));
}
