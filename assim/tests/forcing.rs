//! A forcing of the model: every method carries it on from cycle to cycle.

use crate::common::*;
use crate::contracts::all;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::testing::{Trial, check_assimilator};
use isobar_assim::variational::{FourDVar, FourDVarSettings};
use isobar_assim::{Assimilator, BiasTreatment, Problem};
use isobar_model::forecast::forecast;
use isobar_model::{Adjoint, Duration, Forced, Forcing, Layout, Source, State, TimeFunction};
use isobar_obs::ObservationWindow;
use std::sync::Arc;

/// Sources of both variables, whose periods are no multiples of the window.
fn forcing(layout: &Layout) -> Arc<Forcing> {
    let source = |variable: usize, hours: i64| {
        let pattern = (0..layout.grid.cells()).map(|cell| 2e-4 * (cell as f64 + 2.0 * variable as f64).sin()).collect();
        let (period, highest_at) = (Duration::from_seconds(3600 * hours), Duration::from_seconds(7000));
        Source { variable, pattern, function: TimeFunction::Sinusoid { period, highest_at } }
    };
    Arc::new(Forcing { sources: vec![source(0, 17), source(1, 31)] })
}

fn forced(problem: &Problem) -> Problem {
    let layout = problem.background.layout();
    let model: Arc<dyn Adjoint> = Forced::of(Arc::clone(&problem.model), &forcing(layout)).unwrap();
    problem.clone().with_model(model)
}

/// Observations that would have been made of a state that is further by this.
fn shifted(observed: &ObservationWindow, problem: &Problem, by: &State) -> ObservationWindow {
    let none = vec![0.0; problem.calibration.len()];
    let jacobian = observed.operator.linearize(by, &none);
    let values = observed.values.iter().zip(jacobian.apply(by.values(), &none)).map(|(value, more)| value + more);
    ObservationWindow { values: values.collect(), ..observed.clone() }
}

/// In a linear model the effect of a forcing is the same from every state. A method whose model has it, with observations of what
/// it does, therefore is the method without it, further by what it does: for whatever method, through a memory that is recalled,
/// and in a copy that forecasts ahead.
#[test]
fn every_method_carries_a_forcing_on_from_cycle_to_cycle() {
    let plain = Problem { bias: BiasTreatment::Estimate, ..problem(true, calibration(2, 1, 0.7), 2) };
    let with_forcing = forced(&plain);
    let pairs = all(&plain).into_iter().zip(all(&with_forcing)).filter(|pair| pair.0.0 != "climatology");
    for ((name, build), (_, build_forced)) in pairs {
        let (mut method, mut other, mut effect) = (build(), build_forced(), plain.background.clone());
        for cycle in 1..=4 {
            forecast(&*with_forcing.model, &mut effect, 1).unwrap();
            let (from, from_other) = (method.forecast(WINDOW).unwrap(), other.forecast(WINDOW).unwrap());
            let observed = window(&plain, 14, false, cycle, 5);
            let further = shifted(&observed, &plain, &effect);
            let analysis = method.analyse(&from, &observed).unwrap().estimate;
            let analysis_other = other.analyse(&from_other, &further).unwrap().estimate;
            for (own, other) in [(&from.estimate, &from_other.estimate), (&analysis, &analysis_other)] {
                let mut expected = own.clone();
                expected.state += &isobar_model::Increment::from_values(effect.layout(), effect.values().to_vec());
                assert_eq!(expected.state.time(), other.state.time(), "{name}");
                let error = estimate_difference(other, &expected);
                // A minimiser stops at as much, and single precision is no more.
                let most = if name.contains("single") { 1e-4 } else { 1e-6 };
                assert!(error < most, "{name}, cycle {cycle}: {error:e}");
            }
            let memory = other.memory().unwrap();
            other = build_forced();
            other.recall(&mut &memory[..]).unwrap();
            assert!(isobar_model::vector::norm(effect.values()) > 1.0);
        }
        let (mut ahead, mut ahead_other) = (method.boxed_clone(), other.boxed_clone());
        for _ in 0..2 {
            forecast(&*with_forcing.model, &mut effect, 1).unwrap();
            let [own, other] = [&mut ahead, &mut ahead_other].map(|it| it.forecast(WINDOW).unwrap().estimate.state);
            let expected: Vec<f64> = own.values().iter().zip(effect.values()).map(|(a, b)| a + b).collect();
            let error = relative_difference(other.values(), &expected);
            assert!(error < 1e-4, "{name}, ahead: {error:e}");
        }
    }
}

#[test]
fn every_method_keeps_the_contract_with_a_forcing() {
    let problem = forced(&problem(true, calibration(2, 1, 0.7), 2));
    let observed: Vec<ObservationWindow> = (1..=3).map(|cycle| window(&problem, 14, false, cycle, 5)).collect();
    for (name, build) in all(&problem) {
        let perturbs_observations = name == "enkf";
        check_assimilator(&Trial { build: &*build, window: WINDOW, observed: &observed, perturbs_observations });
    }
}

/// The trajectory of a window, and the forecast from its analysis, have the forcing of their own times: without model error they
/// are the Kalman filter's.
#[test]
fn four_d_var_with_a_forcing_is_the_kalman_smoother() {
    let problem = forced(&Problem { model_error: None, ..problem(true, calibration(2, 0, 0.0), 2) });
    let settings = FourDVarSettings {
        window_cycles: 5,
        covariance_scale: 1.0,
        outer_loops: 2,
        tolerance: 1e-13,
        max_iterations: 500,
    };
    let mut variational = FourDVar::new(problem.clone(), settings).unwrap();
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    for cycle in 1..=5 {
        let observed = window(&problem, 14, false, cycle, 5);
        let from_variational = variational.forecast(WINDOW).unwrap();
        let from_reference = reference.forecast(WINDOW).unwrap();
        let found = variational.analyse(&from_variational, &observed).unwrap().estimate;
        let expected = reference.analyse(&from_reference, &observed).unwrap().estimate;
        let error = relative_difference(found.state.values(), expected.state.values());
        assert!(error < 1e-8 && found.state.time() == expected.state.time(), "cycle {cycle}: {error:e}");
    }
}
