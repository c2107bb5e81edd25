//! The moving time volume against the dense least-squares solution of all cycles at once.

mod common;

use common::{
    DAY, WINDOW, calibration, constant, factor, problem, relative_difference, settings, volume_settings, window,
};
use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::fast_kalman::time_volume::{
    AmplitudeEvolution, Factor, Target, TimeShape, TimeVolume, TimeVolumeSettings,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::{Assimilator, BiasTreatment, Problem, Unknown};
use isobar_model::{Duration, Time};
use isobar_obs::{BlockAngular, LinearOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

/// Entries, right-hand side and standard deviation of a row.
type Row = (Vec<(usize, f64)>, f64, f64);

/// Rows of a weighted least-squares problem.
struct Dense {
    unknowns: usize,
    rows: Vec<Row>,
}

impl Dense {
    fn row(&mut self, entries: Vec<(usize, f64)>, right: f64, sigma: f64) {
        self.rows.push((entries, right, sigma));
    }

    /// Estimate and covariance.
    fn solve(&self) -> (Mat<f64>, Mat<f64>) {
        let (mut matrix, mut right) = (Mat::<f64>::zeros(self.unknowns, self.unknowns), Mat::zeros(self.unknowns, 1));
        for (entries, value, sigma) in &self.rows {
            for &(i, a) in entries {
                right[(i, 0)] += a * value / (sigma * sigma);
                entries.iter().for_each(|&(j, b)| matrix[(i, j)] += a * b / (sigma * sigma));
            }
        }
        let llt = matrix.llt(Side::Lower).unwrap();
        (llt.solve(&right), llt.inverse())
    }
}

/// The propagator of a cycle, column by column.
fn propagator(problem: &Problem) -> Vec<f64> {
    let m = problem.background.values().len();
    let mut columns = vec![0.0; m * m];
    columns.iter_mut().step_by(m + 1).for_each(|diagonal| *diagonal = 1.0);
    problem.model.step_tl(&problem.background, &mut columns);
    columns
}

/// All cycles of `factors` as one dense problem, with the standard deviations of `common::problem`. The unknowns are the
/// states 0 … T, the parameters, the constant amplitudes, and for each evolving one its values 0 … T.
struct Whole {
    dense: Dense,
    m: usize,
    p: usize,
    cycles: usize,
    constant: Vec<(usize, usize)>,
    evolving: Vec<(usize, usize)>,
}

impl Whole {
    fn new(problem: &Problem, factors: &[Factor], windows: &[ObservationWindow]) -> Self {
        let (m, p, cycles) = (problem.background.values().len(), problem.calibration.len(), windows.len());
        let (mut constant, mut evolving) = (Vec::new(), Vec::new());
        for (number, factor) in factors.iter().enumerate() {
            let functions = match factor.shape {
                TimeShape::Sinusoid { .. } => 2,
                TimeShape::Hats { count, .. } => count,
                _ => 1,
            };
            let kind = match factor.evolution {
                AmplitudeEvolution::Constant { .. } => &mut constant,
                _ => &mut evolving,
            };
            kind.extend((0..functions).map(|function| (number, function)));
        }
        let unknowns = m * (cycles + 1) + p + constant.len() + evolving.len() * (cycles + 1);
        let dense = Dense { unknowns, rows: Vec::new() };
        let mut whole = Self { dense, m, p, cycles, constant, evolving };
        whole.fill(problem, factors, windows);
        whole
    }

    fn state(&self, time: usize, i: usize) -> usize {
        time * self.m + i
    }

    fn parameter(&self, number: usize) -> usize {
        self.m * (self.cycles + 1) + number
    }

    fn amplitude(&self, k: usize) -> usize {
        self.parameter(self.p) + k
    }

    fn evolving(&self, k: usize, time: usize) -> usize {
        self.amplitude(self.constant.len()) + k * (self.cycles + 1) + time
    }

    /// The unknowns of all amplitudes at a time with their factors and functions.
    fn amplitudes(&self, time: usize) -> Vec<(usize, usize, usize)> {
        let constant = self.constant.iter().enumerate().map(|(k, it)| (self.amplitude(k), it.0, it.1));
        let evolving = self.evolving.iter().enumerate().map(|(k, it)| (self.evolving(k, time), it.0, it.1));
        constant.chain(evolving).collect()
    }

    fn fill(&mut self, problem: &Problem, factors: &[Factor], windows: &[ObservationWindow]) {
        let a = propagator(problem);
        let (m, p) = (self.m, self.p);
        let cells = problem.background.layout().grid.cells();
        (0..m).for_each(|i| self.dense.row(vec![(self.state(0, i), 1.0)], problem.background.values()[i], 1.5));
        for number in 0..p {
            let sigma = problem.calibration.parameters[number].sigma_prior;
            self.dense.row(vec![(self.parameter(number), 1.0)], 0.0, sigma);
        }
        for (k, &(number, _)) in self.constant.clone().iter().enumerate() {
            if let AmplitudeEvolution::Constant { sigma_prior: Some(sigma) } = factors[number].evolution {
                self.dense.row(vec![(self.amplitude(k), 1.0)], 0.0, sigma);
            }
        }
        let days = WINDOW.days();
        for (k, &(number, _)) in self.evolving.clone().iter().enumerate() {
            let (start, phi, added) = match factors[number].evolution {
                AmplitudeEvolution::RandomWalk { sigma_prior, sigma_per_sqrt_day } => {
                    (sigma_prior, 1.0, sigma_per_sqrt_day * days.sqrt())
                }
                AmplitudeEvolution::FirstOrder { sigma, correlation_time } => {
                    let phi = (-WINDOW.as_f64() / correlation_time.as_f64()).exp();
                    (sigma, phi, sigma * (1.0 - phi * phi).sqrt())
                }
                AmplitudeEvolution::Constant { .. } => unreachable!(),
            };
            self.dense.row(vec![(self.evolving(k, 0), 1.0)], 0.0, start);
            for time in 0..self.cycles {
                self.dense.row(vec![(self.evolving(k, time + 1), 1.0), (self.evolving(k, time), -phi)], 0.0, added);
            }
        }
        for (time, observed) in windows.iter().enumerate() {
            for i in 0..m {
                let mut entries = vec![(self.state(time + 1, i), 1.0)];
                entries.extend((0..m).map(|j| (self.state(time, j), -a[j * m + i])));
                for (unknown, number, function) in self.amplitudes(time) {
                    if factors[number].target == Target::Forecast(i / cells) {
                        entries.push((unknown, -factors[number].shape.value(function, observed.time)));
                    }
                }
                self.dense.row(entries, 0.0, 0.4);
            }
            let jacobian = observed.operator.linearize(&problem.background, &vec![0.0; p]);
            for row in 0..observed.len() {
                let of_state = jacobian.state.row(row).iter().map(|&(i, value)| (self.state(time + 1, i), value));
                let of_bias = jacobian.calibration.row(row).iter().map(|&(i, value)| (self.parameter(i), value));
                let mut entries: Vec<(usize, f64)> = of_state.chain(of_bias).collect();
                for (unknown, number, function) in self.amplitudes(time + 1) {
                    if let Target::Observations(numbers) = &factors[number].target {
                        let own = jacobian.calibration.row(row).iter().filter(|entry| numbers.contains(&entry.0));
                        let weight: f64 = own.map(|entry| entry.1).sum();
                        entries.push((unknown, weight * factors[number].shape.value(function, observed.time)));
                    }
                }
                self.dense.row(entries, observed.values[row], observed.sigma[row]);
            }
        }
    }
}

impl Whole {
    /// Every column of the covariance of the last state and the parameters as they are now, and what is said of the
    /// parameters and the state's means, against the dense matrix.
    fn compare_covariances(
        &self,
        volume: &TimeVolume,
        covariance: &Mat<f64>,
        factors: &[Factor],
        now: Time,
        name: &str,
    ) {
        let (m, p) = (self.m, self.p);
        let mut weights = Mat::<f64>::zeros(m + p, self.dense.unknowns);
        (0..m).for_each(|i| weights[(i, self.state(self.cycles, i))] = 1.0);
        for number in 0..p {
            weights[(m + number, self.parameter(number))] = 1.0;
            for (unknown, factor, function) in self.amplitudes(self.cycles) {
                if matches!(&factors[factor].target, Target::Observations(numbers) if numbers.contains(&number)) {
                    weights[(m + number, unknown)] = factors[factor].shape.value(function, now);
                }
            }
        }
        let dense = &weights * covariance * weights.transpose();
        let sigma = |i: usize| dense[(i, i)].sqrt();
        let unknown = |i: usize| if i < m { Unknown::Value(i) } else { Unknown::Parameter(i - m) };
        for j in 0..m + p {
            let column = volume.covariance_column(unknown(j)).unwrap();
            assert_eq!((column.state.len(), column.calibration.len()), (m, p));
            for i in 0..m + p {
                let off = (column.with(unknown(i)) - dense[(i, j)]).abs() / (sigma(i) * sigma(j));
                assert!(off < 1e-8, "{name}: covariance of {i} with {j}: off by {off} in units of correlation");
            }
        }
        assert!(volume.covariance_column(Unknown::Parameter(p)).is_none(), "an amplitude is no parameter");
        // Two variables.
        let cells = m / 2;
        let accuracy = volume.calibration_accuracy().unwrap();
        let close = |value: f64, expected: f64, scale: f64| (value - expected).abs() < 1e-8 * scale;
        for j in 0..p {
            for i in 0..p {
                let (value, expected) = (accuracy.covariance()[(i, j)], dense[(m + i, m + j)]);
                assert!(close(value, expected, sigma(m + i) * sigma(m + j)), "{name}: {value} and not {expected}");
            }
        }
        let means: Vec<_> = accuracy.of_means().collect();
        assert_eq!(means.len(), m / cells);
        for (variable, (with, variance)) in means.into_iter().enumerate() {
            let range = variable * cells..(variable + 1) * cells;
            let mean = |j: usize| range.clone().map(|i| dense[(i, j)]).sum::<f64>() / cells as f64;
            let expected = range.clone().map(mean).sum::<f64>() / cells as f64;
            assert!(close(variance, expected, expected), "{name}: variance {variance} of a mean and not {expected}");
            for (number, &value) in with.iter().enumerate() {
                let scale = expected.sqrt() * sigma(m + number);
                assert!(close(value, mean(m + number), scale), "{name}: a mean with a parameter: {value}");
            }
        }
    }
}

fn windows(problem: &Problem, count: usize) -> Vec<ObservationWindow> {
    (1..=count).map(|cycle| window(problem, 30, false, cycle, 11)).collect()
}

fn run(method: &mut dyn Assimilator, windows: &[ObservationWindow]) -> isobar_assim::Analysis {
    let mut last = None;
    for observed in windows {
        method.forecast(WINDOW).unwrap();
        last = Some(method.analyse(observed).unwrap());
    }
    last.unwrap()
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
        let found = volume.parameters();
        assert_eq!(found.len(), 7);
        for (k, parameter) in found.iter().enumerate() {
            let unknown = if k < 4 { whole.amplitude(k) } else { whole.evolving(k - 4, 7) };
            let (value, sigma) = (exact[(unknown, 0)], covariance[(unknown, unknown)].sqrt());
            assert!((parameter.value - value).abs() < 1e-8 * sigma, "{name}: {parameter:?} and not {value}");
            assert!((parameter.sigma.unwrap() / sigma - 1.0).abs() < 1e-8, "{name}: {parameter:?} and not ± {sigma}");
            assert_eq!(parameter.verdict, "determined");
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
/// a window of one cycle with the prior row, and of any number.
#[test]
fn with_the_prior_row_any_length_is_the_recursion() {
    let base = problem(true, calibration(2, 1, 0.3), 5);
    let sigmas = [0.9, 0.9];
    let windows: Vec<ObservationWindow> = windows(&base, 6);
    let mut extended = base.clone();
    for sigma_prior in sigmas {
        let name = format!("c{}", extended.calibration.len());
        let mut parameter = base.calibration.parameters[0].clone();
        (parameter.name, parameter.sigma_prior, parameter.sigma_drift_per_sqrt_day) = (name, sigma_prior, 0.0);
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
        let operator = Arc::new(LinearOperator { jacobian: BlockAngular { state: own.state, calibration: rows } });
        ObservationWindow { operator, ..observed.clone() }
    };
    let wide: Vec<ObservationWindow> = windows.iter().map(with_columns).collect();
    let own = settings(BlockShape::Domain, BiasCoupling::Carry);
    let mut recursion = FastKalmanFilter::new(extended, own).unwrap();
    let expected = run(&mut recursion, &wide);
    for cycles in [1, 3, 10] {
        let factors = vec![factor("f", Target::Observations(vec![0]), shape, constant(Some(0.9)))];
        let own = TimeVolumeSettings { keep_before: true, ..volume_settings(cycles, factors) };
        let mut volume = TimeVolume::new(base.clone(), own, None).unwrap();
        let found = run(&mut volume, &windows);
        assert!(relative_difference(found.estimate.state.values(), expected.estimate.state.values()) < 1e-8);
        let (a, b) = (found.estimate.state_spread.unwrap(), expected.estimate.state_spread.as_ref().unwrap());
        assert!(relative_difference(&a, b) < 1e-8);
        for (k, parameter) in volume.parameters().iter().enumerate() {
            assert!((parameter.value - expected.estimate.calibration[3 + k]).abs() < 1e-8);
            let sigma = expected.estimate.calibration_spread.as_ref().unwrap()[3 + k];
            assert!((parameter.sigma.unwrap() - sigma).abs() < 1e-8);
        }
        let (a, b) = (found.innovation_chi2.unwrap(), expected.innovation_chi2.unwrap());
        assert!((a / b - 1.0).abs() < 1e-8, "{cycles}: {a} and not {b}");
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
    let first = volume.calibration_accuracy().unwrap();
    assert!((first.covariance()[(0, 0)] / prior - 4.0).abs() < 1e-12, "{:?}", first.covariance());
    let analysis = run(&mut volume, &windows);
    assert!(analysis.estimate.state_spread.unwrap().iter().all(|sigma| sigma.is_finite()));
    // Now what is not determined does not move it.
    let (last, sigma) = (volume.calibration_accuracy().unwrap(), analysis.estimate.calibration_spread.unwrap()[0]);
    assert!((last.covariance()[(0, 0)] / sigma.powi(2) - 1.0).abs() < 1e-8, "{:?}", last.covariance());
    let found = volume.parameters();
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
    let sigma = |volume: &TimeVolume| volume.parameters()[0].sigma.unwrap();
    assert!(sigma(&short) > 1.2 * sigma(&long), "{} {}", sigma(&short), sigma(&long));
    let (mut whole, mut first, mut second) = (new(3), new(3), new(3));
    let expected = run(&mut whole, &windows);
    run(&mut first, &windows[..5]);
    second.restore(&first.save().unwrap()).unwrap();
    assert_eq!(run(&mut second, &windows[5..]), expected);
    assert_eq!(second.parameters(), whole.parameters());
    let mut bytes = first.save().unwrap();
    bytes.truncate(bytes.len() / 2);
    assert!(second.restore(&bytes).is_err());
    assert!(
        new(3)
            .restore(
                &TimeVolume::new(problem.clone(), volume_settings(3, factors[..1].to_vec()), None)
                    .unwrap()
                    .save()
                    .unwrap()
            )
            .is_err()
    );
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
