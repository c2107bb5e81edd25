//! Factors on R, Q and B that are found from innovations.

use crate::common::*;
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::covariance::randomize;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::{AdaptedCovariance, Adaptive, AdaptiveSettings, Assimilator, EstimatedParameter, Problem};
use isobar_model::State;
use isobar_model::random::{standard_normals, stream};
use isobar_obs::{Calibration, ObservationWindow};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// True covariances as multiples of the assumed ones: of each network's observations and of the model.
#[derive(Clone, Copy)]
struct Truth {
    observations: [f64; 2],
    model: f64,
}

/// A true world whose observations have the operators and the assumed errors of `window`.
struct World {
    truth: Truth,
    state: State,
    biases: Vec<f64>,
    random: ChaCha8Rng,
}

const NETWORKS: [&str; 2] = ["sondes", "polar"];

impl World {
    fn new(problem: &Problem, truth: Truth, seed: u64) -> Self {
        let mut random = stream(seed, "world");
        let mut state = problem.background.clone();
        let deviation = randomize(&*problem.background_error, &mut random);
        state.values_mut().iter_mut().zip(deviation).for_each(|(value, change)| *value += change);
        let normals = standard_normals(&mut random, problem.calibration.len());
        let parameters = problem.calibration.parameters.iter();
        let biases = parameters.zip(normals).map(|(parameter, normal)| parameter.sigma_prior * normal).collect();
        Self { truth, state, biases, random }
    }

    fn cycle(&mut self, problem: &Problem, cycle: usize, seed: u64) -> ObservationWindow {
        problem.model.step(&mut self.state);
        let error = randomize(&**problem.model_error.as_ref().unwrap(), &mut self.random);
        let factor = self.truth.model.sqrt();
        self.state.values_mut().iter_mut().zip(error).for_each(|(value, change)| *value += factor * change);
        let mut observed = window(problem, 40, false, cycle, seed);
        observed.values = observed.operator.simulate(&self.state, &self.biases);
        let normals = standard_normals(&mut self.random, observed.len());
        for (row, normal) in normals.iter().enumerate() {
            // Both variables in both.
            let network = row / 2 % 2;
            observed.reports[row].network = NETWORKS[network].into();
            observed.reports[row].variable = row % 2;
            observed.values[row] += self.truth.observations[network].sqrt() * observed.sigma[row] * normal;
        }
        observed
    }
}

const MEMORY: usize = 40;

fn adaptive(problem: &Problem, method: Box<dyn Assimilator>, observation_error: bool, of_model: bool) -> Adaptive {
    let covariance = problem.model_error.clone().unwrap();
    let state_error = of_model.then_some(AdaptedCovariance { name: "model_error", covariance, scale: 1.0 });
    let settings = AdaptiveSettings { observation_error, state_error, memory_cycles: MEMORY };
    Adaptive::new(method, problem.background.layout().clone(), settings).unwrap()
}

/// The factors after so many cycles, and the mean square error of the state over the second half of them.
fn run(
    problem: &Problem,
    method: &mut dyn Assimilator,
    truth: Truth,
    cycles: usize,
    seed: u64,
) -> (Vec<EstimatedParameter>, f64) {
    let mut world = World::new(problem, truth, seed);
    let (mut sum, mut count) = (0.0, 0);
    for cycle in 1..=cycles {
        let observed = world.cycle(problem, cycle, seed);
        let from = method.forecast(WINDOW).unwrap();
        let analysis = method.analyse(&from, &observed).unwrap();
        if 2 * cycle > cycles {
            let differences = (&analysis.estimate.state - &world.state).values().to_vec();
            sum += differences.iter().map(|value| value * value).sum::<f64>();
            count += differences.len();
        }
    }
    (parameters(method), sum / count as f64)
}

fn kalman(problem: &Problem) -> Box<dyn Assimilator> {
    Box::new(KalmanFilter::new(problem.clone()).unwrap())
}

/// (ln factor − ln truth) in claimed standard deviations.
fn deviation(parameter: &EstimatedParameter, truth: f64) -> f64 {
    (parameter.value / truth).ln() / (parameter.sigma.unwrap() / parameter.value)
}

fn truth_of(parameter: &EstimatedParameter, truth: Truth) -> f64 {
    match NETWORKS.iter().position(|name| parameter.name.contains(name)) {
        Some(network) => truth.observations[network],
        None => truth.model,
    }
}

/// Over several seeds: the mean square deviation of all factors from the truth in claimed standard deviations is near one, and
/// none is far off.
fn check(problem: &Problem, truth: Truth, of_model: bool) {
    let (mut squares, mut count, mut widest): (f64, usize, f64) = (0.0, 0, 0.0);
    for seed in 1..=8 {
        let mut method = adaptive(problem, kalman(problem), true, of_model);
        let (parameters, _) = run(problem, &mut method, truth, 4 * MEMORY, seed);
        assert_eq!(parameters.len(), 4 + of_model as usize);
        for parameter in &parameters {
            let own = deviation(parameter, truth_of(parameter, truth));
            assert_eq!(parameter.verdict, "determined", "{parameter:?}");
            squares += own * own;
            count += 1;
            widest = widest.max(own.abs());
        }
    }
    let mean = squares / count as f64;
    assert!(mean > 0.1 && mean < 1.6 && widest < 3.5, "mean square {mean}, widest {widest}");
}

#[test]
fn right_errors_stay_right() {
    let problem = problem(true, calibration(2, 0, 0.0), 2);
    check(&problem, Truth { observations: [1.0, 1.0], model: 1.0 }, true);
}

#[test]
fn observation_errors_wrong_by_four_are_found() {
    let problem = problem(true, calibration(2, 0, 0.0), 2);
    check(&problem, Truth { observations: [4.0, 0.25], model: 1.0 }, false);
}

#[test]
fn wrong_errors_of_observations_and_model_are_found_together() {
    let problem = problem(true, Calibration::default(), 2);
    check(&problem, Truth { observations: [4.0, 1.0], model: 4.0 }, true);
    check(&problem, Truth { observations: [0.25, 1.0], model: 0.25 }, true);
}

#[test]
fn scores_improve_where_the_errors_are_wrong() {
    let problem = problem(true, calibration(2, 0, 0.0), 2);
    let truth = Truth { observations: [4.0, 0.25], model: 4.0 };
    type Method = fn(&Problem) -> Box<dyn Assimilator>;
    let methods: [(&str, Method); 3] = [
        ("kf", kalman),
        ("fkf", |problem| {
            let settings = settings(BlockShape::Domain, BiasCoupling::Carry);
            Box::new(FastKalmanFilter::new(problem.clone(), settings).unwrap())
        }),
        ("banded", |problem| Box::new(BandedKalmanFilter::new(problem.clone(), 20).unwrap())),
    ];
    for (name, method) in methods {
        let (mut tuned, mut untuned) = (0.0, 0.0);
        for seed in 1..=4 {
            untuned += run(&problem, &mut *method(&problem), truth, 120, seed).1;
            tuned += run(&problem, &mut adaptive(&problem, method(&problem), true, true), truth, 120, seed).1;
        }
        assert!(tuned < 0.95 * untuned, "{name}: {tuned} beside {untuned}");
    }
}

/// B of a method that keeps it for ever is what the forecasts' errors are on average: a factor makes χ² = n.
#[test]
fn a_static_covariance_is_brought_to_the_size_of_the_errors() {
    let problem = problem(true, Calibration::default(), 2);
    let truth = Truth { observations: [1.0, 1.0], model: 1.0 };
    let chi2 = |method: &mut dyn Assimilator| {
        let mut world = World::new(&problem, truth, 3);
        let mut sum = 0.0;
        for cycle in 1..=160 {
            let observed = world.cycle(&problem, cycle, 3);
            let from = method.forecast(WINDOW).unwrap();
            let analysis = method.analyse(&from, &observed).unwrap();
            sum += if cycle > 80 { analysis.innovation_chi2.unwrap() / (80 * observed.len()) as f64 } else { 0.0 };
        }
        sum
    };
    for scale in [0.1, 10.0] {
        let mut method = OptimalInterpolation::new(problem.clone(), scale).unwrap();
        let before = chi2(&mut method);
        assert!((before - 1.0).abs() > 0.15, "{before}");
        let covariance = problem.background_error.clone();
        let state_error = Some(AdaptedCovariance { name: "background_error", covariance, scale });
        let settings = AdaptiveSettings { observation_error: false, state_error, memory_cycles: MEMORY };
        let method = Box::new(OptimalInterpolation::new(problem.clone(), scale).unwrap());
        let mut method = Adaptive::new(method, problem.background.layout().clone(), settings).unwrap();
        let after = chi2(&mut method);
        assert!((after - 1.0).abs() < 0.1, "{scale}: {before} became {after}");
    }
}

/// With Q = R on each value that is observed, and the model forgetting everything, nothing tells one from the other.
#[test]
fn what_cannot_be_told_apart_is_named() {
    let mut problem = problem(true, Calibration::default(), 2);
    problem.model = Arc::new(Forgetful(problem.background.layout().clone()));
    let truth = Truth { observations: [1.0, 1.0], model: 1.0 };
    let mut world = World::new(&problem, truth, 1);
    let mut method = adaptive(&problem, kalman(&problem), true, true);
    for cycle in 1..=60 {
        let mut observed = world.cycle(&problem, cycle, 1);
        let mut rows = isobar_obs::SparseRows::new();
        let values = problem.background.values().len();
        (0..observed.len()).for_each(|row| rows.push_row([(row % values, 1.0)]));
        let none = (0..observed.len()).fold(isobar_obs::SparseRows::new(), |mut rows, _| {
            rows.push_row([]);
            rows
        });
        let jacobian = isobar_obs::Jacobian { state: rows, calibration: none };
        observed.operator = Arc::new(isobar_obs::LinearOperator { jacobian });
        let normals = standard_normals(&mut stream(cycle as u64, "values"), observed.len());
        observed.values = normals.iter().map(|normal| 0.8 * normal).collect();
        observed.sigma.fill(0.4);
        observed.reports.iter_mut().for_each(|report| (report.network, report.variable) = ("sondes".into(), 0));
        let from = method.forecast(WINDOW).unwrap();
        method.analyse(&from, &observed).unwrap();
    }
    let parameters = parameters(&method);
    assert_eq!(parameters.len(), 2);
    for (own, other) in [(0, 1), (1, 0)] {
        let name = parameters[other].name.strip_prefix("adapt/").unwrap();
        assert_eq!(parameters[own].verdict, format!("not determined: cannot be told from {name}"));
    }
    // Their sum is: 2 · 0.16 assumed, 0.64 true.
    let sum = parameters[0].value + parameters[1].value;
    assert!((sum - 4.0).abs() < 0.5, "{parameters:?}");
}

/// x(t + Δt) = 0.
struct Forgetful(Arc<isobar_model::Layout>);

impl isobar_model::Model for Forgetful {
    fn layout(&self) -> &Arc<isobar_model::Layout> {
        &self.0
    }
    fn time_step(&self) -> isobar_model::Duration {
        WINDOW
    }
    fn largest_time_step_s(&self, _: &State) -> f64 {
        f64::INFINITY
    }
    fn step(&self, x: &mut State) {
        x.values_mut().fill(0.0);
    }
}

impl isobar_model::TangentLinear for Forgetful {
    fn step_tl(&self, _: &State, columns: &mut [f64]) {
        columns.fill(0.0);
    }
}

impl isobar_model::Adjoint for Forgetful {
    fn step_ad(&self, _: &State, columns: &mut [f64]) {
        columns.fill(0.0);
    }
}

#[test]
fn a_method_goes_on_to_the_same_bits_from_what_it_has_saved() {
    let problem = problem(true, calibration(2, 0, 0.3), 2);
    let truth = Truth { observations: [4.0, 1.0], model: 4.0 };
    let mut world = World::new(&problem, truth, 5);
    let windows: Vec<_> = (1..=6).map(|cycle| world.cycle(&problem, cycle, 5)).collect();
    let new = || adaptive(&problem, kalman(&problem), true, true);
    let (mut whole, mut begun, mut resumed) = (new(), new(), new());
    for (cycle, observed) in windows.iter().enumerate() {
        if cycle == 3 {
            resumed.recall(&mut &begun.memory().unwrap()[..]).unwrap();
        }
        let method = if cycle < 3 { &mut begun } else { &mut resumed };
        let from = whole.forecast(WINDOW).unwrap();
        assert_eq!(from, method.forecast(WINDOW).unwrap());
        assert_eq!(whole.analyse(&from, observed).unwrap(), method.analyse(&from, observed).unwrap());
        assert_eq!(parameters(&whole), parameters(method));
    }
}
