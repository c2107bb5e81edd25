//! What is known of an observation beside its value.

use isobar_model::Layout;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is known of one observation beside its value: where, what and by whom.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Name of the network or satellite.
    pub network: Arc<str>,
    /// Name of the station, or of the footprint's place in the swath.
    pub platform: Arc<str>,
    /// Number of the observed variable in the state's layout.
    pub variable: usize,
    /// x of the station or footprint centre \[m\].
    pub x_m: f64,
    /// y of the station or footprint centre \[m\].
    pub y_m: f64,
    /// Scan position in [-1, 1], for scanning instruments.
    pub scan: Option<f64>,
}

impl Report {
    /// The type of the observation.
    pub fn observation_type(&self) -> ObservationType {
        ObservationType { network: Arc::clone(&self.network), variable: self.variable }
    }
}

/// A type of observations: one variable of one network.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ObservationType {
    /// Name of the network or satellite.
    pub network: Arc<str>,
    /// Number of the observed variable in the state's layout.
    pub variable: usize,
}

impl ObservationType {
    /// Its name, `network/variable`.
    ///
    /// # Panics
    /// If it is of another layout.
    pub fn name(&self, layout: &Layout) -> String {
        format!("{}/{}", self.network, layout.variables[self.variable].name)
    }
}
