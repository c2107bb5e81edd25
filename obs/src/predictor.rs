//! Bias predictors: functions of the state.

use isobar_model::State;

/// The predictor of one parameter β at one observation, p(x) = constant + row x; the bias is β p(x).
#[derive(Clone, Debug, PartialEq)]
pub struct Predictor {
    /// Number of the parameter β in the calibration.
    pub parameter: usize,
    /// p(0), without unit.
    pub constant: f64,
    /// ∂p/∂x: (index in the state, weight).
    pub row: Vec<(usize, f64)>,
}

impl Predictor {
    /// p(x).
    fn value(&self, x: &State) -> f64 {
        self.constant + self.row.iter().map(|&(column, weight)| weight * x.values()[column]).sum::<f64>()
    }

    /// Its entry in the row of P(x): (number of the parameter, p(x)).
    pub fn entry(&self, x: &State) -> (usize, f64) {
        (self.parameter, self.value(x))
    }

    /// β p(x).
    pub fn bias(&self, x: &State, calibration: &[f64]) -> f64 {
        calibration[self.parameter] * self.value(x)
    }
}
