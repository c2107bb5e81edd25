//! The moving time volume against the dense least-squares solution of all cycles at once.

mod smoother;
mod tiles;
mod whole;

use self::whole::Whole;
use crate::common::{
    DAY, WINDOW, accuracy, calibration, constant, factor, parameters, problem, relative_difference, settings,
    volume_settings, widen, window,
};
use faer::Mat;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::time_volume::{AmplitudeEvolution, Factor, Target, TimeShape, TimeVolume, TimeVolumeSettings};
use isobar_assim::{Assimilator, BiasTreatment, Problem};
use isobar_model::Duration;
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

fn windows(problem: &Problem, count: usize) -> Vec<ObservationWindow> {
    (1..=count).map(|cycle| window(problem, 30, false, cycle, 11)).collect()
}

fn run(method: &mut dyn Assimilator, windows: &[ObservationWindow]) -> isobar_assim::Analysis {
    let mut last = None;
    for observed in windows {
        let from = method.forecast(WINDOW).unwrap();
        last = Some(method.analyse(&from, observed).unwrap());
    }
    last.unwrap()
}

/// The same, with something new to be known of the first and the last parameter of three before the third cycle.
fn run_recalibrated(method: &mut dyn Assimilator, windows: &[ObservationWindow], p: usize) -> isobar_assim::Analysis {
    run(method, &windows[..2]);
    let added = [[0.8, 0.0, 0.3], [0.0; 3], [0.3, 0.0, 0.5]];
    let added = Mat::from_fn(p, p, |i, j| if i < 3 && j < 3 { added[i][j] } else { 0.0 });
    widen(method, added.as_ref()).unwrap();
    run(method, &windows[2..])
}

/// Without a prior of C, and with evolving amplitudes beside: estimate and claims at the end are those of all cycles at
/// once.
#[test]
fn it_is_the_least_squares_solution_of_all_cycles() {
    let problem = problem(true, calibration(2, 1, 0.0), 3);
    let both = || Target::Observations(vec![0, 2]);
    let factors = vec![
        factor("diurnal", both(), TimeShape::Sinusoid { period: DAY }, constant(None)),
        factor("drift of h", Target::Forecast(0), TimeShape::Constant, constant(None)),
        factor("square", Target::Forecast(1), TimeShape::SquareWave { period: DAY }, constant(Some(0.7))),
        factor(
            "first order",
            Target::Forecast(1),
            TimeShape::Constant,
            AmplitudeEvolution::FirstOrder { sigma: 0.5, correlation_time: DAY },
        ),
        factor(
            "walk",
            Target::Observations(vec![1]),
            TimeShape::Sinusoid { period: Duration::from_seconds(12 * 3600 + 7200) },
            AmplitudeEvolution::RandomWalk { sigma_prior: 0.8, sigma_per_sqrt_day: 0.6 },
        ),
    ];
    let windows = windows(&problem, 7);
    let whole = Whole::new(&problem, &factors, &windows);
    let (exact, covariance) = whole.dense.solve();
    for (blocks, name) in [(BlockShape::Domain, "domain"), (BlockShape::Cell, "cells with all factors")] {
        let mut own = volume_settings(20, factors.clone());
        own.filter.blocks = blocks;
        if blocks == BlockShape::Cell {
            // One for each value and for the local parameter.
            own.filter.factors = problem.background.values().len() + 1;
        }
        let mut volume = TimeVolume::new(problem.clone(), own, None).unwrap();
        let analysis = run(&mut volume, &windows);
        let estimate = &analysis.estimate;
        let last = |i: usize| whole.state(7, i);
        let state: Vec<f64> = (0..whole.m).map(|i| exact[(last(i), 0)]).collect();
        let spread: Vec<f64> = (0..whole.m).map(|i| covariance[(last(i), last(i))].sqrt()).collect();
        assert!(relative_difference(estimate.state.values(), &state) < 1e-8, "{name}: state");
        assert!(relative_difference(estimate.state_spread.as_ref().unwrap(), &spread) < 1e-8, "{name}: spread");
        let found = parameters(&volume);
        assert_eq!(found.len(), 7);
        for (k, parameter) in found.iter().enumerate() {
            let unknown = if k < 4 { whole.amplitude(k) } else { whole.evolving(k - 4, 7) };
            let (value, sigma) = (exact[(unknown, 0)], covariance[(unknown, unknown)].sqrt());
            assert!((parameter.value - value).abs() < 1e-8 * sigma, "{name}: {parameter:?} and not {value}");
            assert!((parameter.sigma.unwrap() / sigma - 1.0).abs() < 1e-8, "{name}: {parameter:?} and not ± {sigma}");
            // What an evolving amplitude would be without observations: a stationary process, and a walk of seven windows.
            let days = 7.0 * WINDOW.days();
            let unobserved =
                [0.5_f64.powi(2), 0.8_f64.powi(2) + 0.6_f64.powi(2) * days, 0.8_f64.powi(2) + 0.6_f64.powi(2) * days];
            let determined = k < 4 || sigma * sigma <= 0.25 * unobserved[k - 4];
            let beginning = if determined { "determined" } else { "not determined: it keeps" };
            assert!(parameter.verdict.starts_with(beginning), "{name}: {parameter:?}");
        }
        // A parameter as it is now, with what factors add to it: c₀ + C₁ cos ωt + C₂ sin ωt.
        let mut weights = vec![0.0; whole.dense.unknowns];
        weights[whole.parameter(0)] = 1.0;
        let now = windows[6].time;
        (0..2).for_each(|f| weights[whole.amplitude(f)] = TimeShape::Sinusoid { period: DAY }.value(f, now));
        let value: f64 = weights.iter().enumerate().map(|(i, w)| w * exact[(i, 0)]).sum();
        let weights = Mat::from_fn(weights.len(), 1, |i, _| weights[i]);
        let sigma = (weights.transpose() * &covariance * &weights)[(0, 0)].sqrt();
        assert!((estimate.calibration[0] - value).abs() < 1e-8 * sigma);
        assert!((estimate.calibration_spread.as_ref().unwrap()[0] / sigma - 1.0).abs() < 1e-8);
        whole.compare_covariances(&volume, &covariance, &factors, now, name);
    }
}

/// The same factors as calibration parameters with a prior, which the filter's own recursion carries from cycle to cycle:
/// a window of one cycle with the prior row, and of any number; sensors are recalibrated on the way.
#[test]
fn with_the_prior_row_any_length_is_the_recursion() {
    let base = problem(true, calibration(2, 1, 0.3), 5);
    let sigmas = [0.9, 0.9];
    let windows: Vec<ObservationWindow> = windows(&base, 6);
    let mut extended = base.clone();
    for sigma_prior in sigmas {
        let name = format!("c{}", extended.calibration.len());
        let mut parameter = base.calibration.parameters[0].clone();
        (parameter.name, parameter.sigma_prior, parameter.drift) = (name, sigma_prior, isobar_obs::Drift::CONSTANT);
        parameter.placement = isobar_obs::Placement::Shared;
        extended.calibration.parameters.push(parameter);
    }
    let shape = TimeShape::Sinusoid { period: DAY };
    let with_columns = |observed: &ObservationWindow| {
        let own = observed.operator.linearize(&base.background, &[0.0; 3]);
        let mut rows = SparseRows::new();
        for row in 0..observed.len() {
            let entries = own.calibration.row(row).to_vec();
            let weight: f64 = entries.iter().filter(|entry| entry.0 == 0).map(|entry| entry.1).sum();
            let further = (0..2).map(|f| (3 + f, weight * shape.value(f, observed.time)));
            rows.push_row(entries.iter().copied().chain(further));
        }
        let operator = Arc::new(LinearOperator { jacobian: Jacobian { state: own.state, calibration: rows } });
        ObservationWindow { operator, ..observed.clone() }
    };
    let wide: Vec<ObservationWindow> = windows.iter().map(with_columns).collect();
    let own = settings(BlockShape::Domain, BiasCoupling::Carry);
    let mut recursion = FastKalmanFilter::new(extended, own).unwrap();
    let expected = run_recalibrated(&mut recursion, &wide, 5);
    for cycles in [1, 3, 10] {
        let factors = vec![factor("f", Target::Observations(vec![0]), shape, constant(Some(0.9)))];
        let own = TimeVolumeSettings { keep_before: true, ..volume_settings(cycles, factors) };
        let mut volume = TimeVolume::new(base.clone(), own, None).unwrap();
        let found = run_recalibrated(&mut volume, &windows, 3);
        assert!(relative_difference(found.estimate.state.values(), expected.estimate.state.values()) < 1e-8);
        let (a, b) = (found.estimate.state_spread.unwrap(), expected.estimate.state_spread.as_ref().unwrap());
        assert!(relative_difference(&a, b) < 1e-8);
        for (k, parameter) in parameters(&volume).iter().enumerate() {
            assert!((parameter.value - expected.estimate.calibration[3 + k]).abs() < 1e-8);
            let sigma = expected.estimate.calibration_spread.as_ref().unwrap()[3 + k];
            assert!((parameter.sigma.unwrap() - sigma).abs() < 1e-8);
        }
        let (a, b) = (found.innovation_chi2.unwrap(), expected.innovation_chi2.unwrap());
        assert!((a / b - 1.0).abs() < 1e-8, "{cycles}: {a} and not {b}");
    }
}

/// Amplitudes that change with time on a bias that observations see, and on one that none of them has.
#[test]
fn an_evolving_amplitude_that_nothing_is_observed_of_is_not_called_determined() {
    let problem = problem(true, calibration(2, 0, 0.0), 7);
    let evolving = |name: &str, number: usize, evolution| {
        factor(name, Target::Observations(vec![number]), TimeShape::Constant, evolution)
    };
    let first_order =
        AmplitudeEvolution::FirstOrder { sigma: 4.0, correlation_time: Duration::from_seconds(30 * 86_400) };
    let walk = AmplitudeEvolution::RandomWalk { sigma_prior: 4.0, sigma_per_sqrt_day: 1.0 };
    let factors = vec![
        evolving("seen process", 0, first_order),
        evolving("seen walk", 0, walk),
        evolving("unseen process", 1, first_order),
        evolving("unseen walk", 1, walk),
    ];
    let blind = |observed: ObservationWindow| {
        let own = observed.operator.linearize(&problem.background, &[0.0; 2]);
        let mut rows = SparseRows::new();
        for row in 0..observed.len() {
            rows.push_row(own.calibration.row(row).iter().copied().filter(|entry| entry.0 == 0));
        }
        let operator = Arc::new(LinearOperator { jacobian: Jacobian { state: own.state, calibration: rows } });
        ObservationWindow { operator, ..observed }
    };
    let windows: Vec<ObservationWindow> = windows(&problem, 8).into_iter().map(blind).collect();
    // Each alone, for the sum of two is all that observations see of them.
    for factor in factors {
        let seen = !factor.name.starts_with("unseen");
        // The parameter's own bias is known, so that what is seen is the amplitude.
        let mut problem = problem.clone();
        problem.calibration.parameters.iter_mut().for_each(|parameter| parameter.sigma_prior = 1e-3);
        let mut volume = TimeVolume::new(problem, volume_settings(4, vec![factor.clone()]), None).unwrap();
        run(&mut volume, &windows);
        let [found] = &parameters(&volume)[..] else { panic!("there is one amplitude") };
        if seen {
            assert_eq!(found.verdict, "determined", "{found:?}");
        } else {
            assert!(found.verdict.starts_with("not determined: it keeps 100 % of the variance"), "{found:?}");
        }
    }
}

#[test]
fn factors_that_depend_on_each_other_are_named() {
    let problem = problem(true, calibration(2, 0, 0.0), 7);
    let target = || Target::Observations(vec![0]);
    let factors = vec![
        factor("day", target(), TimeShape::Sinusoid { period: DAY }, constant(None)),
        factor("again", target(), TimeShape::Sinusoid { period: DAY }, constant(None)),
        factor("hats", target(), TimeShape::Hats { period: DAY, count: 2 }, constant(None)),
    ];
    let windows = windows(&problem, 8);
    let prior = problem.calibration.parameters[0].sigma_prior.powi(2);
    let mut volume = TimeVolume::new(problem, volume_settings(20, factors), None).unwrap();
    // Before any observation three of the amplitudes move the bias without limit, each of them counted as one more prior:
    // two cosines and a hat at midnight.
    let first = accuracy(&volume).unwrap();
    assert!((first.covariance()[(0, 0)] / prior - 4.0).abs() < 1e-12, "{:?}", first.covariance());
    let analysis = run(&mut volume, &windows);
    assert!(analysis.estimate.state_spread.unwrap().iter().all(|sigma| sigma.is_finite()));
    // Now what is not determined does not move it.
    let (last, sigma) = (accuracy(&volume).unwrap(), analysis.estimate.calibration_spread.unwrap()[0]);
    assert!((last.covariance()[(0, 0)] / sigma.powi(2) - 1.0).abs() < 1e-8, "{:?}", last.covariance());
    let found = parameters(&volume);
    let verdict = |name: &str| found.iter().find(|it| it.name == name).unwrap();
    let sine = verdict("day/sine");
    assert!(sine.sigma.is_none() && sine.verdict.contains("again/sine"), "{sine:?}");
    // The hats sum to a constant, which the parameter's own prior determines; their difference is the cosine.
    let hat = verdict("hats/hat 1");
    assert!(hat.verdict.starts_with("not determined") && hat.verdict.contains("cosine"), "{hat:?}");
}

#[test]
fn a_window_forgets_what_is_older_and_a_checkpoint_changes_nothing() {
    let problem = problem(true, calibration(2, 1, 0.2), 9);
    let factors = vec![
        factor("day", Target::Observations(vec![0]), TimeShape::Sinusoid { period: DAY }, constant(None)),
        factor(
            "memory",
            Target::Forecast(0),
            TimeShape::Constant,
            AmplitudeEvolution::FirstOrder { sigma: 0.5, correlation_time: DAY },
        ),
    ];
    let new = |cycles| TimeVolume::new(problem.clone(), volume_settings(cycles, factors.clone()), None).unwrap();
    let windows = windows(&problem, 9);
    let (mut short, mut long) = (new(3), new(9));
    run(&mut short, &windows);
    run(&mut long, &windows);
    let sigma = |volume: &TimeVolume| parameters(volume)[0].sigma.unwrap();
    assert!(sigma(&short) > 1.2 * sigma(&long), "{} {}", sigma(&short), sigma(&long));
    let (mut whole, mut first, mut second) = (new(3), new(3), new(3));
    let expected = run(&mut whole, &windows);
    run(&mut first, &windows[..5]);
    second.recall(&mut &first.memory().unwrap()[..]).unwrap();
    assert_eq!(run(&mut second, &windows[5..]), expected);
    assert_eq!(parameters(&second), parameters(&whole));
    let mut bytes = first.memory().unwrap();
    bytes.truncate(bytes.len() / 2);
    assert!(second.recall(&mut &bytes[..]).is_err());
    let fewer = TimeVolume::new(problem.clone(), volume_settings(3, factors[..1].to_vec()), None).unwrap();
    assert!(new(3).recall(&mut &fewer.memory().unwrap()[..]).is_err());
}

#[test]
fn what_makes_no_sense_is_refused() {
    let problem = problem(true, calibration(2, 0, 0.0), 7);
    let refused = |settings: TimeVolumeSettings, problem: &Problem| {
        TimeVolume::new(problem.clone(), settings, None).err().expect("it is refused").to_string()
    };
    let good = factor("f", Target::Observations(vec![0]), TimeShape::Constant, constant(None));
    assert!(refused(volume_settings(3, vec![]), &problem).contains("needs a factor"));
    assert!(refused(volume_settings(0, vec![good.clone()]), &problem).contains("one cycle at least"));
    let pattern = Factor { patterns: vec![vec![1.0; 7]], ..good.clone() };
    assert!(refused(volume_settings(3, vec![pattern]), &problem).contains("7 values, but the grid 20 cells"));
    let elsewhere = Factor { target: Target::Observations(vec![9]), ..good.clone() };
    assert!(refused(volume_settings(3, vec![elsewhere]), &problem).contains("no such calibration parameter"));
    let ignoring = Problem { bias: BiasTreatment::Ignore, ..problem };
    assert!(refused(volume_settings(3, vec![good]), &ignoring).contains("estimates biases"));
}
