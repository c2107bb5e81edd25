//! What is known of sensors: prior means and covariances, recalibrations, frozen parameters.

use crate::common::*;
use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;
use isobar_assim::ensemble::{
    EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers, ModelErrorTreatment,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::variational::{FourDVar, FourDVarSettings, ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, Calibrated, Estimate, Problem, Recalibration, SensorKnowledge, covariance};
use isobar_model::Time;
use isobar_obs::{ObservationWindow, SensorComparison};

type Method = Box<dyn Assimilator>;

const START: Time = Time::from_seconds(0);

fn ensemble() -> EnsembleSettings {
    EnsembleSettings {
        members: 400,
        inflation: Inflation::NONE,
        initial_members: InitialMembers::SecondOrderExact,
        model_error: ModelErrorTreatment::Random,
        seed: 1,
    }
}

/// Methods of all kinds that estimate biases.
fn methods(problem: &Problem) -> Vec<(&'static str, Method)> {
    let variational = || ThreeDVarSettings { covariance_scale: 1.0, tolerance: 1e-12, max_iterations: 1000 };
    let four = FourDVarSettings {
        window_cycles: 3,
        outer_loops: 1,
        covariance_scale: 1.0,
        tolerance: 1e-12,
        max_iterations: 1000,
    };
    vec![
        ("kf", Box::new(KalmanFilter::new(problem.clone()).unwrap()) as Method),
        ("serial_kf", Box::new(KalmanFilter::serial(problem.clone()).unwrap())),
        ("fkf", Box::new(fast_kalman(problem))),
        ("optimal_interpolation", Box::new(OptimalInterpolation::new(problem.clone(), 1.0).unwrap())),
        ("3dvar", Box::new(ThreeDVar::new(problem.clone(), variational()).unwrap())),
        ("4dvar", Box::new(FourDVar::new(problem.clone(), four).unwrap())),
        ("etkf", Box::new(EnsembleTransformKalmanFilter::new(problem.clone(), ensemble()).unwrap())),
    ]
}

fn fast_kalman(problem: &Problem) -> FastKalmanFilter {
    FastKalmanFilter::new(problem.clone(), settings(BlockShape::Domain, BiasCoupling::Carry)).unwrap()
}

/// A problem whose three shared and two local parameters were calibrated together before.
fn known_problem() -> Problem {
    let mut calibration = calibration(3, 2, 0.7);
    let shared: Vec<usize> =
        (0..5).filter(|&number| calibration.parameters[number].placement == isobar_obs::Placement::Shared).collect();
    for (i, correlation) in [(0, 0.4), (1, -0.5), (2, 0.3), (3, 0.25), (4, 0.5)] {
        let of = |number: usize| calibration.parameters[number].sigma_prior;
        if i != shared[0] {
            let pair = (i.max(shared[0]), i.min(shared[0]));
            calibration.covariances.insert(pair, correlation * of(i) * of(shared[0]));
        }
    }
    problem(true, calibration, 2)
}

fn knowledge() -> SensorKnowledge {
    let recalibrated = |cycle: i64, parameter, step, sigma| Recalibration {
        time: Time::from_seconds(cycle * WINDOW.seconds()),
        parameter,
        step,
        sigma,
    };
    SensorKnowledge {
        mean: vec![1.0, -2.0, 0.5, 3.0, -0.7],
        recalibrations: vec![recalibrated(2, 1, 4.0, 0.8), recalibrated(4, 3, -2.0, 0.5), recalibrated(4, 1, 1.0, 0.0)],
    }
}

/// The recursion written down with whole matrices: prior mean, B u with its variance, and a gain whose rows of frozen
/// parameters are zero, in Joseph's form.
#[derive(Clone)]
struct ByHand {
    mean: Mat<f64>,
    covariance: Mat<f64>,
    prior_mean: Vec<f64>,
    prior: Mat<f64>,
    frozen: Vec<bool>,
    m: usize,
}

impl ByHand {
    fn new(problem: &Problem, knowledge: &SensorKnowledge) -> Self {
        let (m, p) = (problem.background.values().len(), problem.calibration.len());
        let prior = Mat::from_fn(p, p, |i, j| problem.calibration.prior_covariance(i, j));
        let b = covariance::dense(&*problem.background_error);
        let covariance = Mat::from_fn(m + p, m + p, |i, j| match (i < m, j < m) {
            (true, true) => b[(i, j)],
            (false, false) => prior[(i - m, j - m)],
            _ => 0.0,
        });
        let prior_mean = knowledge.mean.clone();
        let mean = Mat::from_fn(m + p, 1, |i, _| if i < m { 0.0 } else { prior_mean[i - m] });
        Self { mean, covariance, prior_mean, prior, frozen: vec![false; p], m }
    }

    fn forecast(&mut self, problem: &Problem, knowledge: &SensorKnowledge, cycle: i64) {
        let (m, p) = (self.m, self.prior_mean.len());
        let kept = problem.calibration.kept(WINDOW);
        let mut columns = vec![0.0; m * m];
        (0..m).for_each(|i| columns[i * m + i] = 1.0);
        problem.model.step_tl(&problem.background, &mut columns);
        let a = Mat::from_fn(m + p, m + p, |i, j| match (i < m, j < m) {
            (true, true) => columns[j * m + i],
            (false, false) if i == j => kept[i - m],
            _ => 0.0,
        });
        let q = covariance::dense(&**problem.model_error.as_ref().unwrap());
        self.mean = &a * &self.mean;
        self.covariance = &a * &self.covariance * a.transpose();
        for i in 0..m {
            (0..m).for_each(|j| self.covariance[(i, j)] += q[(i, j)]);
        }
        for (i, parameter) in problem.calibration.parameters.iter().enumerate() {
            let added = parameter.drift.added_variance(WINDOW);
            self.covariance[(m + i, m + i)] += added;
            self.prior_mean[i] *= kept[i];
            (0..p).for_each(|j| self.prior[(i, j)] *= kept[i] * kept[j]);
            self.prior[(i, i)] += added;
        }
        for it in &knowledge.recalibrations {
            if it.time.seconds() == cycle * WINDOW.seconds() {
                self.prior_mean[it.parameter] += it.step;
                self.mean[(m + it.parameter, 0)] += it.step;
                self.prior[(it.parameter, it.parameter)] += it.sigma * it.sigma;
                self.covariance[(m + it.parameter, m + it.parameter)] += it.sigma * it.sigma;
            }
        }
    }

    fn analyse(&mut self, problem: &Problem, observed: &ObservationWindow) {
        let (m, s, n) = (self.m, self.mean.nrows(), observed.len());
        let jacobian = observed.operator.linearize(&problem.background, &self.prior_mean);
        let mut h = Mat::<f64>::zeros(n, s);
        for row in 0..n {
            jacobian.state.row(row).iter().for_each(|&(column, weight)| h[(row, column)] += weight);
            jacobian.calibration.row(row).iter().for_each(|&(column, weight)| h[(row, m + column)] += weight);
        }
        let r = Mat::from_fn(n, n, |i, j| if i == j { observed.sigma[i].powi(2) } else { 0.0 });
        let innovation = &h * &self.covariance * h.transpose() + &r;
        let inverse = innovation.partial_piv_lu().inverse();
        let mut gain = &self.covariance * h.transpose() * inverse;
        for i in (0..self.frozen.len()).filter(|&i| self.frozen[i]) {
            (0..n).for_each(|j| gain[(m + i, j)] = 0.0);
        }
        let departures = Mat::from_fn(n, 1, |i, _| observed.values[i]) - &h * &self.mean;
        self.mean += &gain * departures;
        let rest = Mat::<f64>::identity(s, s) - &gain * h;
        self.covariance = &rest * &self.covariance * rest.transpose() + &gain * r * gain.transpose();
    }

    fn freeze(&mut self, parameters: &[usize]) {
        let m = self.m;
        for &i in parameters {
            self.frozen[i] = true;
            self.mean[(m + i, 0)] = self.prior_mean[i];
            parameters.iter().for_each(|&j| self.covariance[(m + i, m + j)] = self.prior[(i, j)]);
        }
    }

    fn difference(&self, estimate: &Estimate) -> f64 {
        let (m, p) = (self.m, self.prior_mean.len());
        let expected = |range: std::ops::Range<usize>| -> (Vec<f64>, Vec<f64>) {
            range.map(|i| (self.mean[(i, 0)], self.covariance[(i, i)].sqrt())).unzip()
        };
        let ((state, state_spread), (bias, bias_spread)) = (expected(0..m), expected(m..m + p));
        relative_difference(estimate.state.values(), &state)
            .max(relative_difference(estimate.state_spread.as_ref().unwrap(), &state_spread))
            .max(relative_difference(&estimate.calibration, &bias))
            .max(relative_difference(estimate.calibration_spread.as_ref().unwrap(), &bias_spread))
    }
}

#[test]
fn filters_with_knowledge_of_their_sensors_equal_the_recursion_with_whole_matrices() {
    let (problem, knowledge) = (known_problem(), knowledge());
    for (name, method) in methods(&problem).into_iter().take(3) {
        let mut by_hand = ByHand::new(&problem, &knowledge);
        let mut filter = Calibrated::new(method, &problem.calibration, START, knowledge.clone());
        for cycle in 1..=8 {
            let observed = window(&problem, 14, false, cycle, 5);
            by_hand.forecast(&problem, &knowledge, cycle as i64);
            let from = filter.forecast(WINDOW).unwrap();
            let found = by_hand.difference(&from.estimate);
            assert!(found < 1e-9, "{name}, background of cycle {cycle}: {found:e}");
            by_hand.analyse(&problem, &observed);
            let found = by_hand.difference(&filter.analyse(&from, &observed).unwrap().estimate);
            assert!(found < 1e-9, "{name}, analysis of cycle {cycle}: {found:e}");
            if cycle == 3 {
                by_hand.freeze(&[1, 2]);
                filter.freeze(&[2, 1]).unwrap();
            }
            if cycle == 5 {
                // The bytes of a checkpoint hold all of it.
                let saved = filter.memory().unwrap();
                let fresh = methods(&problem).into_iter().find(|other| other.0 == name).unwrap().1;
                filter = Calibrated::new(fresh, &problem.calibration, START, knowledge.clone());
                filter.recall(&mut &saved[..]).unwrap();
                assert_eq!(filter.frozen(), [false, true, true, false, false]);
            }
            let accuracy = accuracy(&filter).unwrap();
            let s = accuracy.covariance();
            let (m, p) = (by_hand.m, s.nrows());
            let expected = Mat::from_fn(p, p, |i, j| by_hand.covariance[(m + i, m + j)]);
            let found = relative_difference(&flat(&s.to_owned()), &flat(&expected));
            assert!(found < 1e-9, "{name}, S of cycle {cycle}: {found:e}");
            let cells = problem.background.layout().grid.cells();
            for (variable, (with, variance)) in accuracy.of_means().enumerate() {
                let mean = |of: &dyn Fn(usize) -> f64| {
                    (0..cells).map(|i| of(variable * cells + i)).sum::<f64>() / cells as f64
                };
                let expected: Vec<f64> = (0..p).map(|j| mean(&|i| by_hand.covariance[(i, m + j)])).collect();
                assert!(relative_difference(with, &expected) < 1e-8, "{name}: {with:?} {expected:?}");
                let expected = mean(&|i| mean(&|j| by_hand.covariance[(i, j)]));
                assert!((variance / expected - 1.0).abs() < 1e-8, "{name}: {variance} {expected}");
            }
        }
    }
}

/// A gain whose rows of the held parameters are zero, in every cycle or in some of them: estimate and variance stay, the state
/// is adjusted with the uncertainty that they have, and what an update would have left is that of a filter that makes it.
#[test]
fn held_parameters_are_those_of_the_schmidt_kalman_filter_with_whole_matrices() {
    let (problem, knowledge) = (known_problem(), knowledge());
    // Which parameters are held in which cycle.
    let always = |_: usize| -> Vec<usize> { vec![0, 1, 2, 3, 4] };
    let at_times = |cycle: usize| -> Vec<usize> {
        match cycle {
            1..=2 => vec![],
            3..=5 => vec![0, 3],
            6 => vec![0],
            _ => vec![0, 2],
        }
    };
    for (name, schedule) in [("always", &always as &dyn Fn(usize) -> Vec<usize>), ("at times", &at_times)] {
        for (kind, method) in methods(&problem).into_iter().take(3) {
            let mut by_hand = ByHand::new(&problem, &knowledge);
            let mut filter = Calibrated::new(method, &problem.calibration, START, knowledge.clone());
            for cycle in 1..=9 {
                let held = schedule(cycle);
                by_hand.frozen = (0..5).map(|number| held.contains(&number)).collect();
                filter.thaw(&[0, 1, 2, 3, 4]);
                filter.hold(&held).unwrap();
                let observed = window(&problem, 14, false, cycle, 5);
                by_hand.forecast(&problem, &knowledge, cycle as i64);
                let from = filter.forecast(WINDOW).unwrap();
                let mut adjusting = ByHand { frozen: vec![false; 5], ..by_hand.clone() };
                adjusting.analyse(&problem, &observed);
                by_hand.analyse(&problem, &observed);
                let analysis = filter.analyse(&from, &observed).unwrap().estimate;
                let found = by_hand.difference(&analysis);
                assert!(found < 1e-9, "{kind}, {name}, cycle {cycle}: {found:e}");
                for number in 0..5 {
                    let would_be = filter.variance_if_adjusted(number);
                    assert_eq!(would_be.is_some(), held.contains(&number));
                    let expected = adjusting.covariance[(by_hand.m + number, by_hand.m + number)];
                    assert!(would_be.is_none_or(|it| (it / expected - 1.0).abs() < 1e-9), "{would_be:?} {expected}");
                    let own = [analysis.calibration[number], analysis.calibration_spread.as_ref().unwrap()[number]];
                    let before =
                        [from.estimate.calibration[number], from.estimate.calibration_spread.as_ref().unwrap()[number]];
                    let kept = own
                        .iter()
                        .zip(before)
                        .all(|(own, before)| (own - before).abs() < 1e-12 * before.abs().max(1.0));
                    assert_eq!(kept, held.contains(&number), "{kind}, {name}, cycle {cycle}: {own:?} {before:?}");
                }
            }
        }
    }
}

/// Comparisons and test points are further rows of H: that of a filter with whole matrices, of frozen parameters too; and χ² is
/// that of the observations without them.
#[test]
fn comparisons_are_rows_of_the_recursion_with_whole_matrices() {
    let (problem, knowledge) = (known_problem(), knowledge());
    let comparisons = |cycle: usize| match cycle {
        2 => vec![SensorComparison { parameter: 0, other: Some(3), value: 2.5, sigma: 0.3 }],
        4 | 7 => vec![
            SensorComparison { parameter: 4, other: None, value: -1.5, sigma: 0.2 },
            SensorComparison { parameter: 2, other: Some(1), value: 0.5, sigma: 0.4 },
        ],
        _ => vec![],
    };
    for (name, method) in methods(&problem).into_iter().take(3) {
        let mut by_hand = ByHand::new(&problem, &knowledge);
        let mut filter = Calibrated::new(method, &problem.calibration, START, knowledge.clone());
        for cycle in 1..=8 {
            if cycle == 6 {
                by_hand.frozen = vec![false, true, false, false, true];
                filter.hold(&[1, 4]).unwrap();
            }
            let observed =
                ObservationWindow { comparisons: comparisons(cycle), ..window(&problem, 14, false, cycle, 5) };
            by_hand.forecast(&problem, &knowledge, cycle as i64);
            let from = filter.forecast(WINDOW).unwrap();
            let chi2 = filter.clone().analyse(&from, &ObservationWindow { comparisons: vec![], ..observed.clone() });
            let chi2 = chi2.unwrap().innovation_chi2.unwrap();
            by_hand.analyse(&problem, &observed.with_comparisons_below(&problem.background.layout().grid));
            let analysis = filter.analyse(&from, &observed).unwrap();
            let found = by_hand.difference(&analysis.estimate);
            assert!(found < 1e-9, "{name}, cycle {cycle}: {found:e}");
            assert_eq!((analysis.background_departures.len(), analysis.analysis_departures.len()), (14, 14));
            let found = (analysis.innovation_chi2.unwrap() / chi2 - 1.0).abs();
            assert!(found < 1e-8, "{name}, χ² of cycle {cycle}: {found:e}");
        }
    }
}

/// With the difference d ± s that the observations alone leave, every method combines a comparison y ± σ into
/// (d/s² + y/σ²) / (1/s² + 1/σ²), and claims the variance 1 / (1/s² + 1/σ²).
#[test]
fn every_method_weighs_a_comparison_by_its_variance() {
    let problem = problem(true, calibration(3, 2, 0.0), 2);
    let comparison = SensorComparison { parameter: 0, other: Some(2), value: 6.0, sigma: 0.1 };
    let unknown = SensorKnowledge { mean: vec![0.0; 5], recalibrations: vec![] };
    for (name, method) in methods(&problem) {
        let mut method = Calibrated::new(method, &problem.calibration, START, unknown.clone());
        let observed = |cycle: usize| window(&problem, 14, false, cycle, 5);
        let from = method.forecast(WINDOW).unwrap();
        method.analyse(&from, &observed(1)).unwrap();
        let from = method.forecast(WINDOW).unwrap();
        let difference = |comparisons: Vec<SensorComparison>| {
            let mut method = method.clone();
            let analysis = method.analyse(&from, &ObservationWindow { comparisons, ..observed(2) }).unwrap();
            let claims = method.can().calibration.unwrap().calibration_accuracy();
            let s = claims.covariance();
            (comparison.simulate(&analysis.estimate.calibration), s[(0, 0)] - 2.0 * s[(0, 2)] + s[(2, 2)])
        };
        let ((d, s2), (after, variance)) = (difference(vec![]), difference(vec![comparison]));
        let sigma2 = comparison.sigma.powi(2);
        let expected = (d / s2 + comparison.value / sigma2) / (1.0 / s2 + 1.0 / sigma2);
        let claimed = 1.0 / (1.0 / s2 + 1.0 / sigma2);
        assert!(
            (after - expected).abs() < 1e-9 && (variance / claimed - 1.0).abs() < 1e-9,
            "{name}: {after}, {expected}"
        );
        assert!((d - comparison.value).abs() > 1.0, "{name}: it was there before: {d}");
    }
}

/// The observations of a cycle with a step in the bias of a parameter.
fn stepped(problem: &Problem, cycle: usize, parameter: usize, step: f64) -> ObservationWindow {
    let mut observed = window(problem, 14, false, cycle, 5);
    let mut change = vec![0.0; problem.calibration.len()];
    change[parameter] = step;
    let rows = observed.operator.linearize(&problem.background, &change).calibration;
    rows.multiply_add(&change, &mut observed.values);
    observed
}

/// To every method a recalibration that is known exactly is as if nothing had happened, but for the bias itself; also within
/// a window of several cycles.
#[test]
fn a_recalibration_that_is_known_exactly_changes_nothing_but_the_bias() {
    let problem = problem(true, calibration(3, 2, 0.7), 2);
    let (parameter, step, from) = (2, 7.5, 4);
    let time = Time::from_seconds(from as i64 * WINDOW.seconds());
    let announced = Recalibration { time, parameter, step, sigma: 0.0 };
    let knows = |recalibrations| SensorKnowledge { mean: vec![0.0; 5], recalibrations };
    for ((name, plain), (_, told)) in methods(&problem).into_iter().zip(methods(&problem)) {
        let mut plain = Calibrated::new(plain, &problem.calibration, START, knows(vec![]));
        let mut told = Calibrated::new(told, &problem.calibration, START, knows(vec![announced]));
        for cycle in 1..=7 {
            // What is left of it by now.
            let kept = problem.calibration.parameters[parameter].drift.kept(WINDOW);
            let happened = if cycle >= from { step * kept.powi((cycle - from) as i32) } else { 0.0 };
            let from_plain = plain.forecast(WINDOW).unwrap();
            let from_told = told.forecast(WINDOW).unwrap();
            let a = plain.analyse(&from_plain, &stepped(&problem, cycle, parameter, 0.0)).unwrap();
            let mut b = told.analyse(&from_told, &stepped(&problem, cycle, parameter, happened)).unwrap();
            b.estimate.calibration[parameter] -= happened;
            let found = relative_difference(b.estimate.state.values(), a.estimate.state.values())
                .max(relative_difference(&b.estimate.calibration, &a.estimate.calibration))
                .max(relative_difference(&b.analysis_departures, &a.analysis_departures));
            assert!(found < 1e-9, "{name}, cycle {cycle}: {found:e}");
        }
    }
}

/// What a recalibration leaves uncertain is added to what each method claims; members have it but for sampling.
#[test]
fn every_method_is_the_less_sure_of_a_recalibrated_sensor() {
    let problem = problem(true, calibration(3, 2, 0.0), 2);
    let announced =
        Recalibration { time: Time::from_seconds(3 * WINDOW.seconds()), parameter: 1, step: 2.0, sigma: 5.0 };
    let knowledge = SensorKnowledge { mean: vec![0.0; 5], recalibrations: vec![announced] };
    for (name, method) in methods(&problem) {
        let mut method = Calibrated::new(method, &problem.calibration, START, knowledge.clone());
        let mut before = Vec::new();
        for cycle in 1..=2 {
            let from = method.forecast(WINDOW).unwrap();
            before = method
                .analyse(&from, &window(&problem, 14, false, cycle, 5))
                .unwrap()
                .estimate
                .calibration_spread
                .unwrap();
        }
        let from = method.forecast(WINDOW).unwrap();
        let after = from.estimate.calibration_spread.clone().unwrap();
        let tolerance = if name == "etkf" { 0.2 } else { 1e-9 };
        let added = (after[1].powi(2) - before[1].powi(2)).sqrt();
        assert!((added / 5.0 - 1.0).abs() < tolerance, "{name}: {added}");
        assert!((after[0] / before[0] - 1.0).abs() < 0.02 * tolerance.max(1e-6), "{name}: {} {}", before[0], after[0]);
        method.analyse(&from, &window(&problem, 14, false, 3, 5)).unwrap();
    }
}
