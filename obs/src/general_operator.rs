//! The operator of observations that are not all linear in state and calibration.

use crate::jacobian::Jacobian;
use crate::observation::Observation;
use crate::operator::{LinearOperator, ObservationOperator};
use crate::predictor::Predictor;
use crate::sparse::SparseRows;
use crate::state_operator::{NonlinearOperator, StateOperator};
use isobar_model::State;
use std::sync::Arc;

/// An operator with observations that are not linear in the state, or whose biases depend on it:
///
/// ```text
/// h(x, c) = X x + N(x) + (G + P(x)) c,     P_ij(x) = p_j(x) of observation i
/// ```
///
/// The bias is bilinear in x and c; a method gets the operator with [anchored](ObservationOperator::anchored) predictors.
#[derive(Clone, Debug, Default)]
pub(crate) struct GeneralOperator {
    /// X and G.
    linear: LinearOperator,
    /// N: numbers of observations, in ascending order, with their operators.
    nonlinear: Vec<(usize, Arc<dyn NonlinearOperator>)>,
    /// P: the predictors of each observation.
    predictors: Vec<Vec<Predictor>>,
}

impl GeneralOperator {
    /// Takes what an observation sees of state and biases, and gives back the rest.
    pub fn take(&mut self, mut observation: Observation) -> Observation {
        let state = std::mem::replace(&mut observation.state, StateOperator::Linear(Vec::new()));
        let row = match state {
            StateOperator::Linear(row) => row,
            StateOperator::Nonlinear(operator) => {
                self.nonlinear.push((self.predictors.len(), operator));
                Vec::new()
            }
        };
        self.linear.jacobian.state.push_row(row);
        self.linear.jacobian.calibration.push_row(std::mem::take(&mut observation.calibration_row));
        self.predictors.push(std::mem::take(&mut observation.predictors));
        observation
    }

    /// G + P(x).
    fn calibration_rows(&self, x: &State) -> SparseRows {
        let mut rows = SparseRows::new();
        for (number, predictors) in self.predictors.iter().enumerate() {
            let fixed = self.linear.jacobian.calibration.row(number).iter().copied();
            rows.push_row(fixed.chain(predictors.iter().map(|predictor| predictor.entry(x))));
        }
        rows
    }

    /// X + ∂N/∂x.
    fn state_rows(&self, x: &State) -> Vec<Vec<(usize, f64)>> {
        let mut rows: Vec<_> = (0..self.len()).map(|number| self.linear.jacobian.state.row(number).to_vec()).collect();
        self.nonlinear.iter().for_each(|(number, operator)| rows[*number] = operator.gradient(x));
        rows
    }

    /// Whether no bias depends on the state.
    fn has_fixed_biases(&self) -> bool {
        self.predictors.iter().all(Vec::is_empty)
    }

    /// The same as the simplest operator that it is.
    pub fn simplified(self) -> Arc<dyn ObservationOperator> {
        if self.nonlinear.is_empty() && self.has_fixed_biases() { Arc::new(self.linear) } else { Arc::new(self) }
    }
}

impl ObservationOperator for GeneralOperator {
    fn len(&self) -> usize {
        self.linear.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let mut simulated = self.linear.simulate(x, calibration);
        self.nonlinear.iter().for_each(|(number, operator)| simulated[*number] += operator.value(x));
        for (value, predictors) in simulated.iter_mut().zip(&self.predictors) {
            *value += predictors.iter().map(|predictor| predictor.bias(x, calibration)).sum::<f64>();
        }
        simulated
    }

    /// ∂h/∂x = X + ∂N/∂x + Σ_j c_j ∂p_j/∂x and ∂h/∂c = G + P(x).
    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let mut state = SparseRows::new();
        for (mut row, predictors) in self.state_rows(x).into_iter().zip(&self.predictors) {
            for predictor in predictors {
                let coefficient = calibration[predictor.parameter];
                for &(column, weight) in &predictor.row {
                    match row.iter_mut().find(|entry| entry.0 == column) {
                        Some(entry) => entry.1 += coefficient * weight,
                        None => row.push((column, coefficient * weight)),
                    }
                }
            }
            state.push_row(row);
        }
        Jacobian { state, calibration: self.calibration_rows(x) }
    }

    fn anchored(&self, background: &State) -> Option<Arc<dyn ObservationOperator>> {
        if self.has_fixed_biases() {
            return None;
        }
        let (state, calibration) = (self.linear.jacobian.state.clone(), self.calibration_rows(background));
        let linear = LinearOperator { jacobian: Jacobian { state, calibration } };
        let predictors = vec![Vec::new(); self.len()];
        Some(Self { linear, nonlinear: self.nonlinear.clone(), predictors }.simplified())
    }
}
