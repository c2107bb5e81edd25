//! Ensemble methods against the Kalman filter and each other, on a small linear problem.

use crate::common::*;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_assim::covariance::gaspari_cohn;
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers,
    LocalEnsembleTransformKalmanFilter, LocalSettings, ModelErrorTreatment, StochasticEnsembleKalmanFilter,
};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Error, Estimate, Problem};
use isobar_model::{Duration, Layout, Model, State};
use isobar_obs::{Jacobian, LinearOperator, SparseRows};
use std::sync::Arc;

const EVERYWHERE: LocalSettings = LocalSettings { localization_radius_m: f64::INFINITY, analysis_spacing_cells: 1 };

/// Largest relative difference of estimates, claims and χ² of two methods over some cycles.
fn difference(found: &mut dyn Assimilator, expected: &mut dyn Assimilator, problem: &isobar_assim::Problem) -> f64 {
    let of_estimates = |a: &Estimate, b: &Estimate| {
        let mut largest = relative_difference(a.state.values(), b.state.values())
            .max(relative_difference(a.state_spread.as_ref().unwrap(), b.state_spread.as_ref().unwrap()));
        if let (Some(own), Some(other)) = (&a.calibration_spread, &b.calibration_spread) {
            largest = largest.max(relative_difference(own, other));
        }
        largest
    };
    let mut largest: f64 = 0.0;
    for cycle in 1..=6 {
        let observed = window(problem, 14, false, cycle, 5);
        let from_found = found.forecast(WINDOW).unwrap();
        let from_expected = expected.forecast(WINDOW).unwrap();
        let (a, b) =
            (found.analyse(&from_found, &observed).unwrap(), expected.analyse(&from_expected, &observed).unwrap());
        largest = largest
            .max(of_estimates(&a.estimate, &b.estimate))
            .max(relative_difference(&a.background_departures, &b.background_departures))
            .max((a.innovation_chi2.unwrap() / b.innovation_chi2.unwrap() - 1.0).abs());
        if !a.estimate.calibration.is_empty() {
            largest = largest.max(relative_difference(&a.estimate.calibration, &b.estimate.calibration));
        }
    }
    largest
}

#[test]
fn a_complete_ensemble_is_the_kalman_filter() {
    for (shared, local) in [(0, 0), (3, 2)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        let unknowns = problem.background.values().len() + shared + local;
        let mut ensemble =
            EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(unknowns + 1)).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        let found = difference(&mut ensemble, &mut reference, &problem);
        assert!(found < 1e-8, "{shared} shared, {local} local: {found:e}");
    }
}

#[test]
fn without_localisation_the_local_filter_is_the_global_one() {
    // One shared bias, which every cycle sees: what it does not see it leaves alone, other than the global filter.
    for (shared, local) in [(0, 0), (1, 0), (0, 2)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        for members in [12, 30] {
            let mut local =
                LocalEnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(members), EVERYWHERE)
                    .unwrap();
            let mut global = EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(members)).unwrap();
            let found = difference(&mut local, &mut global, &problem);
            assert!(found < 1e-9, "{shared} shared, {members} members: {found:e}");
        }
    }
}

/// Multiplicative inflation multiplies the background's covariance, relaxation keeps its part of the background.
#[test]
fn inflation_acts_on_the_spread_as_its_definition_says() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    let spreads = |inflation: Inflation| {
        let own = EnsembleSettings { inflation, ..ensemble_settings(42) };
        let mut filter = EnsembleTransformKalmanFilter::new(problem.clone(), own).unwrap();
        let from = filter.forecast(WINDOW).unwrap();
        let background = from.estimate.state_spread.clone().unwrap();
        let analysis = filter.analyse(&from, &window(&problem, 14, false, 1, 5)).unwrap();
        (background, analysis.estimate.state_spread.unwrap())
    };
    let (background, plain) = spreads(Inflation::NONE);
    let (_, relaxed) = spreads(Inflation { relaxation_to_prior_spread: 0.3, ..Inflation::NONE });
    let expected: Vec<f64> = plain.iter().zip(&background).map(|(a, b)| 0.7 * a + 0.3 * b).collect();
    assert!(relative_difference(&relaxed, &expected) < 1e-10);
    // With perturbations relaxed the covariance is that of 0.7 X_a + 0.3 X_b: between the two spreads.
    let (_, relaxed) = spreads(Inflation { relaxation_to_prior_perturbations: 0.3, ..Inflation::NONE });
    for ((relaxed, plain), background) in relaxed.iter().zip(&plain).zip(&background) {
        assert!((*plain..=*background).contains(relaxed));
    }
    // With observations of no weight the inflated background is all that is left.
    let own = EnsembleSettings {
        inflation: Inflation { background: BackgroundInflation::Factor(1.1), ..Inflation::NONE },
        ..ensemble_settings(42)
    };
    let mut filter = EnsembleTransformKalmanFilter::new(problem.clone(), own).unwrap();
    let from = filter.forecast(WINDOW).unwrap();
    let background = from.estimate.state_spread.clone().unwrap();
    let mut observed = window(&problem, 3, false, 1, 5);
    observed.sigma = vec![1e9; 3];
    let analysis = filter.analyse(&from, &observed).unwrap().estimate.state_spread.unwrap();
    let expected: Vec<f64> = background.iter().map(|sigma| 1.1 * sigma).collect();
    assert!(relative_difference(&analysis, &expected) < 1e-10);
}

/// Innovations that are larger than the spread says make the adaptive factor grow, smaller ones let it fall.
#[test]
fn adaptive_inflation_follows_the_innovations() {
    let problem = problem(false, calibration(0, 0, 0.0), 2);
    let inflation = Inflation { background: BackgroundInflation::Adaptive { sigma: 0.3 }, ..Inflation::NONE };
    let ratio = |size: f64| {
        let own = EnsembleSettings { inflation, ..ensemble_settings(42) };
        let mut filter = LocalEnsembleTransformKalmanFilter::new(problem.clone(), own, EVERYWHERE).unwrap();
        let mut plain =
            LocalEnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(42), EVERYWHERE).unwrap();
        let from_filter = filter.forecast(WINDOW).unwrap();
        let from_plain = plain.forecast(WINDOW).unwrap();
        let mut observed = window(&problem, 20, false, 1, 5);
        observed.values.iter_mut().for_each(|value| *value *= size);
        let mean = |spread: Option<Vec<f64>>| spread.unwrap().iter().sum::<f64>();
        mean(filter.analyse(&from_filter, &observed).unwrap().estimate.state_spread)
            / mean(plain.analyse(&from_plain, &observed).unwrap().estimate.state_spread)
    };
    assert!(ratio(10.0) > 1.02, "{}", ratio(10.0));
    assert!(ratio(0.01) < 0.99, "{}", ratio(0.01));
}

/// The mean of the stochastic filter is the Kalman filter's, but for a sampling error that falls as 1/√N.
#[test]
fn the_stochastic_filter_converges_to_the_kalman_filter() {
    let problem = problem(true, calibration(2, 1, 0.3), 2);
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let observed = window(&problem, 14, false, 1, 5);
    let from_reference = reference.forecast(WINDOW).unwrap();
    let expected = reference.analyse(&from_reference, &observed).unwrap().estimate;
    let rms = |members: usize| {
        let (mut sum, mut count) = (0.0, 0);
        for seed in 0..6 {
            let own = EnsembleSettings {
                initial_members: InitialMembers::Random,
                model_error: ModelErrorTreatment::Random,
                seed,
                ..ensemble_settings(members)
            };
            let mut filter = StochasticEnsembleKalmanFilter::new(problem.clone(), own, f64::INFINITY).unwrap();
            let from_filter = filter.forecast(WINDOW).unwrap();
            let found = filter.analyse(&from_filter, &observed).unwrap().estimate;
            let values = found.state.values().iter().zip(expected.state.values());
            for (a, b) in values.chain(found.calibration.iter().zip(&expected.calibration)) {
                sum += (a - b).powi(2);
                count += 1;
            }
        }
        (sum / count as f64).sqrt()
    };
    let (few, many) = (rms(100), rms(1600));
    let size = (expected.state.values().iter().map(|x| x * x).sum::<f64>() / 40.0).sqrt();
    // Four times as good with 16 times as many, known to some 20 % from six seeds of 43 correlated values.
    assert!((2.8..5.6).contains(&(few / many)), "{few} with 100 members, {many} with 1600");
    assert!(many < 0.15 * size, "{many} beside an analysis of {size}");
}

/// The analysed mean is that of the members' covariance with its taper, formed as a matrix.
#[test]
fn tapered_covariances_are_those_of_the_formula() {
    let problem = problem(true, calibration(2, 0, 0.3), 2);
    let grid = &problem.background.layout().grid;
    let (cells, radius, members) = (grid.cells(), 3.5, 15);
    let place = |cell: usize| ((cell % grid.nx) as f64 + 0.5, (cell / grid.nx) as f64 + 0.5);
    // Observations of single values, where these are.
    let n = 12;
    let mut observed = window(&problem, n, false, 1, 5);
    let index = |row: usize| (7 * row) % (2 * cells);
    let (mut state, mut biases) = (SparseRows::new(), SparseRows::new());
    for row in 0..n {
        state.push_row([(index(row), 1.0)]);
        biases.push_row((row % 3 > 0).then_some((row % 3 - 1, 1.5)));
        (observed.reports[row].x_m, observed.reports[row].y_m) = place(index(row) % cells);
    }
    observed.operator = Arc::new(LinearOperator { jacobian: Jacobian { state, calibration: biases } });
    let jacobian = observed.operator.linearize(&problem.background, &[0.0; 2]);

    let own = EnsembleSettings { initial_members: InitialMembers::Random, ..ensemble_settings(members) };
    let mut filter = StochasticEnsembleKalmanFilter::new(problem.clone(), own, radius).unwrap();
    let background = filter.forecast(WINDOW).unwrap();
    let m = background.estimate.state.values().len();
    let mean: Vec<f64> =
        background.estimate.state.values().iter().chain(&background.estimate.calibration).copied().collect();
    // Summed over the images, as the plane is periodic.
    let images = |dx: f64, dy: f64| -> f64 {
        let shifts = (-2..=2).flat_map(|i| (-2..=2).map(move |j| (5.0 * f64::from(i), 4.0 * f64::from(j))));
        shifts.map(|(x, y)| gaspari_cohn((dx + x).hypot(dy + y) / radius)).sum()
    };
    let taper_of_cells = |a: usize, b: usize| {
        let (a, b) = (place(a), place(b));
        images(a.0 - b.0, a.1 - b.1) / images(0.0, 0.0)
    };
    let between = ((0..cells).map(|cell| taper_of_cells(0, cell)).sum::<f64>() / cells as f64).sqrt();
    let taper = |i: usize, j: usize| match (i < m, j < m) {
        (true, true) => taper_of_cells(i % cells, j % cells),
        (false, false) => 1.0,
        _ => between,
    };
    let values = filter.ensemble().values().to_owned();
    let covariance = |i: usize, j: usize| {
        let products = (0..members).map(|k| (values[(i, k)] - mean[i]) * (values[(j, k)] - mean[j]));
        taper(i, j) * products.sum::<f64>() / (members - 1) as f64
    };
    let p = Mat::from_fn(m + 2, m + 2, covariance);
    // The taper is positive semidefinite.
    let eigenvalues = Mat::from_fn(m + 2, m + 2, taper).self_adjoint_eigenvalues(Side::Lower).unwrap();
    assert!(eigenvalues[0] > -1e-12, "{}", eigenvalues[0]);
    let mut h = Mat::<f64>::zeros(n, m + 2);
    for row in 0..n {
        jacobian.state.row(row).iter().for_each(|&(column, weight)| h[(row, column)] = weight);
        jacobian.calibration.row(row).iter().for_each(|&(column, weight)| h[(row, m + column)] = weight);
    }
    let mut innovation = &h * &p * h.transpose();
    (0..n).for_each(|i| innovation[(i, i)] += observed.sigma[i].powi(2));
    let analysis = filter.analyse(&background, &observed).unwrap();
    let d = Mat::from_fn(n, 1, |i, _| analysis.background_departures[i]);
    let increment = &p * h.transpose() * innovation.llt(Side::Lower).unwrap().solve(&d);
    let expected: Vec<f64> = mean.iter().enumerate().map(|(i, mean)| mean + increment[(i, 0)]).collect();
    let found: Vec<f64> =
        analysis.estimate.state.values().iter().chain(&analysis.estimate.calibration).copied().collect();
    assert!(relative_difference(&found, &expected) < 1e-10);
}

#[test]
fn results_are_the_same_bits_on_any_number_of_threads() {
    let problem = problem(true, calibration(2, 2, 0.3), 2);
    let local = LocalSettings { localization_radius_m: 3.0, analysis_spacing_cells: 2 };
    type Build<'a> = Box<dyn Fn() -> Box<dyn Assimilator> + Sync + 'a>;
    let builds: [Build<'_>; 3] = [
        Box::new(|| Box::new(EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(20)).unwrap())),
        Box::new(|| {
            Box::new(LocalEnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(20), local).unwrap())
        }),
        Box::new(|| {
            Box::new(StochasticEnsembleKalmanFilter::new(problem.clone(), ensemble_settings(20), 3.0).unwrap())
        }),
    ];
    for build in &builds {
        let run = |threads: usize| -> Vec<u64> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut filter = build();
                let mut bits = Vec::new();
                for cycle in 1..=3 {
                    let from_filter = filter.forecast(WINDOW).unwrap();
                    let estimate =
                        filter.analyse(&from_filter, &window(&problem, 14, false, cycle, 5)).unwrap().estimate;
                    bits.extend(estimate.state.values().iter().chain(&estimate.calibration).map(|x| x.to_bits()));
                }
                bits
            })
        };
        assert_eq!(run(1), run(3));
    }
}

#[test]
fn ensembles_that_cannot_be_are_errors() {
    let problem = problem(true, calibration(3, 0, 0.3), 2);
    let message = |members: usize, memory_limit_bytes: u64| {
        let problem = isobar_assim::Problem { memory_limit_bytes, ..problem.clone() };
        match EnsembleTransformKalmanFilter::new(problem, ensemble_settings(members)).err() {
            Some(error @ (Error::Setting(_) | Error::TooLarge { .. })) => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    assert!(message(1, u64::MAX).contains("needs 2 members"));
    assert!(message(4, u64::MAX).contains("needs 5"));
    assert!(message(40, 1000).contains("40 members of 43 unknowns"));
}

/// A model that can forecast, and nothing else.
struct ForecastOnly(MatrixModel);

impl Model for ForecastOnly {
    fn layout(&self) -> &Arc<Layout> {
        self.0.layout()
    }
    fn time_step(&self) -> Duration {
        self.0.time_step()
    }
    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.0.largest_time_step_s(x)
    }
    fn step(&self, x: &mut State) {
        self.0.step(x);
    }
}

#[test]
fn an_ensemble_needs_no_tangent_linear_model() {
    let whole = problem(true, calibration(1, 1, 0.2), 4);
    let bare: Problem<dyn Model> = whole.clone().with_model(Arc::new(ForecastOnly(model(&layout(), true, 4))));
    let mut found = EnsembleTransformKalmanFilter::new(bare, ensemble_settings(12)).unwrap();
    let mut expected = EnsembleTransformKalmanFilter::new(whole.clone(), ensemble_settings(12)).unwrap();
    for cycle in 1..=3 {
        let observed = window(&whole, 9, false, cycle, 5);
        let from = found.forecast(WINDOW).unwrap();
        assert_eq!(from, expected.forecast(WINDOW).unwrap());
        assert_eq!(found.analyse(&from, &observed).unwrap(), expected.analyse(&from, &observed).unwrap());
    }
}
