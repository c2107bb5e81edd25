//! What a checkpoint holds of 4D-Var: the analyses and observations of its window.

use crate::error::Error;
use crate::saved::{Matrix, restore_bias, restore_state, unfit};
use faer::Mat;
use isobar_model::{State, Time};
use isobar_obs::{BlockAngular, LinearOperator, ObservationWindow, Report, SparseRows};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The present estimate, and the window that will slide on.
#[derive(Serialize, Deserialize)]
pub(super) struct Saved {
    pub present: SavedStart,
    pub starts: Vec<SavedStart>,
    pub observed: Vec<SavedWindow>,
}

/// An analysis.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedStart {
    state: Vec<f64>,
    bias: Vec<f64>,
    bias_covariance: Matrix,
}

/// The entries of a sparse row: column and weight.
type Row = Vec<(usize, f64)>;

/// The observations of a cycle. Their operators are linear, so that a Jacobian is all of them.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedWindow {
    seconds: i64,
    cycle: usize,
    reports: Vec<SavedReport>,
    values: Vec<f64>,
    values_bias_removed: Vec<f64>,
    sigma: Vec<f64>,
    state_rows: Vec<Row>,
    calibration_rows: Vec<Row>,
}

#[derive(Serialize, Deserialize)]
struct SavedReport {
    network: String,
    platform: String,
    variable: usize,
    x_m: f64,
    y_m: f64,
    scan: Option<f64>,
}

impl SavedStart {
    pub fn new(state: &State, bias: &[f64], bias_covariance: &Mat<f64>) -> Self {
        Self { state: state.values().to_vec(), bias: bias.to_vec(), bias_covariance: bias_covariance.into() }
    }

    /// Puts back state and calibration, and returns the covariance of `p` parameters.
    pub fn restored(self, state: &mut State, bias: &mut [f64], p: usize) -> Result<Mat<f64>, Error> {
        restore_state(state, &self.state)?;
        restore_bias(bias, &self.bias)?;
        self.bias_covariance.restored(p, Some(p), "the covariance of the calibration")
    }
}

impl SavedWindow {
    /// The operator is linearised about a state, which one that is linear does not depend on.
    pub fn new(window: &ObservationWindow, state: &State, calibration: &[f64]) -> Self {
        let jacobian = window.operator.linearize(state, calibration);
        let rows = |rows: &SparseRows| (0..rows.rows()).map(|row| rows.row(row).to_vec()).collect();
        let report = |report: &Report| SavedReport {
            network: report.network.to_string(),
            platform: report.platform.to_string(),
            variable: report.variable,
            x_m: report.x_m,
            y_m: report.y_m,
            scan: report.scan,
        };
        Self {
            seconds: window.time.seconds(),
            cycle: window.cycle,
            reports: window.reports.iter().map(report).collect(),
            values: window.values.clone(),
            values_bias_removed: window.values_bias_removed.clone(),
            sigma: window.sigma.clone(),
            state_rows: rows(&jacobian.state),
            calibration_rows: rows(&jacobian.calibration),
        }
    }

    /// The window, if its columns and variables are below the numbers of (state values, parameters, variables).
    pub fn restored(self, (values, parameters, variables): (usize, usize, usize)) -> Result<ObservationWindow, Error> {
        let count = self.values.len();
        let lengths = [
            self.values_bias_removed.len(),
            self.sigma.len(),
            self.reports.len(),
            self.state_rows.len(),
            self.calibration_rows.len(),
        ];
        let within = |rows: &[Row], columns: usize| rows.iter().flatten().all(|entry| entry.0 < columns);
        let fits = lengths.iter().all(|&length| length == count)
            && within(&self.state_rows, values)
            && within(&self.calibration_rows, parameters)
            && self.reports.iter().all(|report| report.variable < variables);
        if !fits {
            return Err(unfit("the observations of the assimilation window"));
        }
        let rows = |rows: Vec<Row>| {
            let mut sparse = SparseRows::new();
            rows.into_iter().for_each(|row| sparse.push_row(row));
            sparse
        };
        let report = |it: SavedReport| Report {
            network: it.network.into(),
            platform: it.platform.into(),
            variable: it.variable,
            x_m: it.x_m,
            y_m: it.y_m,
            scan: it.scan,
        };
        let jacobian = BlockAngular { state: rows(self.state_rows), calibration: rows(self.calibration_rows) };
        Ok(ObservationWindow {
            time: Time::from_seconds(self.seconds),
            cycle: self.cycle,
            reports: self.reports.into_iter().map(report).collect(),
            values: self.values,
            values_bias_removed: self.values_bias_removed,
            sigma: self.sigma,
            rejected: Vec::new(),
            operator: Arc::new(LinearOperator { jacobian }),
        })
    }
}
