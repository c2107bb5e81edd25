//! The inner structure of a method with blocks, for viewers.

use isobar_model::Increment;
use isobar_obs::ObservationWindow;
use serde::{Deserialize, Serialize};

/// The covariance `blkdiag(C_1 … C_K, 0) + Φ Φᵀ` of a method with blocks, as it is after an analysis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Structure {
    /// The part of the block diagonal to which each cell belongs, `[y, x]`: a block, or those that observations merged.
    pub part_of_cell: Vec<usize>,
    /// Whether an observation touches each part.
    pub observed: Vec<bool>,
    /// The leading common factors, by descending share.
    pub factors: Vec<CommonFactor>,
}

/// A common factor: a direction in which the errors of all blocks and of the biases go together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommonFactor {
    /// One standard deviation of the factor as a change of the state.
    pub increment: Increment,
    /// The change of the calibration parameters that goes with it, in their order.
    pub calibration: Vec<f64>,
    /// Its share of the claimed variance of all values, where each is first divided by its variance in B \[1\].
    pub share: f64,
}

/// A method with blocks.
pub trait BlockStructure {
    /// Its structure after the analysis of `observed`, with at most `factors` common factors.
    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Structure;
}
