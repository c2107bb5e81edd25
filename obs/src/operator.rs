//! Observation operators: what an instrument would report of a state.

use crate::jacobian::Jacobian;
use crate::sparse::SparseRows;
use isobar_model::{Duration, State};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// An observation operator y = h(x, c) of state and calibration.
pub trait ObservationOperator: Send + Sync {
    /// Number of observations.
    fn len(&self) -> usize;

    /// Whether there are no observations.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// h(x, c): the observations without random error; `calibration` in the order of
    /// [`Calibration`](crate::Calibration).
    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64>;

    /// The Jacobians of h at (x, c), as a value.
    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian;

    /// G alone, the calibration's part of [`ObservationOperator::linearize`], which may take far less than all of it.
    fn linearize_calibration(&self, x: &State, calibration: &[f64]) -> SparseRows {
        self.linearize(x, calibration).calibration
    }

    /// The operator with its bias predictors fixed at those of a background x_b, which makes it linear in state and calibration;
    /// `None` if it has no predictors that depend on the state.
    ///
    /// ```text
    /// h_b(x, c) = X x + (G + P(x_b)) c
    /// ```
    ///
    /// This is what variational bias correction does in practice: a bias must not pull the state by way of its predictor (Dee
    /// 2005, Q. J. R. Meteorol. Soc. 131, 3323–3343). The error that it leaves in observation i is Σ_j β_j (p_j(x_true) −
    /// p_j(x_b)), of the size of β times the background's error in units of the predictor's scale; methods do not know of it.
    /// Where x_b is the conditional mean of x_true, that error has mean 0 and is uncorrelated with p(x_b), so it adds to the
    /// random error but leaves estimates of β unbiased; of a worse background it biases them.
    fn anchored(&self, _background: &State) -> Option<Arc<dyn ObservationOperator>> {
        None
    }

    /// When its observations are valid, if not all of them are at the end of the window.
    fn within_window(&self) -> Option<TimedObservations<'_>> {
        None
    }

    /// Whether the observation of this number is valid at the end of the window.
    fn is_at_end(&self, row: usize) -> bool {
        self.within_window().is_none_or(|within| within.lags[row].seconds() == 0)
    }
}

/// Observations that are not all valid at the end of their window: see [`WithinWindow`](crate::WithinWindow).
#[derive(Clone, Copy)]
pub struct TimedObservations<'a> {
    /// As if they were valid at the end of the window.
    pub whole: &'a Arc<dyn ObservationOperator>,
    /// How long before the end of the window each is valid.
    pub lags: &'a [Duration],
    /// δ, what each would have shown then of the background beyond what it shows at the end.
    pub shift: &'a [f64],
}

/// An operator that is linear in both arguments: interpolation, footprints, additive biases.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinearOperator {
    /// Its Jacobians, the same everywhere.
    pub jacobian: Jacobian,
}

impl ObservationOperator for LinearOperator {
    fn len(&self) -> usize {
        self.jacobian.rows()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        self.jacobian.apply(x.values(), calibration)
    }

    fn linearize(&self, _: &State, _: &[f64]) -> Jacobian {
        self.jacobian.clone()
    }

    fn linearize_calibration(&self, _: &State, _: &[f64]) -> SparseRows {
        self.jacobian.calibration.clone()
    }
}
