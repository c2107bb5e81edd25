//! What a checkpoint holds of 4D-Var: the analyses and observations of its window.

use super::convergence::Convergence;
use crate::calibrated_state::SavedCalibratedState;
use crate::error::Error;
use crate::saved::unfit;
use isobar_model::{State, Time};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, Report, SparseRows};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The present estimate, and the window that will slide on.
#[derive(Serialize, Deserialize)]
pub(super) struct Saved {
    pub present: SavedCalibratedState,
    pub starts: Vec<SavedCalibratedState>,
    pub observed: Vec<SavedWindow>,
    pub convergence: Convergence,
}

/// The entries of a sparse row: column and weight.
type Row = Vec<(usize, f64)>;

/// The observations of a cycle. Their operators are linear, so that a Jacobian is all of them.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedWindow {
    seconds: i64,
    cycle: usize,
    reports: Vec<Report>,
    values: Vec<f64>,
    values_bias_removed: Vec<f64>,
    sigma: Vec<f64>,
    state_rows: Vec<Row>,
    calibration_rows: Vec<Row>,
}

impl SavedWindow {
    /// The operator is linearised about a state, which one that is linear does not depend on.
    pub fn new(window: &ObservationWindow, state: &State, calibration: &[f64]) -> Self {
        let jacobian = window.operator.linearize(state, calibration);
        let rows = |rows: &SparseRows| (0..rows.rows()).map(|row| rows.row(row).to_vec()).collect();
        Self {
            seconds: window.time.seconds(),
            cycle: window.cycle,
            reports: window.reports.clone(),
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
        let jacobian = Jacobian { state: rows(self.state_rows), calibration: rows(self.calibration_rows) };
        Ok(ObservationWindow {
            time: Time::from_seconds(self.seconds),
            cycle: self.cycle,
            reports: self.reports,
            values: self.values,
            values_bias_removed: self.values_bias_removed,
            sigma: self.sigma,
            rejected: Vec::new(),
            operator: Arc::new(LinearOperator { jacobian }),
        })
    }
}
