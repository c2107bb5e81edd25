//! The Jacobian of observations: few grid values X and few calibration parameters G in each row.

use crate::sparse::SparseRows;
use serde::{Deserialize, Serialize};

/// δy = X δx + G δc: the linearised observation operator. Each row touches few values of the state, which makes the
/// system of all observations block-angular: blocks of the state, bordered by the calibration parameters they share.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Jacobian {
    /// X: derivatives with respect to the state, `[observation, variable-y-x index]`.
    pub state: SparseRows,
    /// G: derivatives with respect to the calibration, `[observation, parameter]`.
    pub calibration: SparseRows,
}

impl Jacobian {
    /// Number of observations.
    pub fn rows(&self) -> usize {
        self.state.rows()
    }

    /// X δx + G δc.
    pub fn apply(&self, dx: &[f64], dc: &[f64]) -> Vec<f64> {
        let mut dy = vec![0.0; self.rows()];
        self.state.multiply_add(dx, &mut dy);
        self.calibration.multiply_add(dc, &mut dy);
        dy
    }

    /// dx += Xᵀ dy and dc += Gᵀ dy.
    pub fn apply_ad(&self, dy: &[f64], dx: &mut [f64], dc: &mut [f64]) {
        self.state.transpose_multiply_add(dy, dx);
        self.calibration.transpose_multiply_add(dy, dc);
    }
}
