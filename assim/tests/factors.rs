//! Common factors: their exact limits, and what a compression must preserve.

use crate::common::*;
use faer::{Mat, Side};
use isobar_assim::covariance::{self, Covariance, Sum, Univariate, White, leading_factors};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Problem};
use isobar_model::random::stream;
use isobar_model::{Boundary, Grid, shallow_water};
use std::sync::Arc;

fn filter(problem: &Problem, blocks: BlockShape, factors: usize, residual: Residual) -> FastKalmanFilter {
    let settings = FastKalmanSettings { factors, residual, ..settings(blocks, BiasCoupling::Carry) };
    FastKalmanFilter::new(problem.clone(), settings).unwrap()
}

/// Largest relative difference of covariances and estimates from the Kalman filter's over some cycles.
fn difference(problem: &Problem, mut fast: FastKalmanFilter) -> f64 {
    let mut reference = KalmanFilter::new(problem.clone()).unwrap();
    let mut largest: f64 = 0.0;
    for cycle in 1..=6 {
        let observed = window(problem, 14, false, cycle, 5);
        let from_fast = fast.forecast(WINDOW).unwrap();
        let from_reference = reference.forecast(WINDOW).unwrap();
        let forecast = relative_difference(&flat(&fast.dense_covariance()), &flat(&reference.covariance().to_owned()));
        let (analysis, expected) =
            (fast.analyse(&from_fast, &observed).unwrap(), reference.analyse(&from_reference, &observed).unwrap());
        let covariance =
            relative_difference(&flat(&fast.dense_covariance()), &flat(&reference.covariance().to_owned()));
        let state = relative_difference(analysis.estimate.state.values(), expected.estimate.state.values());
        largest = largest.max(forecast).max(covariance).max(state);
    }
    largest
}

#[test]
fn as_many_factors_as_variables_are_the_kalman_filter() {
    for (shared, local) in [(0, 0), (2, 0), (2, 3)] {
        let problem = problem(true, calibration(shared, local, 0.4), 2);
        let variables = problem.background.values().len() + local;
        for residual in [Residual::Exact, Residual::Persist] {
            let found = difference(&problem, filter(&problem, BlockShape::Cell, variables, residual));
            // The local biases' prior is in the blocks, where it persists in either case.
            assert!(found < 1e-8, "{shared} shared, {local} local, {residual:?}: {found:e}");
        }
    }
}

#[test]
fn one_block_with_any_factors_is_the_kalman_filter() {
    let problem = problem(true, calibration(2, 2, 0.4), 2);
    for factors in [1, 7, 30] {
        let found = difference(&problem, filter(&problem, BlockShape::Domain, factors, Residual::Exact));
        assert!(found < 1e-8, "{factors} factors: {found:e}");
    }
}

#[test]
fn more_factors_come_nearer_to_the_kalman_filter() {
    // Errors with something in common: of white ones no direction comes before another.
    let mut problem = problem(true, calibration(2, 0, 0.4), 2);
    let layout = problem.background.layout().clone();
    let smooth = |sigma: f64| -> Arc<dyn Covariance> {
        let of = |variable| Univariate::new(&layout, variable, sigma, 0.7 + 0.2 * variable as f64).unwrap();
        let terms: Vec<Box<dyn Covariance>> = vec![Box::new(of(0)), Box::new(of(1))];
        Arc::new(Sum::new(layout.len(), terms))
    };
    (problem.background_error, problem.model_error) = (smooth(1.5), Some(smooth(0.4)));
    let found: Vec<f64> = [0, 10, 20, 30, 40]
        .iter()
        .map(|&factors| difference(&problem, filter(&problem, BlockShape::Cell, factors, Residual::Exact)))
        .collect();
    assert!(found.windows(2).all(|pair| pair[1] < pair[0]), "{found:?}");
}

#[test]
fn the_more_energy_is_retained_the_nearer_to_the_kalman_filter() {
    let problem = problem(true, calibration(2, 0, 0.4), 2);
    let found: Vec<f64> = [0.5, 0.7, 0.8, 0.95, 1.0]
        .iter()
        .map(|&retained_energy| {
            let settings =
                FastKalmanSettings { factors: 40, retained_energy, ..settings(BlockShape::Cell, BiasCoupling::Carry) };
            difference(&problem, FastKalmanFilter::new(problem.clone(), settings).unwrap())
        })
        .collect();
    assert!(found.windows(2).all(|pair| pair[1] < pair[0]) && found[4] < 1e-8, "{found:?}");
}

#[test]
fn a_forecast_keeps_the_covariance_of_every_block() {
    // With the exact forecast of the blocks, compression moves covariance from the factors to the block diagonal: within
    // a block nothing may change from A P A' + Q, P being what the filter believed before.
    let problem = problem(true, calibration(0, 0, 0.0), 6);
    let m = problem.background.values().len();
    let mut propagator: Vec<f64> = (0..m * m).map(|index| f64::from(index % (m + 1) == 0)).collect();
    problem.model.step_tl(&problem.background, &mut propagator);
    let a = Mat::from_fn(m, m, |i, j| propagator[j * m + i]);
    let q = covariance::dense(problem.model_error.as_deref().unwrap());
    for factors in [0, 3, 12] {
        let mut fast = filter(&problem, BlockShape::Cell, factors, Residual::Exact);
        for _ in 0..3 {
            let expected = &a * fast.dense_covariance() * a.transpose() + &q;
            fast.forecast(WINDOW).unwrap();
            let found = fast.dense_covariance();
            let cells = problem.background.layout().grid.cells();
            for cell in 0..cells {
                for (i, j) in [(cell, cell), (cell, cell + cells), (cell + cells, cell + cells)] {
                    let (found, expected) = (found[(i, j)], expected[(i, j)]);
                    assert!((found - expected).abs() < 1e-10, "{factors} factors, ({i}, {j}): {found} {expected}");
                }
            }
        }
    }
}

#[test]
fn leading_factors_are_below_the_covariance_and_hold_its_energy() {
    let grid = Grid { nx: 10, ny: 8, dx_m: 2e5, dy_m: 2e5, boundary: Boundary::Channel };
    let layout = shallow_water::layout(grid);
    let operator = Sum::new(
        layout.len(),
        vec![Box::new(balanced(&layout, 20.0, 6e5, 1.6e-11)), Box::new(White::new(&layout, 0, 2.0))],
    );
    let m = layout.len();
    // The energy norm matters: the wind is small in its unit.
    let scales: Vec<f64> = (0..m).map(|index| if index < m / 3 { 20.0 } else { 2.0 }).collect();
    let full = covariance::dense(&operator);
    let scaled = Mat::from_fn(m, m, |i, j| full[(i, j)] / scales[i] / scales[j]);
    let mut eigenvalues: Vec<f64> = scaled.self_adjoint_eigenvalues(Side::Lower).unwrap();
    eigenvalues.reverse();
    for rank in [5, 20, 60] {
        let factors = leading_factors(&operator, &scales, rank, &mut stream(1, "factors"));
        assert_eq!((factors.nrows(), factors.ncols()), (m, rank));
        let rest = &full - &factors * factors.transpose();
        let least = rest.self_adjoint_eigenvalues(Side::Lower).unwrap()[0];
        assert!(least > -1e-9 * full.norm_max(), "rank {rank}: the rest has an eigenvalue {least:e}");
        let energy: f64 = (0..m).map(|i| (0..rank).map(|j| (factors[(i, j)] / scales[i]).powi(2)).sum::<f64>()).sum();
        // A pair of equal eigenvalues that the rank would cut, such as cosine and sine along the channel, is left out.
        let weight = |value: f64| ((value / eigenvalues[rank] - 1.0) / 0.01).clamp(0.0, 1.0);
        let best: f64 = eigenvalues[..rank].iter().map(|&value| value * weight(value).powi(2)).sum();
        let most: f64 = eigenvalues[..rank].iter().sum();
        assert!(energy <= most * (1.0 + 1e-9) && energy > 0.99 * best, "rank {rank}: {energy} of {best}");
    }
}

#[test]
fn the_factor_settings_that_make_no_sense_are_refused() {
    let problem = problem(true, calibration(1, 0, 0.0), 2);
    let mut settings = FastKalmanSettings {
        factors: 41,
        residual: Residual::Probe { count: 4 },
        ..settings(BlockShape::Cell, BiasCoupling::Carry)
    };
    let error = |settings| FastKalmanFilter::new(problem.clone(), settings).err().unwrap().to_string();
    assert_eq!(error(settings), "41 common factors are more than the 40 variables they describe");
    (settings.factors, settings.bias_coupling) = (3, BiasCoupling::Drop);
    assert!(error(settings).contains("have no factors"));
    settings.factors = 0;
    assert!(error(settings).contains("forecast the blocks exactly"));
}

#[test]
fn factors_on_the_same_grid_are_those_without_another() {
    let problem = problem(true, calibration(2, 3, 0.4), 2);
    let residual = Residual::Probe { count: 3 };
    let mut plain = filter(&problem, BlockShape::Cell, 12, residual);
    let mut other = filter(&problem, BlockShape::Cell, 12, residual).with_factors_on(problem.model.clone()).unwrap();
    for cycle in 1..=4 {
        let observed = window(&problem, 14, false, cycle, 5);
        let [expected, found] = [&mut plain, &mut other].map(|filter| {
            let from_filter = filter.forecast(WINDOW).unwrap();
            filter.analyse(&from_filter, &observed).unwrap().estimate
        });
        assert!(relative_difference(found.state.values(), expected.state.values()) < 1e-12);
        assert!(relative_difference(&flat(&other.dense_covariance()), &flat(&plain.dense_covariance())) < 1e-12);
    }
    let exact = filter(&problem, BlockShape::Cell, 12, Residual::Exact);
    assert!(exact.with_factors_on(problem.model.clone()).is_err());
}

#[test]
fn factors_of_smooth_errors_need_no_fine_grid() {
    let model = |cells: usize, step_s: i64| jet(cells, step_s, Boundary::Periodic, 0.0, 0.0);
    let (fine, background) = model(32, 600);
    let layout = background.layout().clone();
    let problem: Problem = Problem {
        model: fine,
        background_error: Arc::new(balanced(&layout, 20.0, 9e5, 0.0)),
        model_error: None,
        background,
        calibration: calibration(1, 0, 0.0),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    let spread = |filter: FastKalmanFilter| {
        let mut filter = filter;
        filter.forecast(WINDOW).unwrap().estimate.state_spread.unwrap()
    };
    let plain = || filter(&problem, BlockShape::Cell, 30, Residual::Probe { count: 2 });
    let expected = spread(plain());
    for (cells, step, most) in [(16, 1200, 0.04), (8, 2400, 0.16)] {
        let found = spread(plain().with_factors_on(model(cells, step).0).unwrap());
        let difference = relative_difference(&found[..1024], &expected[..1024]);
        let [of_found, of_expected] =
            [&found, &expected].map(|spread| (spread.iter().map(|value| value * value).sum::<f64>()).sqrt());
        println!("{cells} cells: {difference:e} at most, {of_found} {of_expected}");
        assert!(difference < most && (of_found / of_expected - 1.0).abs() < 0.5 * most, "{cells} cells: {difference}");
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let problem = problem(true, calibration(2, 3, 0.2), 8);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut fast = filter(&problem, BlockShape::Tile { nx: 2, ny: 2 }, 9, Residual::Probe { count: 5 });
            let mut bits = Vec::new();
            for cycle in 1..=5 {
                let from_fast = fast.forecast(WINDOW).unwrap();
                let analysis = fast.analyse(&from_fast, &window(&problem, 14, false, cycle, 6)).unwrap();
                bits.extend(analysis.estimate.state.values().iter().map(|value| value.to_bits()));
                bits.extend(analysis.estimate.state_spread.unwrap().iter().map(|value| value.to_bits()));
            }
            bits
        })
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(8));
}

#[test]
fn a_singular_model_error_and_a_perfect_model_are_no_obstacle() {
    for model_error in [None, Some(Sum::new(40, Vec::new()))] {
        let mut problem = problem(true, calibration(1, 1, 0.0), 2);
        problem.model_error = model_error.map(|sum| std::sync::Arc::new(sum) as std::sync::Arc<dyn Covariance>);
        let found = difference(&problem, filter(&problem, BlockShape::Cell, 41, Residual::Exact));
        assert!(found < 1e-7, "{found:e}");
    }
}
