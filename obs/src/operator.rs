//! Observation operators: what an instrument would report of a state.

use crate::block_angular::BlockAngular;
use isobar_model::State;

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
    fn linearize(&self, x: &State, calibration: &[f64]) -> BlockAngular;
}

/// An operator that is linear in both arguments: interpolation, footprints, additive biases.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearOperator {
    /// Its Jacobians, the same everywhere.
    pub jacobian: BlockAngular,
}

impl ObservationOperator for LinearOperator {
    fn len(&self) -> usize {
        self.jacobian.rows()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        self.jacobian.apply(x.values(), calibration)
    }

    fn linearize(&self, _: &State, _: &[f64]) -> BlockAngular {
        self.jacobian.clone()
    }
}
