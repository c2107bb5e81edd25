//! Observations of a cycle as linear rows.

use crate::augmented::Augmented;
use isobar_model::Time;
use isobar_obs::Jacobian;
use serde::{Deserialize, Serialize};

/// A row of F^y: entries by the number of the amplitude.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Coefficients {
    /// Of the unknowns C.
    pub constant: Vec<(usize, f64)>,
    /// Of the evolving amplitudes.
    pub evolving: Vec<(usize, f64)>,
}

/// y' = H s + F^y C + e.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Observed {
    pub time: Time,
    /// y'.
    pub values: Vec<f64>,
    /// H, with columns of the evolving amplitudes after those of the parameters.
    pub jacobian: Jacobian,
    pub variance: Vec<f64>,
    pub coefficients: Vec<Coefficients>,
}

impl Observed {
    /// Whether they are of q unknowns, and a state with parameters like `s`.
    pub fn fits(&self, s: &Augmented, q: usize) -> bool {
        let n = self.values.len();
        let Jacobian { state, calibration } = &self.jacobian;
        self.variance.len() == n
            && self.coefficients.len() == n
            && self.coefficients.iter().all(|own| own.constant.iter().all(|entry| entry.0 < q))
            && state.has_shape(n, s.state.values().len())
            && calibration.has_shape(n, s.bias.len())
    }
}
