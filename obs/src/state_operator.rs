//! What one observation sees of the state.

use isobar_model::State;
use std::borrow::Cow;
use std::fmt::Debug;
use std::sync::Arc;

/// The state's part h(x) of one observation, in the observed variable's unit.
#[derive(Clone, Debug)]
pub enum StateOperator {
    /// A row of X, h(x) = Σ weight × value: (index in the state, weight).
    Linear(Vec<(usize, f64)>),
    /// Any other function of the state.
    Nonlinear(Arc<dyn NonlinearOperator>),
}

/// A function of the state that is not linear, for an observation.
pub trait NonlinearOperator: Debug + Send + Sync {
    /// h(x), in the observed variable's unit.
    fn value(&self, x: &State) -> f64;

    /// ∂h/∂x at x: (index in the state, derivative), no index twice. Its transpose is the adjoint.
    fn gradient(&self, x: &State) -> Vec<(usize, f64)>;
}

impl StateOperator {
    /// An operator that is not linear.
    pub fn nonlinear(operator: impl NonlinearOperator + 'static) -> Self {
        Self::Nonlinear(Arc::new(operator))
    }

    /// h(x).
    pub fn value(&self, x: &State) -> f64 {
        match self {
            Self::Linear(row) => row.iter().map(|&(index, weight)| weight * x.values()[index]).sum(),
            Self::Nonlinear(operator) => operator.value(x),
        }
    }

    /// ∂h/∂x at x: (index in the state, derivative).
    pub fn gradient(&self, x: &State) -> Cow<'_, [(usize, f64)]> {
        match self {
            Self::Linear(row) => Cow::Borrowed(row),
            Self::Nonlinear(operator) => Cow::Owned(operator.gradient(x)),
        }
    }

    /// How many weights its row has; of an operator that is not linear, only itself knows.
    pub(crate) fn weights(&self) -> usize {
        match self {
            Self::Linear(row) => row.len(),
            Self::Nonlinear(_) => 0,
        }
    }
}
