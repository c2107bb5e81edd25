//! Observations whose errors are beyond rounding, alone, with each other and with ordinary ones.

use crate::common::*;
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, Inflation,
    LocalEnsembleTransformKalmanFilter, LocalSettings, StochasticEnsembleKalmanFilter,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::variational::{
    FourDVar, FourDVarSettings, HybridSettings, HybridThreeDVar, ThreeDVar, ThreeDVarSettings,
};
use isobar_assim::{Assimilator, Problem, covariance};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Grid, Layout, State};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

const EVERYWHERE: LocalSettings = LocalSettings { localization_radius_m: f64::INFINITY, analysis_spacing_cells: 1 };
/// The value that is observed.
const CELL: usize = 7;

fn variational() -> ThreeDVarSettings {
    ThreeDVarSettings { covariance_scale: 1.0, tolerance: 1e-6, max_iterations: 100 }
}

/// All methods of the filters' kind, and whether one gets the answer at any σ or may say that it cannot.
fn methods(problem: &Problem) -> Vec<(&'static str, bool, Box<dyn Assimilator>)> {
    let complete = ensemble_settings(41);
    let fast = |blocks| FastKalmanFilter::new(problem.clone(), settings(blocks, BiasCoupling::Carry)).unwrap();
    let four = FourDVarSettings {
        window_cycles: 1,
        covariance_scale: 1.0,
        outer_loops: 1,
        tolerance: 1e-6,
        max_iterations: 100,
    };
    let hybrid = HybridSettings {
        ensemble_weight: 0.5,
        variational: variational(),
        ensemble: complete,
        local: LocalSettings { localization_radius_m: 3.0, ..EVERYWHERE },
    };
    let near = LocalSettings { localization_radius_m: 1.5, ..EVERYWHERE };
    vec![
        ("kf", false, Box::new(KalmanFilter::new(problem.clone()).unwrap())),
        ("serial_kf", false, Box::new(KalmanFilter::serial(problem.clone()).unwrap())),
        ("banded_kf", false, Box::new(BandedKalmanFilter::new(problem.clone(), 39).unwrap())),
        ("fkf", false, Box::new(fast(BlockShape::Domain))),
        ("fkf of cells", false, Box::new(fast(BlockShape::Cell))),
        ("oi", false, Box::new(OptimalInterpolation::new(problem.clone(), 1.0).unwrap())),
        (
            "enkf",
            false,
            Box::new(StochasticEnsembleKalmanFilter::new(problem.clone(), complete, f64::INFINITY).unwrap()),
        ),
        ("3dvar", true, Box::new(ThreeDVar::new(problem.clone(), variational()).unwrap())),
        ("4dvar", true, Box::new(FourDVar::new(problem.clone(), four).unwrap())),
        ("hybrid_3dvar", true, Box::new(HybridThreeDVar::new(problem.clone(), hybrid).unwrap())),
        ("etkf", true, Box::new(EnsembleTransformKalmanFilter::new(problem.clone(), complete).unwrap())),
        (
            "letkf",
            true,
            Box::new(LocalEnsembleTransformKalmanFilter::new(problem.clone(), complete, EVERYWHERE).unwrap()),
        ),
        (
            "local letkf",
            true,
            Box::new(LocalEnsembleTransformKalmanFilter::new(problem.clone(), complete, near).unwrap()),
        ),
    ]
}

/// Observations of single values, `(index, value, σ)`, in their cells.
fn observations(problem: &Problem, of: &[(usize, f64, f64)]) -> ObservationWindow {
    let mut window = window(problem, of.len(), false, 1, 1);
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for (row, &(index, ..)) in of.iter().enumerate() {
        state.push_row([(index, 1.0)]);
        calibration.push_row([]);
        let cell = index % 20;
        (window.reports[row].x_m, window.reports[row].y_m) = ((cell % 5) as f64 + 0.5, (cell / 5) as f64 + 0.5);
    }
    window.operator = Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } });
    window.values = of.iter().map(|observation| observation.1).collect();
    window.sigma = of.iter().map(|observation| observation.2).collect();
    window
}

/// Of two observations 1 and 2 of one value with the same σ both count the same: (1 + 2)/2 · s²/(s² + σ²/2).
#[test]
fn two_accurate_observations_that_differ_count_the_same() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    for sigma in [1e-18, 1e-16, 1e-12, 1e-10, 1e-9, 3e-8, 1.5e-8, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4] {
        let observed = observations(&problem, &[(CELL, 1.0, sigma), (CELL, 2.0, sigma)]);
        for (name, always, mut method) in methods(&problem) {
            let from = method.forecast(WINDOW).unwrap();
            match method.analyse(&from, &observed) {
                Ok(analysis) => {
                    let found = analysis.estimate.state.values()[CELL];
                    assert!((found - 1.5).abs() < 1e-6, "{name}, σ = {sigma:e}: {found}");
                    // (1 − 2)²/2σ² and what is left of the mean's departure, 1.5²/(s² + σ²/2), which is below 10.
                    if let Some(chi2) = analysis.innovation_chi2 {
                        let expected = 0.5 / (sigma * sigma);
                        assert!((chi2 / expected - 1.0).abs() < 1e-5, "{name}, σ = {sigma:e}: χ² {chi2:e}");
                    }
                }
                Err(error) => assert!(!always, "{name}, σ = {sigma:e}: {error}"),
            }
        }
    }
}

/// One observation without an error to speak of leaves what the others say of other places.
#[test]
fn an_accurate_observation_does_not_drown_the_others() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    let others = [(1, 0.7, 0.5), (12, -1.1, 0.6), (23, 2.0, 0.4), (38, 0.3, 0.9)];
    let with = |first: &[(usize, f64, f64)]| observations(&problem, &[first, &others].concat());
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let from = reference.forecast(WINDOW).unwrap();
    let expected = reference.analyse(&from, &with(&[(CELL, 1.5, 1e-9)])).unwrap();
    for sigma in [1e-18, 1e-14, 1e-10, 1e-6] {
        let observed = with(&[(CELL, 1.0, sigma), (CELL, 2.0, sigma)]);
        for members in [41, 60] {
            let own = ensemble_settings(members);
            let mut filter = EnsembleTransformKalmanFilter::new(problem.clone(), own).unwrap();
            let from = filter.forecast(WINDOW).unwrap();
            let found = filter.analyse(&from, &observed).unwrap().estimate;
            let difference = relative_difference(found.state.values(), expected.estimate.state.values());
            assert!(difference < 1e-7, "{members} members, σ = {sigma:e}: {difference:e}");
            let (found, expected) = (found.state_spread.unwrap(), expected.estimate.state_spread.as_ref().unwrap());
            let difference = relative_difference(&found, expected);
            // The reference has another σ at the accurate observation.
            assert!(difference < 1e-7 + sigma, "{members} members, σ = {sigma:e}: spread {difference:e}");
        }
    }
}

/// A linear method multiplies a departure by the same gain however large it is.
#[test]
fn no_departure_is_too_large_for_an_ensemble() {
    let problem = problem(true, calibration(0, 0, 0.0), 2);
    for size in [1.0, 1e8, 1e12, 1e16, 1e17, 1e25] {
        for (name, _, mut method) in
            methods(&problem).into_iter().filter(|it| it.0 != "local letkf" && it.0 != "hybrid_3dvar")
        {
            let gain = |method: &mut dyn Assimilator, size: f64| {
                let from = method.forecast(WINDOW).unwrap();
                let observed = observations(&problem, &[(CELL, size, 1.0)]);
                method.analyse(&from, &observed).unwrap().estimate.state.values()[CELL] / size
            };
            let (_, _, mut same) = methods(&problem).into_iter().find(|it| it.0 == name).unwrap();
            let (found, expected) = (gain(&mut *method, size), gain(&mut *same, 1.0));
            // The stochastic filter's random draws have mean zero to rounding.
            assert!((found / expected - 1.0).abs() < 1e-9, "{name} at {size:e}: {found} for {expected}");
        }
    }
}

/// Where no observation has an influence, inflation does not multiply the spread from cycle to cycle.
#[test]
fn unobserved_places_are_not_inflated() {
    let problem = Problem { model_error: None, ..problem(false, calibration(0, 0, 0.0), 2) };
    let inflation = Inflation { background: BackgroundInflation::Factor(1.1), ..Inflation::NONE };
    let own = EnsembleSettings { inflation, ..ensemble_settings(41) };
    let local = LocalSettings { localization_radius_m: 1.2, ..EVERYWHERE };
    let filters: [Box<dyn Assimilator>; 2] = [
        Box::new(StochasticEnsembleKalmanFilter::new(problem.clone(), own, 1.2).unwrap()),
        Box::new(LocalEnsembleTransformKalmanFilter::new(problem.clone(), own, local).unwrap()),
    ];
    for mut filter in filters {
        let from = filter.forecast(WINDOW).unwrap();
        let background = from.estimate.state_spread.clone().unwrap();
        let observed = observations(&problem, &[(CELL, 1.0, 1e9)]);
        let analysed = filter.analyse(&from, &observed).unwrap().estimate.state_spread.unwrap();
        let ratio = |index: usize| analysed[index] / background[index];
        // The observation says nothing, so all that is left is the inflation: full there, none two cells away, and between
        // them by the taper at a distance of 1, which is 7e-5.
        assert!((ratio(CELL) - 1.1).abs() < 1e-9, "{}", ratio(CELL));
        assert!((ratio(CELL + 2) - 1.0).abs() < 1e-12, "{}", ratio(CELL + 2));
        assert!((1.0..1.001).contains(&(ratio(CELL + 1) + 1e-12)), "{}", ratio(CELL + 1));
    }
}

/// With as many factors as variables the filter is the Kalman filter, and what rounding leaves in the blocks stays far below
/// the variance of accurate observations in 3000 cycles: errors are what is claimed, and claims those of the Kalman filter.
#[test]
fn rounding_does_not_pile_up_in_the_blocks_beside_all_factors() {
    for (residual, sigma) in
        [(Residual::Persist, 1e-6), (Residual::Probe { count: 2 }, 1e-6), (Residual::Persist, 1e-7)]
    {
        let mut problem = problem(true, calibration(0, 0, 0.0), 2);
        let grid = Grid { nx: 3, ny: 2, ..problem.background.layout().grid.clone() };
        let layout = Arc::new(Layout { grid, ..(**problem.background.layout()).clone() });
        problem.model = Arc::new(model(&layout, true, 4));
        problem.background = State::zeros(&layout);
        problem.background_error = white(&layout, 1.5);
        problem.model_error = Some(white(&layout, 0.4));
        let m = layout.len();
        let own = FastKalmanSettings { factors: m, residual, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
        let mut filter = FastKalmanFilter::new(problem.clone(), own).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        let random = &mut stream(3, "truth");
        let mut truth = State::from_values(&layout, covariance::randomize(&*problem.background_error, random));
        let (mut squares, mut count, mut largest) = (0.0, 0, 0.0_f64);
        for cycle in 1..=3000 {
            problem.model.step(&mut truth);
            let error = covariance::randomize(problem.model_error.as_deref().unwrap(), random);
            truth.values_mut().iter_mut().zip(error).for_each(|(value, error)| *value += error);
            // Half of the values, now these and now those.
            let normals = standard_normals(random, m / 2);
            let seen: Vec<(usize, f64, f64)> = (0..m / 2)
                .map(|k| (2 * k + cycle % 2, k))
                .map(|(index, k)| (index, truth.values()[index] + sigma * normals[k], sigma))
                .collect();
            let observed = observations(&problem, &seen);
            let from = filter.forecast(WINDOW).unwrap();
            let found = filter.analyse(&from, &observed).unwrap().estimate;
            let from = reference.forecast(WINDOW).unwrap();
            let expected = reference.analyse(&from, &observed).unwrap().estimate;
            let (spread, right) = (found.state_spread.unwrap(), expected.state_spread.unwrap());
            for index in 0..m {
                largest = largest.max((spread[index] / right[index] - 1.0).abs());
                if cycle > 1000 {
                    squares += ((found.state.values()[index] - truth.values()[index]) / spread[index]).powi(2);
                    count += 1;
                }
            }
        }
        let ratio = squares / f64::from(count);
        println!("{residual:?}, σ = {sigma:e}: {ratio}, spread {largest:e}");
        assert!((ratio - 1.0).abs() < 0.05, "{residual:?}, σ = {sigma:e}: errors over claims, squared: {ratio}");
        assert!(largest < 1e-2, "{residual:?}, σ = {sigma:e}: a spread differs by {largest:e}");
    }
}
