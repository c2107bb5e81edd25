//! Fixed-lag smoothers against the textbook's recursion, each other and 4D-Var, on a small linear problem.

use crate::common::{self, *};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_assim::covariance::dense;
use isobar_assim::ensemble::{EnsembleSettings, EnsembleTransformKalmanFilter, Inflation, ModelErrorTreatment};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::variational::{FourDVar, FourDVarSettings};
use isobar_assim::{Assimilator, Calibrated, Error, Problem, Recalibration, SensorKnowledge};
use isobar_model::{State, Time, forecast};

const CYCLES: usize = 6;

fn complete(problem: &Problem) -> EnsembleSettings {
    let members = problem.background.values().len() + problem.calibration.len() + 1;
    EnsembleSettings { model_error: ModelErrorTreatment::Random, ..ensemble_settings(members) }
}

/// The Fast Kalman Filter with this number of factors and a smoother.
fn fast(problem: &Problem, factors: usize, lag: usize) -> FastKalmanFilter {
    let settings = FastKalmanSettings {
        factors,
        residual: Residual::Probe { count: 3 },
        ..settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    FastKalmanFilter::new(problem.clone(), settings).unwrap().smoothing(lag).unwrap()
}

/// The propagator of (x, c).
fn propagator(problem: &Problem) -> Mat<f64> {
    let (m, p) = (problem.background.values().len(), problem.calibration.len());
    let mut columns = vec![0.0; m * m];
    columns.iter_mut().step_by(m + 1).for_each(|it| *it = 1.0);
    forecast::forecast_tl(&*problem.model, &mut problem.background.clone(), &mut columns, 1).unwrap();
    let kept = problem.calibration.kept(WINDOW);
    Mat::from_fn(m + p, m + p, |i, j| match (i < m, j < m) {
        (true, true) => columns[j * m + i],
        (false, false) if i == j => kept[i - m],
        _ => 0.0,
    })
}

/// `ŝ_t + J (ŝˢ_{t+1} − ŝ⁻_{t+1})` and `P_t + J (Pˢ_{t+1} − P⁻_{t+1}) Jᵀ` with `J = P_t Aᵀ (P⁻_{t+1})⁻¹` (Rauch, Tung and
/// Striebel 1965), backwards through all cycles, with everything dense.
#[test]
fn the_dense_smoother_is_that_of_rauch_tung_and_striebel() {
    for (shared, local, drift) in [(0, 0, 0.0), (3, 2, 0.7)] {
        let problem = problem(true, calibration(shared, local, drift), 2);
        let a = propagator(&problem);
        let mut filter = KalmanFilter::new(problem.clone()).unwrap().smoothing(CYCLES).unwrap();
        let m = problem.background.values().len();
        let (mut analyses, mut backgrounds) = (Vec::new(), Vec::new());
        for number in 1..=CYCLES {
            if let Some((_, covariance)) = analyses.last() {
                let covariance: &Mat<f64> = covariance;
                let mut background = &a * covariance * a.transpose();
                let error = dense(&**problem.model_error.as_ref().unwrap());
                let mut state = background.as_mut().get_mut(..m, ..m);
                state += error;
                for (i, parameter) in problem.calibration.parameters.iter().enumerate() {
                    background[(m + i, m + i)] += parameter.drift.added_variance(WINDOW);
                }
                backgrounds.push(background);
            }
            let analysis = cycle(&mut filter, &problem, number);
            analyses.push((values_and_spread(&analysis)[0].clone(), filter.covariance().to_owned()));
            let (mut mean, mut covariance) = analyses.last().unwrap().clone();
            for ago in 0..number {
                let t = number - 1 - ago;
                if ago > 0 {
                    let (own, own_covariance) = &analyses[t];
                    let (background, own_mean) = (&backgrounds[t], Mat::from_fn(own.len(), 1, |i, _| own[i]));
                    let forecast_mean = &a * own_mean;
                    let inverse = background.llt(Side::Lower).unwrap();
                    let gain = inverse.solve(&a * own_covariance).transpose().to_owned();
                    let change = Mat::from_fn(own.len(), 1, |i, _| mean[i] - forecast_mean[(i, 0)]);
                    let change = &gain * change;
                    mean = (0..own.len()).map(|i| own[i] + change[(i, 0)]).collect();
                    covariance = own_covariance + &gain * (covariance - background) * gain.transpose();
                }
                let found = smoothed(&filter, ago).unwrap();
                let [values, spread] = values_and_spread(&found);
                let expected: Vec<f64> = (0..mean.len()).map(|i| covariance[(i, i)].sqrt()).collect();
                let error = relative_difference(&values, &mean).max(relative_difference(&spread, &expected));
                assert!(error < 1e-9, "cycle {number}, {ago} ago, {shared} shared: {error:e}");
            }
            assert!(smoothed(&filter, number).is_none());
        }
    }
}

/// With as many members as directions, and nothing added on the way that would have to be drawn.
#[test]
fn a_complete_ensemble_smoother_is_the_dense_one() {
    for (shared, local) in [(0, 0), (3, 2)] {
        let problem = Problem { model_error: None, ..problem(true, calibration(shared, local, 0.0), 2) };
        let filter = EnsembleTransformKalmanFilter::new(problem.clone(), complete(&problem)).unwrap();
        let mut ensemble = filter.smoothing(4).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap().smoothing(4).unwrap();
        for number in 1..=CYCLES {
            cycle(&mut ensemble, &problem, number);
            cycle(&mut reference, &problem, number);
            for ago in 0..number.min(5) {
                let found = smoothed(&ensemble, ago).unwrap();
                let error = estimate_difference(&found, &smoothed(&reference, ago).unwrap());
                assert!(error < 1e-8, "cycle {number}, {ago} ago, {shared} shared: {error:e}");
            }
            let beyond = (smoothed(&ensemble, 5), smoothed(&reference, 5));
            assert!(beyond.0.is_none() && beyond.1.is_none());
        }
    }
}

/// With as many factors as unknowns there is nothing in the blocks that could be dropped.
#[test]
fn a_complete_fast_smoother_is_the_dense_one() {
    for shared in [0, 3] {
        let problem = problem(true, calibration(shared, 0, 0.7), 2);
        let mut fast = fast(&problem, problem.background.values().len(), 4);
        let mut reference = KalmanFilter::new(problem.clone()).unwrap().smoothing(4).unwrap();
        for number in 1..=CYCLES {
            cycle(&mut fast, &problem, number);
            cycle(&mut reference, &problem, number);
            for ago in 0..number.min(5) {
                let found = smoothed(&fast, ago).unwrap();
                let error = estimate_difference(&found, &smoothed(&reference, ago).unwrap());
                assert!(error < 1e-9, "cycle {number}, {ago} ago, {shared} shared: {error:e}");
            }
            assert!(smoothed(&fast, 5).is_none());
        }
    }
}

/// Of a perfect model every smoothed state leads to the present analysis, which is that of 4D-Var over the same cycles.
#[test]
fn the_smoothed_trajectory_is_that_of_four_d_var() {
    let problem = Problem { model_error: None, ..problem(true, calibration(3, 2, 0.0), 2) };
    let settings = FourDVarSettings {
        window_cycles: 5,
        covariance_scale: 1.0,
        outer_loops: 1,
        tolerance: 1e-13,
        max_iterations: 500,
    };
    let mut variational = FourDVar::new(problem.clone(), settings).unwrap();
    let mut smoother = KalmanFilter::new(problem.clone()).unwrap().smoothing(5).unwrap();
    let mut analysis = None;
    for number in 1..=5 {
        analysis = Some(cycle(&mut variational, &problem, number));
        cycle(&mut smoother, &problem, number);
    }
    let analysis = analysis.unwrap();
    for ago in 0..5 {
        let smoothed = smoothed(&smoother, ago).unwrap();
        let mut state: State = smoothed.state;
        forecast::forecast(&*problem.model, &mut state, ago).unwrap();
        let error = relative_difference(state.values(), analysis.state.values())
            .max(relative_difference(&smoothed.calibration, &analysis.calibration));
        assert!(error < 1e-8, "{ago} ago: {error:e}");
    }
}

/// The filter's analyses do not notice the smoother; with no lag it is the filter, and no later observation takes away from
/// what an analysis knows, inflated members or not.
#[test]
fn a_smoother_claims_no_more_than_its_filter() {
    let problem = problem(true, calibration(3, 2, 0.7), 2);
    let inflation = Inflation {
        background: isobar_assim::ensemble::BackgroundInflation::Factor(1.2),
        relaxation_to_prior_perturbations: 0.2,
        relaxation_to_prior_spread: 0.2,
    };
    let settings = EnsembleSettings { inflation, ..complete(&problem) };
    let etkf = || EnsembleTransformKalmanFilter::new(problem.clone(), settings).unwrap();
    let kf = || KalmanFilter::new(problem.clone()).unwrap();
    let plain = || {
        let base = common::settings(BlockShape::Cell, BiasCoupling::Carry);
        let settings = FastKalmanSettings { factors: 20, residual: Residual::Probe { count: 3 }, ..base };
        FastKalmanFilter::new(problem.clone(), settings).unwrap()
    };
    let methods: [[Box<dyn Assimilator>; 3]; 3] = [
        [Box::new(plain()), Box::new(fast(&problem, 20, 0)), Box::new(fast(&problem, 20, 3))],
        [Box::new(etkf()), Box::new(etkf().smoothing(0).unwrap()), Box::new(etkf().smoothing(3).unwrap())],
        [Box::new(kf()), Box::new(kf().smoothing(0).unwrap()), Box::new(kf().smoothing(3).unwrap())],
    ];
    for [mut filter, mut without_lag, mut smoother] in methods {
        assert_eq!((lag(&*filter), lag(&*without_lag)), (None, Some(0)));
        let mut analyses = Vec::new();
        for number in 1..=CYCLES {
            let analysis = cycle(&mut *filter, &problem, number);
            assert_eq!(cycle(&mut *smoother, &problem, number), analysis);
            cycle(&mut *without_lag, &problem, number);
            assert!(smoothed(&*filter, 0).is_none());
            let itself = smoothed(&*without_lag, 0).unwrap();
            assert!(estimate_difference(&itself, &analysis) < 1e-13 && smoothed(&*without_lag, 1).is_none());
            analyses.push(values_and_spread(&analysis));
            for ago in 1..number.min(4) {
                let [values, spread] = values_and_spread(&smoothed(&*smoother, ago).unwrap());
                let [filtered, claimed] = &analyses[number - 1 - ago];
                assert!(spread.iter().zip(claimed).all(|(own, filter)| *own <= filter * (1.0 + 1e-12)));
                // There are observations after each of them.
                let with_later = number != 3 || ago > 1;
                assert_eq!(relative_difference(&values, filtered) > 1e-3, with_later);
            }
        }
    }
}

#[test]
fn a_smoother_goes_on_from_its_memory_to_the_same_bits() {
    let problem = problem(true, calibration(3, 2, 0.7), 2);
    let tiles = LocalFactorSettings { factor_precision: Precision::Single, ..tile_settings() };
    let make: [&dyn Fn() -> Box<dyn Assimilator>; 4] = [
        &|| Box::new(KalmanFilter::new(problem.clone()).unwrap().smoothing(3).unwrap()),
        &|| Box::new(fast(&problem, 12, 3)),
        &|| {
            let filter = LocalFastKalmanFilter::with_local_factors(problem.clone(), tiles).unwrap();
            Box::new(filter.smoothing(3).unwrap())
        },
        &|| {
            let filter = EnsembleTransformKalmanFilter::new(problem.clone(), complete(&problem)).unwrap();
            Box::new(filter.smoothing(3).unwrap())
        },
    ];
    for make in make {
        let mut method = make();
        (1..=4).for_each(|number| drop(cycle(&mut *method, &problem, number)));
        let mut other = make();
        other.recall(&mut &method.memory().unwrap()[..]).unwrap();
        for number in 5..=CYCLES {
            assert_eq!(cycle(&mut *method, &problem, number), cycle(&mut *other, &problem, number));
            for ago in 0..=3 {
                let found = smoothed(&*method, ago);
                assert!(found.is_some() && found == smoothed(&*other, ago));
            }
        }
        let mut short = make();
        assert!(matches!(short.recall(&mut &[1_u8, 2, 3][..]), Err(Error::Memory { .. })));
    }
}

/// What a smoother says of a bias before an announced step is without the step.
#[test]
fn a_recalibration_is_not_carried_back() {
    let problem = problem(true, calibration(2, 1, 0.0), 2);
    let p = problem.calibration.len();
    let smoothed = |recalibrations: Vec<Recalibration>, step: f64| {
        let filter = KalmanFilter::new(problem.clone()).unwrap().smoothing(5).unwrap();
        let knowledge = SensorKnowledge { mean: vec![0.0; p], recalibrations };
        let mut method = Calibrated::new(Box::new(filter), &problem.calibration, Time::from_seconds(0), knowledge);
        for number in 1..=5 {
            let from = method.forecast(WINDOW).unwrap();
            let mut observed = window(&problem, 14, false, number, 5);
            let jacobian = observed.operator.linearize(&problem.background, &[0.0; 3]).calibration;
            for (row, value) in observed.values.iter_mut().enumerate() {
                let read: f64 = jacobian.row(row).iter().filter(|entry| entry.0 == 1).map(|entry| entry.1).sum();
                *value += if number > 2 { read * step } else { 0.0 };
            }
            method.analyse(&from, &observed).unwrap();
        }
        (0..5).map(|ago| smoothed(&method, ago).unwrap()).collect::<Vec<_>>()
    };
    let time = Time::from_seconds(2 * WINDOW.seconds() + 60);
    let stepped = smoothed(vec![Recalibration { time, parameter: 1, step: 4.0, sigma: 0.0 }], 4.0);
    for (ago, (mut found, expected)) in stepped.into_iter().zip(smoothed(Vec::new(), 0.0)).enumerate() {
        if ago < 3 {
            found.calibration[1] -= 4.0;
        }
        assert!(estimate_difference(&found, &expected) < 1e-12, "{ago} ago");
    }
}

#[test]
fn what_a_smoother_cannot_do_is_refused() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    let etkf = EnsembleTransformKalmanFilter::new(problem.clone(), ensemble_settings(42)).unwrap();
    let Err(Error::Setting(reason)) = etkf.smoothing(2) else { panic!("the square root of Q is accepted") };
    assert!(reason.contains("random draws"), "{reason}");
    let small = Problem { memory_limit_bytes: 8 * 5 * 42 * 42, ..problem };
    let kf = KalmanFilter::new(small.clone()).unwrap();
    assert!(matches!(kf.smoothing(1), Err(Error::TooLarge { .. })));
    let dropped = settings(BlockShape::Cell, BiasCoupling::Drop);
    let Err(Error::Setting(reason)) = FastKalmanFilter::new(small.clone(), dropped).unwrap().smoothing(1) else {
        panic!("a smoother without factors")
    };
    assert!(reason.contains("drop"), "{reason}");
    let draws = EnsembleSettings { model_error: ModelErrorTreatment::Random, ..ensemble_settings(8) };
    // Six ensembles, and the analysis in their space.
    let small = Problem { memory_limit_bytes: 8 * (6 * 8 * 42 + 5 * 8 * 8), ..small };
    let etkf = |lag| EnsembleTransformKalmanFilter::new(small.clone(), draws).unwrap().smoothing(lag);
    assert!(etkf(1).is_ok() && matches!(etkf(5), Err(Error::TooLarge { .. })));
}
