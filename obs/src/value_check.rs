//! What quality control expected of an observation's value.

use serde::{Deserialize, Serialize};

/// How an observation's value compares with what the reference and its neighbours say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ValueCheck {
    /// The predicted value, in the variable's unit.
    pub predicted: f64,
    /// z: value minus prediction, in standard deviations of that difference.
    pub z: f64,
    /// Number of neighbours that the prediction is from; 0 if it is from the reference alone.
    pub neighbours: usize,
}
