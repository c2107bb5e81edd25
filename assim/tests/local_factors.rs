//! The Fast Kalman Filter with local factors in the limits in which it is exact.

use crate::common::{settings as common_settings, *};
use isobar_assim::covariance::{Covariance, Sum, Univariate, White};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LeftOver, LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::{Assimilator, BiasTreatment, Error, Estimate, Problem, Unknown};
use isobar_model::Boundary;
use std::sync::Arc;

/// Three tiles by two, the factors of each with the whole domain as their support, and as many as there can be.
fn everything() -> LocalFactorSettings {
    LocalFactorSettings {
        blocks: BlockShape::Cell,
        per_tile: 40,
        model_error_per_tile: 40,
        tile_m: 2.0,
        support_tiles: 3,
        mixed: 0,
        left_over: LeftOver::Blocks,
        factor_precision: Precision::Double,
        largest_component: usize::MAX,
        residual: Residual::Persist,
    }
}

/// With all factors, every tile next to every other, and biases that do not drift, nothing is approximated: neither
/// forecast nor analysis. (Of a drift, what two blocks have in common through it is dropped.)
#[test]
fn with_all_factors_it_is_the_kalman_filter() {
    for (shared, local) in [(0, 0), (3, 0), (0, 4), (3, 4)] {
        for within_cell in [true, false] {
            let problem = problem(true, calibration(shared, local, 0.0), 2);
            let mut tiled = LocalFastKalmanFilter::with_local_factors(problem.clone(), everything()).unwrap();
            let mut reference = KalmanFilter::new(problem.clone()).unwrap();
            for cycle in 1..=6 {
                let observed = window(&problem, 14, within_cell, cycle, 5);
                let (background, expected) = (tiled.forecast(WINDOW).unwrap(), reference.forecast(WINDOW).unwrap());
                let spread = |background: &isobar_assim::Background| background.estimate.state_spread.clone().unwrap();
                let error = relative_difference(&spread(&background), &spread(&expected));
                assert!(
                    error < 1e-9,
                    "{shared} shared, {local} local, cycle {cycle}: spread of the background {error:e}"
                );
                let found = tiled.analyse(&background, &observed).unwrap();
                let expected = reference.analyse(&expected, &observed).unwrap();
                let pairs = [
                    (found.estimate.state.values(), expected.estimate.state.values()),
                    (found.estimate.state_spread.as_ref().unwrap(), expected.estimate.state_spread.as_ref().unwrap()),
                    (&found.estimate.calibration, &expected.estimate.calibration),
                ];
                for (what, (found, expected)) in ["state", "spread", "biases"].iter().zip(pairs) {
                    if !expected.is_empty() {
                        let error = relative_difference(found, expected);
                        assert!(error < 1e-9, "{shared} shared, {local} local, cycle {cycle}: {what} {error:e}");
                    }
                }
                assert!((found.innovation_chi2.unwrap() / expected.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
            }
            let unknowns = [Unknown::Value(7)].into_iter().chain((0..shared + local).map(Unknown::Parameter));
            for unknown in unknowns {
                let column =
                    |method: &dyn Assimilator| method.can().joint_errors.unwrap().covariance_column(unknown).unwrap();
                let (found, expected) = (column(&tiled), column(&reference));
                let error = relative_difference(&found.state, &expected.state);
                assert!(error < 1e-8, "{shared} shared, {local} local: covariance with {unknown:?} {error:e}");
            }
        }
    }
}

/// Largest relative difference of states, parameters, and their claims, each by itself.
fn difference(found: &Estimate, expected: &Estimate) -> f64 {
    let spread = |estimate: &Estimate| estimate.state_spread.clone().unwrap();
    let of_calibration = |estimate: &Estimate| estimate.calibration_spread.clone().unwrap_or_default();
    relative_difference(found.state.values(), expected.state.values())
        .max(relative_difference(&spread(found), &spread(expected)))
        .max(relative_difference(&found.calibration, &expected.calibration))
        .max(relative_difference(&of_calibration(found), &of_calibration(expected)))
}

/// The problem with smooth errors, of which a few directions hold most.
fn smooth_problem(shared: usize) -> Problem {
    let problem = problem(true, calibration(shared, 0, 0.0), 2);
    let layout = Arc::clone(problem.background.layout());
    let smooth = |sigma: f64, length: f64| -> Arc<dyn Covariance> {
        let of = |variable| Box::new(Univariate::new(&layout, variable, sigma, length).unwrap()) as Box<dyn Covariance>;
        let white = |variable| Box::new(White::new(&layout, variable, 0.2 * sigma)) as Box<dyn Covariance>;
        Arc::new(Sum::new(layout.len(), vec![of(0), of(1), white(0), white(1)]))
    };
    Problem { background_error: smooth(1.5, 1.2), model_error: Some(smooth(0.4, 0.9)), ..problem }
}

fn local(problem: &Problem, settings: LocalFactorSettings) -> LocalFastKalmanFilter {
    LocalFastKalmanFilter::with_local_factors(problem.clone(), settings).unwrap()
}

/// One tile over the domain, with this number of factors for B and for Q.
fn one_tile(factors: usize) -> LocalFactorSettings {
    let everything = everything();
    LocalFactorSettings { per_tile: factors, model_error_per_tile: factors, tile_m: 100.0, ..everything }
}

/// Cells that are cut out of a component take no part in what an analysis comes to, nor in the covariance of each block after it.
#[test]
fn an_analysis_is_the_same_with_cells_cut_out_of_components() {
    for (shared, tiles) in [(0, everything()), (3, everything()), (3, one_tile(6))] {
        let problem = problem(true, calibration(shared, 4, 0.0), 2);
        let few = LocalFactorSettings { per_tile: 4, model_error_per_tile: 4, ..tiles };
        let first = |largest_component: usize| {
            let mut filter = local(&problem, LocalFactorSettings { largest_component, ..few });
            let from = filter.forecast(WINDOW).unwrap();
            let analysis = filter.analyse(&from, &window(&problem, 30, false, 1, 5)).unwrap();
            let next = filter.forecast(WINDOW).unwrap().estimate;
            (analysis, next)
        };
        let ((merged, next), (cut, next_of_cut)) = (first(usize::MAX), first(8));
        let [whole, parts] = [&merged, &cut].map(|analysis| analysis.partition.clone().unwrap());
        assert!(whole.separators == 0 && whole.largest_component_variables > 16, "{whole:?}");
        assert!(parts.separators > 0 && parts.largest_component_variables <= 8, "{parts:?}");
        let error = difference(&cut.estimate, &merged.estimate);
        assert!(error < 1e-9, "{shared} shared: {error:e}");
        assert!((cut.innovation_chi2.unwrap() / merged.innovation_chi2.unwrap() - 1.0).abs() < 1e-9);
        // What the blocks had in common through the cells that were cut out is dropped, as it is within a component.
        let error = difference(&next_of_cut, &next);
        assert!(error < 0.1, "{shared} shared, the next forecast: {error:e}");
    }
}

/// With all factors, every tile next to every other, there is nothing in the blocks that could be dropped: it is the
/// smoother of Rauch, Tung and Striebel.
#[test]
fn with_all_factors_the_smoother_is_the_dense_one() {
    for shared in [0, 3] {
        for settings in [everything(), one_tile(40)] {
            let problem = problem(true, calibration(shared, 0, 0.0), 2);
            let mut tiled = local(&problem, settings).smoothing(4).unwrap();
            let mut reference = KalmanFilter::new(problem.clone()).unwrap().smoothing(4).unwrap();
            assert_eq!(lag(&tiled), Some(4));
            for number in 1..=6 {
                cycle(&mut tiled, &problem, number);
                cycle(&mut reference, &problem, number);
                for ago in 0..number.min(5) {
                    let error = difference(&smoothed(&tiled, ago).unwrap(), &smoothed(&reference, ago).unwrap());
                    assert!(error < 1e-9, "cycle {number}, {ago} ago, {shared} shared: {error:e}");
                }
                assert!(smoothed(&tiled, 5).is_none());
            }
        }
    }
}

/// With one tile, no more directions than are found exactly, and biases that do not drift, its border is that of the factors of
/// the whole domain in another form: the same filter, and the same smoother, however many directions a compression drops.
#[test]
fn with_one_tile_filter_and_smoother_are_those_of_factors_of_the_whole_domain() {
    for shared in [0, 3] {
        for factors in [30, 34] {
            let problem = smooth_problem(shared);
            let mut tile = local(&problem, one_tile(factors)).smoothing(3).unwrap();
            let whole = FastKalmanSettings {
                factors,
                residual: Residual::Persist,
                ..common_settings(BlockShape::Cell, BiasCoupling::Carry)
            };
            let mut whole = FastKalmanFilter::new(problem.clone(), whole).unwrap().smoothing(3).unwrap();
            let mut reference = KalmanFilter::new(problem.clone()).unwrap().smoothing(3).unwrap();
            for number in 1..=6 {
                let (found, expected) = (cycle(&mut tile, &problem, number), cycle(&mut whole, &problem, number));
                let error = difference(&found, &expected);
                assert!(error < 1e-7, "{factors} factors, {shared} shared, cycle {number}: {error:e}");
                let dense = cycle(&mut reference, &problem, number);
                assert!(number < 3 || difference(&dense, &expected) > 1e-4, "nothing is dropped");
                for ago in 1..number.min(4) {
                    let error = difference(&smoothed(&tile, ago).unwrap(), &smoothed(&whole, ago).unwrap());
                    assert!(error < 1e-7, "{factors} factors, {shared} shared, cycle {number}, {ago} ago: {error:e}");
                }
            }
        }
    }
}

/// Mixing changes claims at random, but they stay those of a covariance; and a smoother changes nothing in the filter.
#[test]
fn a_smoother_follows_what_is_mixed_and_cut_off() {
    let problem = Problem { calibration: calibration(2, 1, 0.7), ..smooth_problem(0) };
    for (mixed, residual) in [(0, Residual::Persist), (2, Residual::Probe { count: 3 })] {
        let settings = LocalFactorSettings { per_tile: 5, mixed, residual, ..tile_settings() };
        let (mut plain, mut smoother) = (local(&problem, settings), local(&problem, settings).smoothing(3).unwrap());
        let mut filtered = Vec::new();
        for number in 1..=6 {
            let analysis = cycle(&mut plain, &problem, number);
            assert_eq!(cycle(&mut smoother, &problem, number), analysis);
            filtered.push(analysis);
            for ago in 0..number.min(4) {
                let found = smoothed(&smoother, ago).unwrap();
                let own = &filtered[number - 1 - ago];
                let spread = |estimate: &Estimate| estimate.state_spread.clone().unwrap();
                let mean = |spread: Vec<f64>| spread.iter().map(|it| it * it).sum::<f64>();
                let revised = relative_difference(found.state.values(), own.state.values());
                assert_eq!(
                    revised > 1e-3,
                    ago > 0 && (number != 3 || ago > 1),
                    "cycle {number}, {ago} ago: {revised:e}"
                );
                if ago > 0 {
                    // Without new observations nothing is revised, but random sums have the squares of their terms only on average.
                    let at_most = if mixed > 0 && revised <= 1e-3 { 1.001 } else { 1.000_001 };
                    let ratio = mean(spread(&found)) / mean(spread(own));
                    assert!(ratio < at_most, "cycle {number}, {ago} ago: {ratio}");
                }
            }
        }
    }
    let small = Problem { memory_limit_bytes: 100_000, ..problem };
    let settings = LocalFactorSettings { per_tile: 5, mixed: 0, residual: Residual::Persist, ..tile_settings() };
    assert!(matches!(local(&small, settings).smoothing(30), Err(Error::TooLarge { .. })));
}

/// All factors in single precision: the Kalman filter but for 2⁻²⁴ of a factor wherever it is written.
#[test]
fn in_single_precision_it_is_the_kalman_filter_to_that_precision() {
    for (shared, local_parameters) in [(0, 0), (3, 4)] {
        let problem = problem(true, calibration(shared, local_parameters, 0.0), 2);
        let settings = LocalFactorSettings { factor_precision: Precision::Single, ..everything() };
        let mut single = local(&problem, settings).smoothing(2).unwrap();
        let mut double = local(&problem, everything()).smoothing(2).unwrap();
        let mut reference = KalmanFilter::new(problem.clone()).unwrap();
        let mut apart: f64 = 0.0;
        for number in 1..=6 {
            let found = cycle(&mut single, &problem, number);
            let error = difference(&found, &cycle(&mut reference, &problem, number));
            assert!(error < 2e-6, "cycle {number}: {error:e}");
            apart = apart.max(difference(&found, &cycle(&mut double, &problem, number)));
            for ago in 1..number.min(3) {
                let error = difference(&smoothed(&single, ago).unwrap(), &smoothed(&double, ago).unwrap());
                assert!(error < 2e-6, "cycle {number}, {ago} ago: {error:e}");
            }
        }
        assert!(apart > 1e-9, "nothing is rounded");
        let [of_single, of_double] = [&single, &double].map(|filter| filter.memory().unwrap().len());
        assert!((of_single as f64) < 0.6 * of_double as f64, "{of_single} {of_double}");
        assert!(double.recall(&mut &single.memory().unwrap()[..]).is_err());
    }
}

/// On the same grid it is the same filter; with one tile it is that of factors of the whole domain on a coarser grid.
#[test]
fn packed_factors_may_be_propagated_on_a_coarser_grid() {
    let model = |cells: usize, step_s: i64| jet(cells, step_s, Boundary::Periodic, 0.0, 0.0);
    let (fine, background) = model(16, 900);
    let layout = background.layout().clone();
    let problem: Problem = Problem {
        model: fine,
        background_error: Arc::new(balanced(&layout, 20.0, 9e5, 0.0)),
        model_error: Some(Arc::new(balanced(&layout, 3.0, 8e5, 0.0))),
        background,
        calibration: calibration(1, 0, 0.0),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    let settings = |tile_m: f64, residual| LocalFactorSettings {
        per_tile: 30,
        model_error_per_tile: 30,
        tile_m,
        support_tiles: 2,
        residual,
        ..everything()
    };
    let run = |method: &mut dyn Assimilator| {
        method.forecast(WINDOW).unwrap();
        method.forecast(WINDOW).unwrap().estimate
    };
    let tiles = || local(&problem, settings(24e5, Residual::Probe { count: 2 }));
    let (same, expected) = (run(&mut tiles().with_factors_on(problem.model.clone()).unwrap()), run(&mut tiles()));
    assert!(difference(&same, &expected) < 1e-9, "{:e}", difference(&same, &expected));
    let coarse = || model(8, 1800).0;
    let found = run(&mut local(&problem, settings(48e5, Residual::Persist)).with_factors_on(coarse()).unwrap());
    let whole = FastKalmanSettings {
        factors: 30,
        residual: Residual::Persist,
        ..common_settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    let mut whole = FastKalmanFilter::new(problem.clone(), whole).unwrap().with_factors_on(coarse()).unwrap();
    let expected = run(&mut whole);
    assert!(difference(&found, &expected) < 1e-6, "{:e}", difference(&found, &expected));
    let fine = run(&mut local(&problem, settings(48e5, Residual::Persist)));
    assert!(difference(&fine, &expected) > 1e-4, "the grid makes no difference");
    let other = local(&problem, settings(48e5, Residual::Persist)).with_factors_on(model(5, 1800).0);
    assert!(other.is_err());
}
