//! A filter that has a closed form. Results that others published are those of scenarios, in the tests of the program.

use crate::common::relative_difference;
use isobar_assim::covariance::{Covariance, Sum, Univariate, White};
use isobar_assim::ensemble::EnsembleTransformKalmanFilter;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Problem};
use isobar_model::{Boundary, Duration, ExactShift, Grid, Layout, Location, State, Time, Variable};
use isobar_obs::{Calibration, Jacobian, LinearOperator, ObservationWindow, Report, SparseRows};
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
        most_observations: 0,
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
        times: vec![Time::from_seconds(0); values.len()],
        sigma: vec![sigma; values.len()],
        values,
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
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
        vec![Box::new(Univariate::new(&layout, 0, 0.6, 1.5).unwrap()), Box::new(White::new(&layout, 0, 0.3))]
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
        Box::new(EnsembleTransformKalmanFilter::new(problem, crate::common::ensemble_settings(cells + 1)).unwrap()),
    ];
    for mut method in methods {
        let mut found = [Vec::new(), Vec::new()];
        for _ in 0..60 {
            let from = method.forecast(STEP).unwrap();
            found[0] = from.estimate.state_spread.clone().unwrap();
            found[1] = method.analyse(&from, &observed).unwrap().estimate.state_spread.unwrap();
        }
        for (found, variance) in found.iter().zip([forecast, analysis]) {
            assert!(relative_difference(found, &vec![variance.sqrt(); cells]) < 1e-9);
        }
    }
}
