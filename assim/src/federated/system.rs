//! What one observing system reports.

use isobar_model::State;
use isobar_obs::{Jacobian, ObservationOperator, ObservationWindow, SparseRows};
use std::sync::Arc;

/// The rows of an operator that belong to one system, as functions of that system's biases alone.
struct SystemOperator {
    whole: Arc<dyn ObservationOperator>,
    rows: Vec<usize>,
    /// The numbers of the system's biases among all, ascending.
    parameters: Vec<usize>,
    /// How many biases there are.
    all: usize,
}

impl SystemOperator {
    /// The system's biases among all, those of others being zero.
    fn among_all(&self, own: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; self.all];
        self.parameters.iter().zip(own).for_each(|(&number, &value)| all[number] = value);
        all
    }
}

impl ObservationOperator for SystemOperator {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let simulated = self.whole.simulate(x, &self.among_all(calibration));
        self.rows.iter().map(|&row| simulated[row]).collect()
    }

    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let whole = self.whole.linearize(x, &self.among_all(calibration));
        let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
        for &row in &self.rows {
            state.push_row(whole.state.row(row).iter().copied());
            let own = |&(number, weight): &(usize, f64)| Some((self.parameters.binary_search(&number).ok()?, weight));
            calibration.push_row(whole.calibration.row(row).iter().filter_map(own));
        }
        Jacobian { state, calibration }
    }
}

/// The observations of these rows, for a method whose calibration parameters are those of the numbers `parameters` out of
/// `all`.
pub(super) fn observations_of(
    observed: &ObservationWindow,
    rows: Vec<usize>,
    parameters: &[usize],
    all: usize,
) -> ObservationWindow {
    let chosen = |values: &[f64]| rows.iter().map(|&row| values[row]).collect();
    ObservationWindow {
        time: observed.time,
        cycle: observed.cycle,
        reports: rows.iter().map(|&row| observed.reports[row].clone()).collect(),
        times: rows.iter().map(|&row| observed.times[row]).collect(),
        values: chosen(&observed.values),
        sigma: chosen(&observed.sigma),
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(SystemOperator {
            whole: Arc::clone(&observed.operator),
            rows,
            parameters: parameters.to_vec(),
            all,
        }),
    }
}
