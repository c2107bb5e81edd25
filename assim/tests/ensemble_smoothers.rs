//! Smoothers of ensembles whose analysis is local or stochastic, on a small linear problem.

use crate::common::*;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, InitialMembers,
    LocalEnsembleTransformKalmanFilter, LocalSettings, ModelErrorTreatment, StochasticEnsembleKalmanFilter,
};
use isobar_assim::testing::Still;
use isobar_assim::{Assimilator, Error, Estimate, Problem};
use isobar_model::Model;
use isobar_obs::ObservationWindow;
use std::sync::Arc;

const LAG: usize = 3;
const CYCLES: usize = 6;
const EVERYWHERE: LocalSettings = LocalSettings { localization_radius_m: f64::INFINITY, analysis_spacing_cells: 1 };
const NEAR: LocalSettings = LocalSettings { localization_radius_m: 3.0, analysis_spacing_cells: 2 };

/// Observations that are scattered over the plane; none in cycle 3.
fn observed(problem: &Problem, cycle: usize) -> ObservationWindow {
    let grid = &problem.background.layout().grid;
    let mut observed = window(problem, if cycle == 3 { 0 } else { 14 }, false, cycle, 5);
    for (row, report) in observed.reports.iter_mut().enumerate() {
        let cell = (7 * row + 3 * cycle) % grid.cells();
        (report.x_m, report.y_m) = ((cell % grid.nx) as f64 + 0.4, (cell / grid.nx) as f64 + 0.7);
    }
    observed
}

fn cycle(method: &mut dyn Assimilator, problem: &Problem, number: usize) -> Estimate {
    let from = method.forecast(WINDOW).unwrap();
    method.analyse(&from, &observed(problem, number)).unwrap().estimate
}

/// Members that get draws of Q, and inflation of every kind.
fn inflated(members: usize) -> EnsembleSettings {
    let inflation = Inflation {
        background: BackgroundInflation::Factor(1.2),
        relaxation_to_prior_perturbations: 0.2,
        relaxation_to_prior_spread: 0.2,
    };
    EnsembleSettings { inflation, ..drawn(members) }
}

/// The same without any.
fn drawn(members: usize) -> EnsembleSettings {
    EnsembleSettings {
        model_error: ModelErrorTreatment::Random,
        initial_members: InitialMembers::Random,
        ..ensemble_settings(members)
    }
}

fn letkf(problem: &Problem, settings: EnsembleSettings, local: LocalSettings) -> LocalEnsembleTransformKalmanFilter {
    LocalEnsembleTransformKalmanFilter::new(problem.clone(), settings, local).unwrap()
}

fn enkf(problem: &Problem, settings: EnsembleSettings, radius_m: f64) -> StochasticEnsembleKalmanFilter {
    StochasticEnsembleKalmanFilter::new(problem.clone(), settings, radius_m).unwrap()
}

/// Inflated or not; with more and fewer members than observations.
#[test]
fn without_localisation_the_local_smoother_is_the_global_one() {
    // One shared bias, which every cycle with observations sees.
    for (shared, local) in [(0, 0), (1, 0), (0, 2)] {
        let problem = problem(true, calibration(shared, local, 0.7), 2);
        for settings in [drawn(12), inflated(12), inflated(30)] {
            let mut found = letkf(&problem, settings, EVERYWHERE).smoothing(LAG).unwrap();
            let global = EnsembleTransformKalmanFilter::new(problem.clone(), settings).unwrap();
            let mut expected = global.smoothing(LAG).unwrap();
            for number in 1..=CYCLES {
                cycle(&mut found, &problem, number);
                cycle(&mut expected, &problem, number);
                for ago in 0..number.min(LAG + 1) {
                    let expected = smoothed(&expected, ago).unwrap();
                    let error = estimate_difference(&smoothed(&found, ago).unwrap(), &expected);
                    assert!(error < 1e-9, "cycle {number}, {ago} ago, {shared} shared, {local} local: {error:e}");
                }
                assert!(smoothed(&found, LAG + 1).is_none());
            }
        }
    }
}

/// Means by `x̂ ← x̂ + Cov(x, h) (Cov(h, h) + R)⁻¹ d` with the covariances of the members then and now; and each member by
/// the weights that take the members now to their analysis, `X W` of rank N − 1.
#[test]
fn without_a_taper_the_stochastic_smoother_is_the_formula_of_its_members() {
    let problem = problem(true, calibration(3, 2, 0.7), 2);
    let (m, p, members) = (problem.background.values().len(), problem.calibration.len(), 16);
    let settings = drawn(members);
    let mut filter = enkf(&problem, settings, f64::INFINITY).smoothing(LAG).unwrap();
    let mut plain = enkf(&problem, settings, f64::INFINITY);
    let about_mean = |values: &Mat<f64>| {
        let mean = |i: usize| (0..members).map(|j| values[(i, j)]).sum::<f64>() / members as f64;
        Mat::from_fn(values.nrows(), members, |i, j| values[(i, j)] - mean(i))
    };
    let mean_of = |values: &Mat<f64>| -> Vec<f64> {
        (0..values.nrows()).map(|i| (0..members).map(|j| values[(i, j)]).sum::<f64>() / members as f64).collect()
    };
    let mut past: Vec<Mat<f64>> = Vec::new();
    for number in 1..=CYCLES {
        let observed = observed(&problem, number);
        let from = filter.forecast(WINDOW).unwrap();
        let before = filter.ensemble().values().to_owned();
        let analysis = filter.analyse(&from, &observed).unwrap();
        let after = filter.ensemble().values().to_owned();
        assert_eq!(cycle(&mut plain, &problem, number), analysis.estimate);
        let now = about_mean(&before);
        // The last perturbation is the sum of the others with the other sign, and any W that takes X to X W is as good.
        let independent = now.get(.., ..members - 1).to_owned();
        let increments = &after - &before;
        let gram = independent.transpose() * &independent;
        let weights = gram.llt(Side::Lower).unwrap().solve(independent.transpose() * &increments);
        let n = observed.len();
        let seen = dense_jacobian(&observed, &from.estimate) * &now;
        let mut innovation = &seen * seen.transpose();
        innovation *= faer::Scale(1.0 / (members - 1) as f64);
        (0..n).for_each(|i| innovation[(i, i)] += observed.sigma[i].powi(2));
        let d = Mat::from_fn(n, 1, |i, _| analysis.background_departures[i]);
        let solved = if n > 0 { innovation.llt(Side::Lower).unwrap().solve(&d) } else { d };
        past = past.split_off(past.len().saturating_sub(LAG));
        for past in &mut past {
            let deviations = about_mean(past);
            let all_weights =
                Mat::from_fn(members, members, |i, j| if i + 1 < members { weights[(i, j)] } else { 0.0 });
            let step = &deviations * all_weights;
            let mean = mean_of(past);
            *past += step;
            let gain = &deviations * seen.transpose() * &solved * faer::Scale(1.0 / (members - 1) as f64);
            let expected: Vec<f64> = mean.iter().enumerate().map(|(i, mean)| mean + gain[(i, 0)]).collect();
            assert!(relative_difference(&mean_of(past), &expected) < 1e-9, "cycle {number}");
        }
        past.push(after);
        for (ago, past) in past.iter().rev().enumerate() {
            let [values, spread] = values_and_spread(&smoothed(&filter, ago).unwrap());
            let deviations = about_mean(past);
            let square = |i: usize| (0..members).map(|j| deviations[(i, j)].powi(2)).sum::<f64>();
            let expected: Vec<f64> = (0..m + p).map(|i| (square(i) / (members - 1) as f64).sqrt()).collect();
            let error = relative_difference(&values, &mean_of(past)).max(relative_difference(&spread, &expected));
            assert!(error < 1e-9, "cycle {number}, {ago} ago: {error:e}");
        }
    }
}

/// Where nothing changes with time, earlier states are the present one, localised and interpolated as that is.
#[test]
fn of_what_stays_the_past_is_the_present() {
    let moving = problem(true, calibration(2, 2, 0.0), 2);
    let model: Arc<dyn Model> = Arc::new(Still(Arc::clone(moving.background.layout())));
    let still = Problem { model_error: None, ..moving.clone().with_model(model) };
    let local = |local| LocalEnsembleTransformKalmanFilter::new(still.clone(), drawn(15), local).unwrap();
    let tapered = StochasticEnsembleKalmanFilter::new(still.clone(), drawn(15), 3.0).unwrap();
    let methods: [Box<dyn Assimilator>; 3] = [
        Box::new(local(NEAR).smoothing(LAG).unwrap()),
        Box::new(local(LocalSettings { analysis_spacing_cells: 1, ..NEAR }).smoothing(LAG).unwrap()),
        Box::new(tapered.smoothing(LAG).unwrap()),
    ];
    for mut method in methods {
        for number in 1..=CYCLES {
            let analysis = cycle(&mut *method, &moving, number);
            for ago in 0..number.min(LAG + 1) {
                let error = estimate_difference(&smoothed(&*method, ago).unwrap(), &analysis);
                assert!(error < 1e-11, "cycle {number}, {ago} ago: {error:e}");
            }
        }
    }
}

/// No local transform adds to a variance, inflated or not, and the filter does not notice its smoother.
#[test]
fn a_local_smoother_claims_no_more_than_its_filter() {
    let problem = problem(true, calibration(3, 2, 0.7), 2);
    let local = LocalSettings { analysis_spacing_cells: 1, ..NEAR };
    let mut filter = letkf(&problem, inflated(12), local);
    let mut smoother = letkf(&problem, inflated(12), local).smoothing(LAG).unwrap();
    assert_eq!((lag(&filter), lag(&smoother)), (None, Some(LAG)));
    let mut analyses = Vec::new();
    for number in 1..=CYCLES {
        let analysis = cycle(&mut filter, &problem, number);
        assert_eq!(cycle(&mut smoother, &problem, number), analysis);
        analyses.push(values_and_spread(&analysis));
        for ago in 1..number.min(LAG + 1) {
            let [values, spread] = values_and_spread(&smoothed(&smoother, ago).unwrap());
            let [filtered, claimed] = &analyses[number - 1 - ago];
            assert!(spread.iter().zip(claimed).all(|(own, filter)| *own <= filter * (1.0 + 1e-12)));
            let with_later = number != 3 || ago > 1;
            assert_eq!(relative_difference(&values, filtered) > 1e-3, with_later);
        }
    }
}

#[test]
fn it_is_the_same_bits_on_any_number_of_threads_and_from_its_memory() {
    let problem = problem(true, calibration(2, 2, 0.3), 2);
    type Build<'a> = Box<dyn Fn() -> Box<dyn Assimilator> + Sync + 'a>;
    let builds: [Build<'_>; 2] = [
        Box::new(|| Box::new(letkf(&problem, inflated(20), NEAR).smoothing(LAG).unwrap())),
        Box::new(|| Box::new(enkf(&problem, inflated(20), 3.0).smoothing(LAG).unwrap())),
    ];
    for build in &builds {
        let run = |threads: usize, interrupted: bool| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (mut method, mut found) = (build(), Vec::new());
                for number in 1..=CYCLES {
                    cycle(&mut *method, &problem, number);
                    found.extend((0..=LAG).map(|ago| smoothed(&*method, ago)));
                    if interrupted {
                        let memory = method.memory().unwrap();
                        method = build();
                        method.recall(&mut &memory[..]).unwrap();
                    }
                }
                found
            })
        };
        let once = run(1, false);
        assert!(once == run(3, false) && once == run(1, true));
        assert!(matches!(build().recall(&mut &[1_u8, 2, 3][..]), Err(Error::Memory { .. })));
    }
}

#[test]
fn what_the_smoothers_cannot_do_is_refused() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    let refused = [
        letkf(&problem, ensemble_settings(8), NEAR).smoothing(2).err(),
        enkf(&problem, ensemble_settings(8), 3.0).smoothing(2).err(),
    ];
    for error in refused {
        let Some(Error::Setting(reason)) = error else { panic!("the square root of Q is accepted: {error:?}") };
        assert!(reason.contains("random draws"), "{reason}");
    }
    let small = Problem { memory_limit_bytes: 1 << 20, ..problem };
    let needs = |lag| {
        let errors =
            [letkf(&small, drawn(8), NEAR).smoothing(lag).err(), enkf(&small, drawn(8), 3.0).smoothing(lag).err()];
        errors.map(|error| error.map(|error| error.to_string()))
    };
    assert_eq!(needs(1), [None, None]);
    for error in needs(1000).into_iter().flatten() {
        assert!(error.contains("the 1000 earlier analyses of its smoother"), "{error}");
    }
    assert!(needs(1000).iter().all(Option::is_some));
}
