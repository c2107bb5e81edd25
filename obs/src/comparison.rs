//! Comparisons of sensors, and test points: further data on biases.

use crate::jacobian::Jacobian;
use crate::operator::ObservationOperator;
use crate::sparse::SparseRows;
use isobar_model::State;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A comparison of two sensors side by side, or a test point of one sensor against a reference (claims 1a and 1f of WO 97/18442):
///
/// ```text
/// d = c_A − c_B + ε     the difference of their readings of the same thing
/// d = c_A + ε           reading − reference,     ε ~ N(0, σ²)
/// ```
///
/// It is a row of the regression with zeros for the state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorComparison {
    /// Number of A's parameter in the calibration.
    pub parameter: usize,
    /// Number of B's; `None` for a test point.
    pub other: Option<usize>,
    /// d, in the parameters' unit.
    pub value: f64,
    /// σ, above 0.
    pub sigma: f64,
}

impl SensorComparison {
    /// Its row of G: (parameter, weight).
    pub fn row(&self) -> impl Iterator<Item = (usize, f64)> + use<> {
        [(self.parameter, 1.0)].into_iter().chain(self.other.map(|other| (other, -1.0)))
    }

    /// What it would be without error.
    pub fn simulate(&self, calibration: &[f64]) -> f64 {
        self.row().map(|(parameter, weight)| weight * calibration[parameter]).sum()
    }
}

/// h(x, c) of observations, and below them the comparisons.
pub(crate) struct WithComparisons {
    pub observed: Arc<dyn ObservationOperator>,
    pub comparisons: Vec<SensorComparison>,
}

impl ObservationOperator for WithComparisons {
    fn len(&self) -> usize {
        self.observed.len() + self.comparisons.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let mut all = self.observed.simulate(x, calibration);
        all.extend(self.comparisons.iter().map(|it| it.simulate(calibration)));
        all
    }

    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let mut jacobian = self.observed.linearize(x, calibration);
        for comparison in &self.comparisons {
            jacobian.state.push_row([]);
            jacobian.calibration.push_row(comparison.row());
        }
        jacobian
    }

    fn linearize_calibration(&self, x: &State, calibration: &[f64]) -> SparseRows {
        let mut rows = self.observed.linearize_calibration(x, calibration);
        self.comparisons.iter().for_each(|comparison| rows.push_row(comparison.row()));
        rows
    }

    fn anchored(&self, background: &State) -> Option<Arc<dyn ObservationOperator>> {
        let observed = self.observed.anchored(background)?;
        Some(Arc::new(Self { observed, comparisons: self.comparisons.clone() }))
    }
}
