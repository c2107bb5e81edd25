//! The observations of one cycle, as a method receives them.

use crate::operator::ObservationOperator;
use crate::quality::RejectedObservation;
use isobar_model::{State, Time};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::sync::Arc;

/// What is known of one observation beside its value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Name of the network or satellite.
    pub network: Arc<str>,
    /// Name of the station, or of the footprint's place in the swath.
    pub platform: Arc<str>,
    /// Number of the observed variable in the state's layout.
    pub variable: usize,
    /// When it is valid: at the end of the window, but for late ones and for those of a file within its tolerance.
    pub time: Time,
    /// x of the station or footprint centre \[m\].
    pub x_m: f64,
    /// y of the station or footprint centre \[m\].
    pub y_m: f64,
    /// Scan position in [-1, 1], for scanning instruments.
    pub scan: Option<f64>,
}

/// All observations of one cycle, valid at its end.
#[derive(Clone)]
pub struct ObservationWindow {
    /// The valid time of the observations and of the analysis.
    pub time: Time,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Where, what and by whom.
    pub reports: Vec<Report>,
    /// The reported values, biases included.
    pub values: Vec<f64>,
    /// The same without the biases, for methods that are told them.
    pub values_bias_removed: Vec<f64>,
    /// Standard deviation of each random error; errors are independent.
    pub sigma: Vec<f64>,
    /// What was reported as well, but fails quality control: no method sees it.
    pub rejected: Vec<RejectedObservation>,
    /// h(x, c) of these observations.
    pub operator: Arc<dyn ObservationOperator>,
}

impl ObservationWindow {
    /// Number of observations.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether nothing was reported.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The same observations with bias predictors that are those of a background:
    /// [`anchored`](ObservationOperator::anchored).
    pub fn anchored(&self, background: &State) -> Cow<'_, Self> {
        match self.operator.anchored(background) {
            Some(operator) => Cow::Owned(Self { operator: Arc::new(operator), ..self.clone() }),
            None => Cow::Borrowed(self),
        }
    }
}
