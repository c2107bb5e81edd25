//! Results that others published or that have a closed form.

mod common;

use common::relative_difference;
use faer::{Mat, Side};
use isobar_assim::covariance::{Covariance, LocalizedEnsemble, Sum, Univariate, White};
use isobar_assim::ensemble::EnsembleTransformKalmanFilter;
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::variational::{ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, BiasTreatment, Problem};
use isobar_model::{Boundary, Duration, ExactShift, Grid, Layout, Location, State, Time, Variable};
use isobar_obs::{BlockAngular, Calibration, LinearOperator, ObservationWindow, Report, SparseRows};
use std::f64::consts::PI;
use std::sync::Arc;

const STEP: Duration = Duration::from_seconds(3600);

/// A periodic plane with one variable.
fn layout(nx: usize, ny: usize) -> Arc<Layout> {
    let grid = Grid { nx, ny, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
    let variable =
        Variable { name: "tracer", long_name: "tracer", standard_name: None, unit: "1", location: Location::Center };
    Arc::new(Layout { grid, variables: vec![variable] })
}

/// The problem of a field that moves by columns and rows each hour, without error.
fn moving(layout: &Arc<Layout>, columns: i64, rows: i64, background: State, error: Arc<dyn Covariance>) -> Problem {
    Problem {
        model: Arc::new(ExactShift::new(layout.grid.clone(), columns, rows, STEP).unwrap()),
        background,
        background_error: error,
        model_error: None,
        calibration: Calibration::default(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
    }
}

/// Observations of single values: (index, value).
fn observe(observations: &[(usize, f64)], sigma: f64) -> ObservationWindow {
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for &(index, _) in observations {
        state.push_row([(index, 1.0)]);
        calibration.push_row([]);
    }
    let values: Vec<f64> = observations.iter().map(|observation| observation.1).collect();
    let report = Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
    ObservationWindow {
        time: Time::from_seconds(0),
        cycle: 1,
        reports: vec![report; values.len()],
        values_bias_removed: values.clone(),
        sigma: vec![sigma; values.len()],
        values,
        rejected: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: BlockAngular { state, calibration } }),
    }
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / count as f64).sqrt()
}

fn factors(factors: usize) -> FastKalmanSettings {
    FastKalmanSettings {
        factors,
        residual: Residual::Persist,
        ..common::settings(BlockShape::Cell, BiasCoupling::Carry)
    }
}

/// The 2-D tutorial of PDAF ("online 2D"; <https://pdaf.awi.de>): 18 × 36 points, each step shifts by one row; 28 points
/// are observed every second step. Root-mean-square errors and spreads at steps 2, 4, 6 and 8 as its Kalman filter and its
/// 3D-Var have them; the covariance of its nine first members has rank two.
mod pdaf {
    use super::*;

    const ROWS: usize = 18;
    const COLUMNS: usize = 36;

    /// Background and analysis error, background and analysis spread of the Kalman filter; analysis error of 3D-Var.
    const SCORES: [[f64; 5]; 4] = [
        [1.1427980925, 0.2222098802, 0.5763665074, 0.1274504710, 0.1895037147],
        [0.2222098802, 0.1597772911, 0.1274504710, 0.0921794277, 0.1091882222],
        [0.1597772911, 0.1174993870, 0.0921794277, 0.0758717192, 0.1261198146],
        [0.1174993870, 0.0447735125, 0.0758717192, 0.0659772996, 0.1738813328],
    ];

    fn wave(phase: f64) -> Vec<f64> {
        let value = |row: usize, column: usize| {
            (2.0 * PI * (row as f64 / ROWS as f64 + column as f64 / COLUMNS as f64) + phase).sin()
        };
        (1..=ROWS).flat_map(|row| (1..=COLUMNS).map(move |column| value(row, column))).collect()
    }

    fn problem() -> Problem {
        let layout = layout(COLUMNS, ROWS);
        let members: Vec<Vec<f64>> = (1..=9).map(|k| wave(PI * (k as f64 + 5.0) / 9.0)).collect();
        let mean: Vec<f64> =
            (0..layout.len()).map(|i| members.iter().map(|member| member[i]).sum::<f64>() / 9.0).collect();
        let perturbations = Mat::from_fn(layout.len(), 9, |i, j| members[j][i] - mean[i]);
        let covariance = LocalizedEnsemble::new(&layout, &perturbations, f64::INFINITY);
        moving(&layout, 0, 1, State::from_values(&layout, mean), Arc::new(covariance))
    }

    /// The observations of a step.
    fn observations(step: usize) -> ObservationWindow {
        let rows = include_str!("data/pdaf_2d_observations.csv").lines().skip(1).map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            let whole = |i: usize| fields[i].parse::<usize>().unwrap();
            (whole(0), (whole(1) - 1) * COLUMNS + whole(2) - 1, fields[3].parse::<f64>().unwrap())
        });
        let own: Vec<(usize, f64)> = rows.filter(|row| row.0 == step).map(|row| (row.1, row.2)).collect();
        assert_eq!(own.len(), 28);
        observe(&own, 0.5)
    }

    /// The columns of the table that a method has.
    fn check(method: &mut dyn Assimilator, background_error: usize, columns: [Option<usize>; 3]) {
        for (number, scores) in SCORES.iter().enumerate() {
            let step = 2 * (number + 1);
            // The field has moved north by `step` rows.
            let now = wave(-2.0 * PI * step as f64 / ROWS as f64);
            let error = |state: &State| root_mean_square(state.values().iter().zip(&now).map(|(a, b)| a - b));
            let background = method.forecast(Duration::from_seconds(2 * STEP.seconds())).unwrap();
            let analysis = method.analyse(&observations(step)).unwrap().estimate;
            let spread = |spread: &Option<Vec<f64>>| {
                spread.as_ref().map_or(f64::NAN, |spread| root_mean_square(spread.iter().copied()))
            };
            let found = [error(&analysis.state), spread(&background.state_spread), spread(&analysis.state_spread)];
            if background_error < 5 {
                let (found, expected) = (error(&background.state), scores[background_error]);
                assert!((found - expected).abs() < 1e-9, "step {step}: {found}, not {expected}");
            }
            for (found, expected) in found.into_iter().zip(columns) {
                if let Some(expected) = expected {
                    let expected = scores[expected];
                    assert!((found - expected).abs() < 1e-9, "step {step}: {found}, not {expected}");
                }
            }
        }
    }

    #[test]
    fn kalman_filters_reproduce_it() {
        let all = [Some(1), Some(2), Some(3)];
        check(&mut KalmanFilter::new(problem()).unwrap(), 0, all);
        check(&mut FastKalmanFilter::new(problem(), factors(2)).unwrap(), 0, all);
        check(&mut EnsembleTransformKalmanFilter::new(problem(), common::ensemble_settings(3)).unwrap(), 0, all);
    }

    #[test]
    fn static_covariances_reproduce_it() {
        let settings = ThreeDVarSettings { covariance_scale: 1.0, tolerance: 1e-13, max_iterations: 500 };
        check(&mut ThreeDVar::new(problem(), settings), usize::MAX, [Some(4), None, None]);
        check(&mut OptimalInterpolation::new(problem(), 1.0), usize::MAX, [Some(4), None, None]);
    }
}

/// A covariance given as a matrix.
struct Dense {
    /// Its symmetric root.
    root: Mat<f64>,
}

impl Dense {
    fn new(size: usize, entry: impl Fn(usize, usize) -> f64) -> Self {
        let eigen = Mat::from_fn(size, size, entry).self_adjoint_eigen(Side::Lower).unwrap();
        let scaled = Mat::from_fn(size, size, |i, j| {
            assert!(eigen.S()[j] > 0.0, "the formula must be positive definite");
            eigen.U()[(i, j)] * eigen.S()[j].sqrt()
        });
        Self { root: &scaled * eigen.U().transpose() }
    }
}

impl Covariance for Dense {
    fn len(&self) -> usize {
        self.root.nrows()
    }
    fn control_len(&self) -> usize {
        self.root.nrows()
    }
    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        for (j, control) in control.iter().enumerate() {
            let column = self.root.col_as_slice(j);
            increment.iter_mut().zip(column).for_each(|(value, entry)| *value += entry * control);
        }
    }
    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        self.root_add(increment, control);
    }
}

/// DAPPER's `LA/small` (<https://github.com/nansencenter/DAPPER>): 100 points on a ring that move by one point each step,
/// without error; four are observed every five steps. The covariances do not depend on the data.
#[test]
fn linear_advection_has_the_spread_of_dapper() {
    const FORECAST: [f64; 5] = [1.0, 0.556651770483, 0.250783941054, 0.136383112529, 0.088745978029];
    const ANALYSIS: [f64; 5] = [0.556651770483, 0.250783941054, 0.136383112529, 0.088745978029, 0.074622938178];
    let layout = layout(100, 1);
    let scale = 2.0 / PI.sqrt() * 12.5;
    let prior = Dense::new(100, |i, j| {
        let distance = i.abs_diff(j).min(100 - i.abs_diff(j)) as f64;
        (1.0 - 1e-5) * (-(distance / scale).powi(2)).exp() + if i == j { 1e-5 } else { 0.0 }
    });
    let problem = moving(&layout, 1, 0, State::zeros(&layout), Arc::new(prior));
    let observed = observe(&[0, 25, 50, 75].map(|index| (index, 0.0)), 0.1);
    let mut methods: [Box<dyn Assimilator>; 3] = [
        Box::new(KalmanFilter::new(problem.clone()).unwrap()),
        Box::new(EnsembleTransformKalmanFilter::new(problem.clone(), common::ensemble_settings(101)).unwrap()),
        Box::new(FastKalmanFilter::new(problem, factors(100)).unwrap()),
    ];
    for method in &mut methods {
        for (forecast, analysis) in FORECAST.into_iter().zip(ANALYSIS) {
            let spread = |spread: Option<Vec<f64>>| root_mean_square(spread.unwrap().into_iter());
            let found = spread(method.forecast(Duration::from_seconds(5 * STEP.seconds())).unwrap().state_spread);
            assert!((found - forecast).abs() < 1e-9, "{found}, not {forecast}");
            let found = spread(method.analyse(&observed).unwrap().estimate.state_spread);
            assert!((found - analysis).abs() < 1e-9, "{found}, not {analysis}");
        }
    }
}

/// With every point of a periodic plane observed the Kalman filter is one scalar Riccati equation for each wavenumber
/// (Daley and Ménard 1993). The shift has |m| = 1: `p_f = [q + √(q² + 4 q r)]/2`, `p_a = p_f r/(p_f + r)`.
#[test]
fn a_fully_observed_plane_decouples_into_wavenumbers() {
    let (nx, ny, r) = (8, 6, 0.49_f64);
    let layout = layout(nx, ny);
    let cells = nx * ny;
    let terms = || -> Vec<Box<dyn Covariance>> {
        vec![Box::new(Univariate::new(&layout, 0, 0.6, 1.5)), Box::new(White::new(&layout, 0, 0.3))]
    };
    let model_error: Arc<dyn Covariance> = Arc::new(Sum::new(cells, terms()));
    // The spectrum of Q: the transform of its first row.
    let row = isobar_assim::covariance::block(&*model_error, &(0..cells).collect::<Vec<_>>());
    let spectrum = |k: usize, l: usize| -> f64 {
        let phase = |i: usize, j: usize| 2.0 * PI * ((k * i) as f64 / nx as f64 + (l * j) as f64 / ny as f64);
        (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j))).map(|(i, j)| row[(0, j * nx + i)] * phase(i, j).cos()).sum()
    };
    let (mut forecast, mut analysis) = (0.0, 0.0);
    for (k, l) in (0..ny).flat_map(|l| (0..nx).map(move |k| (k, l))) {
        let q = spectrum(k, l);
        let p = 0.5 * (q + (q * q + 4.0 * q * r).sqrt());
        forecast += p / cells as f64;
        analysis += p * r / (p + r) / cells as f64;
    }
    let background = Arc::new(Sum::new(cells, terms()));
    let problem =
        Problem { model_error: Some(model_error), ..moving(&layout, 3, 1, State::zeros(&layout), background) };
    let observed = observe(&(0..cells).map(|index| (index, 0.0)).collect::<Vec<_>>(), r.sqrt());
    let methods: [Box<dyn Assimilator>; 2] = [
        Box::new(KalmanFilter::new(problem.clone()).unwrap()),
        Box::new(EnsembleTransformKalmanFilter::new(problem, common::ensemble_settings(cells + 1)).unwrap()),
    ];
    for mut method in methods {
        let mut found = [Vec::new(), Vec::new()];
        for _ in 0..60 {
            found[0] = method.forecast(STEP).unwrap().state_spread.unwrap();
            found[1] = method.analyse(&observed).unwrap().estimate.state_spread.unwrap();
        }
        for (found, variance) in found.iter().zip([forecast, analysis]) {
            assert!(relative_difference(found, &vec![variance.sqrt(); cells]) < 1e-9);
        }
    }
}
