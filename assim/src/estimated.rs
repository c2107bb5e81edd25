//! What a method estimates beside state and calibration, or finds out about them.

use serde::{Deserialize, Serialize};

/// A number that a method has estimated from the observations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EstimatedParameter {
    /// Its name: `diurnal/cosine`, `transition/mean_depth_m`.
    pub name: String,
    /// Unit, in UDUNITS spelling.
    pub unit: String,
    /// The estimate.
    pub value: f64,
    /// Its claimed standard deviation; `None` while the data do not determine it.
    pub sigma: Option<f64>,
    /// `determined`, or why it is not estimated and what it cannot be distinguished from.
    pub verdict: String,
}

/// A method that estimates such numbers.
pub trait EstimatesParameters {
    /// Those of the last analysis.
    fn estimated_parameters(&self) -> Vec<EstimatedParameter>;
}
