//! Observations within a window: the first guess at appropriate time, members and 4D-Var on their own trajectories.

use crate::common::*;
use isobar_assim::appropriate_time::shift;
use isobar_assim::ensemble::EnsembleTransformKalmanFilter;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::testing::Still;
use isobar_assim::variational::{FourDVar, FourDVarSettings, ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, Estimate, Problem, Whitened};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Adjoint, Duration, Layout, Model, State, TangentLinear};
use isobar_obs::{
    ErrorRegression, Jacobian, LinearOperator, ObservationWindow, SparseRows, TimedObservations, WithinWindow,
};
use std::sync::Arc;

/// An hour.
const STEP: Duration = Duration::from_seconds(3600);

/// A matrix model with six steps in a window.
struct Hourly(MatrixModel);

impl Model for Hourly {
    fn layout(&self) -> &Arc<Layout> {
        self.0.layout()
    }
    fn time_step(&self) -> Duration {
        STEP
    }
    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.0.largest_time_step_s(x)
    }
    fn step(&self, x: &mut State) {
        self.0.step(x);
    }
}

impl TangentLinear for Hourly {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.0.step_tl(at, columns);
    }
}

impl Adjoint for Hourly {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        self.0.step_ad(at, columns);
    }
}

/// A perfect linear model, a background that is not zero, and three biases.
fn hourly() -> Problem {
    let layout = layout();
    let background = State::from_values(&layout, standard_normals(&mut stream(3, "background"), layout.len()));
    Problem {
        model: Arc::new(Hourly(model(&layout, true, 2))),
        background,
        model_error: None,
        ..problem(true, calibration(2, 1, 0.0), 2)
    }
}

/// Several windows as one, whose observations are valid so long before its end.
fn merged(windows: &[ObservationWindow], lags: &[Duration]) -> ObservationWindow {
    let mut all = windows[0].clone();
    let (mut state, mut calibration, mut of_each) = (SparseRows::new(), SparseRows::new(), Vec::new());
    (all.reports, all.times, all.values, all.sigma) = Default::default();
    for (window, &lag) in windows.iter().zip(lags) {
        let layout = layout();
        let jacobian = window.operator.linearize(&State::zeros(&layout), &[0.0; 3]);
        for row in 0..window.len() {
            state.push_row(jacobian.state.row(row).iter().copied());
            calibration.push_row(jacobian.calibration.row(row).iter().copied());
            of_each.push(lag);
        }
        all.reports.extend(window.reports.iter().cloned());
        all.times.extend(&window.times);
        all.values.extend(&window.values);
        all.sigma.extend(&window.sigma);
    }
    let operator = Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } });
    ObservationWindow { operator: WithinWindow::around(operator, of_each), ..all }
}

/// Observations at these numbers of hours of a cycle, five each.
fn hours(problem: &Problem, cycle: usize, hours: &[f64]) -> ObservationWindow {
    let windows: Vec<_> = (0..hours.len()).map(|k| window(problem, 5, false, 10 * cycle + k, 5)).collect();
    let lags: Vec<_> = hours.iter().map(|hour| Duration::from_seconds(((6.0 - hour) * 3600.0) as i64)).collect();
    merged(&windows, &lags)
}

/// As seen from the trajectory from a state.
fn seen(problem: &Problem, start: &State, observed: &ObservationWindow) -> ObservationWindow {
    let of = |within: TimedObservations<'_>| shift(&*problem.model, start, WINDOW, within, problem.calibration.len());
    observed.at_appropriate_time(of).unwrap().into_owned()
}

fn analysed(method: &mut dyn Assimilator, observed: &ObservationWindow) -> Estimate {
    let from = method.forecast(WINDOW).unwrap();
    method.analyse(&from, observed).unwrap().estimate
}

fn states(problem: &Problem) -> Vec<State> {
    isobar_model::forecast::trajectory(&*problem.model, &problem.background, 6).unwrap()
}

#[test]
fn the_innovation_is_the_one_at_the_time_of_the_observation() {
    let problem = hourly();
    let observed = hours(&problem, 1, &[1.0, 3.0, 4.25, 6.0]);
    let observed = seen(&problem, &problem.background, &observed);
    let mut filter = KalmanFilter::new(problem.clone()).unwrap();
    let from = filter.forecast(WINDOW).unwrap();
    let found = filter.analyse(&from, &observed).unwrap();
    let (x, jacobian) = (states(&problem), observed.operator.linearize(&problem.background, &[0.0; 3]).state);
    for (row, d) in found.background_departures.iter().enumerate() {
        let at = |hour: usize| jacobian.row_dot(row, x[hour].values());
        let seen = [at(1), at(3), 0.75 * at(4) + 0.25 * at(5), at(6)][row / 5];
        assert!((d - (observed.values[row] - seen)).abs() < 1e-13, "{row}: {d}");
    }
    // The increment is seen as if it were that at the analysis.
    let dx = &found.estimate.state - &from.estimate.state;
    let dh =
        observed.operator.linearize(&from.estimate.state, &[0.0; 3]).apply(dx.values(), &found.estimate.calibration);
    let departures = found.background_departures.iter().zip(&found.analysis_departures).zip(dh);
    departures.for_each(|((d, left), dh)| assert!((d - left - dh).abs() < 1e-13));
}

/// Every method that takes an operator takes this one: it is as if y − δ were observed.
#[test]
fn a_shift_of_the_operator_is_one_of_the_observations() {
    let problem = hourly();
    let observed = seen(&problem, &problem.background, &hours(&problem, 1, &[2.0, 3.5, 6.0]));
    let within = observed.operator.within_window().unwrap();
    let values = observed.values.iter().zip(within.shift).map(|(y, shift)| y - shift).collect();
    let plain = ObservationWindow { values, operator: Arc::clone(within.whole), ..observed.clone() };
    let settings = ThreeDVarSettings { covariance_scale: 1.0, tolerance: 1e-13, max_iterations: 500 };
    let methods: [Box<dyn Fn() -> Box<dyn Assimilator>>; 2] = [
        Box::new(|| Box::new(KalmanFilter::new(problem.clone()).unwrap())),
        Box::new(|| Box::new(ThreeDVar::new(problem.clone(), settings.clone()).unwrap())),
    ];
    for method in methods {
        let [found, expected] = [&observed, &plain].map(|observed| analysed(&mut *method(), observed));
        let error = estimate_difference(&found, &expected);
        assert!(error < 1e-12, "{error:e}");
    }
}

#[test]
fn what_does_not_move_is_seen_the_same_at_all_times() {
    let problem = hourly();
    let observed = hours(&problem, 1, &[0.5, 2.0, 5.9]);
    let still = Still(layout());
    let within = observed.operator.within_window().unwrap();
    let shift = shift(&still, &problem.background, WINDOW, within, 3).unwrap();
    assert!(shift.iter().all(|shift| *shift == 0.0), "{shift:?}");
    // Nor does it matter how an observation at the end is seen.
    let all_at_end = hours(&problem, 1, &[6.0, 6.0]);
    assert!(all_at_end.operator.within_window().is_none() && !all_at_end.is_within_window());
}

/// Kalman's filter, hour by hour, is what a trajectory through the window must come to if the model makes no error.
fn hour_by_hour(problem: &Problem) -> (Estimate, ObservationWindow) {
    let mut filter = KalmanFilter::new(problem.clone()).unwrap();
    let windows: Vec<_> = (0..6).map(|k| window(problem, 5, false, 10 + k, 5)).collect();
    let mut last = None;
    for window in &windows {
        let from = filter.forecast(STEP).unwrap();
        last = Some(filter.analyse(&from, window).unwrap().estimate);
    }
    let lags: Vec<_> = (0..6).map(|k| STEP * (5 - k)).collect();
    (last.unwrap(), merged(&windows, &lags))
}

fn four_d_var(window_cycles: usize) -> FourDVarSettings {
    FourDVarSettings { window_cycles, covariance_scale: 1.0, outer_loops: 1, tolerance: 1e-13, max_iterations: 500 }
}

fn etkf(problem: &Problem) -> EnsembleTransformKalmanFilter {
    EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(44)).unwrap()
}

#[test]
fn four_d_var_and_members_on_their_trajectories_are_the_filter_hour_by_hour() {
    let problem = hourly();
    let (expected, observed) = hour_by_hour(&problem);
    let observed = seen(&problem, &problem.background, &observed);
    let found = analysed(&mut FourDVar::new(problem.clone(), four_d_var(1)).unwrap(), &observed);
    let error = relative_difference(found.state.values(), expected.state.values())
        .max(relative_difference(&found.calibration, &expected.calibration));
    assert!(error < 1e-8, "4D-Var: {error:e}");
    let found = analysed(&mut etkf(&problem).asynchronous().unwrap(), &observed);
    let error = estimate_difference(&found, &expected);
    assert!(error < 1e-8, "the asynchronous filter: {error:e}");
    // With the mean's trajectory alone, increments are in the wrong place.
    let found = analysed(&mut etkf(&problem), &observed);
    assert!(estimate_difference(&found, &expected) > 0.01);
}

#[test]
fn between_time_steps_members_and_four_d_var_see_the_same() {
    let problem = hourly();
    let mut observed = seen(&problem, &problem.background, &hours(&problem, 1, &[0.5, 3.0, 4.75, 6.0]));
    // Errors of one time are correlated.
    let mut regression = ErrorRegression::default();
    for row in 0..observed.len() {
        let before = if row % 5 == 0 { Vec::new() } else { vec![(row - 1, 0.6)] };
        regression.push(before, if row % 5 == 0 { 1.0 } else { 0.64 });
    }
    for is_correlated in [false, true] {
        if is_correlated {
            observed.error_regression = regression.clone();
        }
        let methods: [Box<dyn Assimilator>; 2] = [
            Box::new(FourDVar::new(problem.clone(), four_d_var(1)).unwrap()),
            Box::new(etkf(&problem).asynchronous().unwrap()),
        ];
        let [four_d_var, members] = methods.map(|method| analysed(&mut Whitened::new(method), &observed));
        let error = relative_difference(four_d_var.state.values(), members.state.values())
            .max(relative_difference(&four_d_var.calibration, &members.calibration));
        assert!(error < 1e-8, "correlated {is_correlated}: {error:e}");
    }
}

#[test]
fn a_window_of_four_d_var_keeps_the_times_of_its_observations_over_a_checkpoint() {
    let problem = hourly();
    let build = || FourDVar::new(problem.clone(), four_d_var(2)).unwrap();
    let mut method = build();
    let first = seen(&problem, &problem.background, &hours(&problem, 1, &[1.0, 2.5, 6.0]));
    let start = analysed(&mut method, &first).state;
    let mut again = build();
    again.recall(&mut &method.memory().unwrap()[..]).unwrap();
    let second = seen(&problem, &start, &hours(&problem, 2, &[1.0, 2.5, 6.0]));
    let [a, b] = [&mut method, &mut again].map(|method| analysed(method, &second));
    assert_eq!((a.state.values(), &a.calibration), (b.state.values(), &b.calibration));
}
