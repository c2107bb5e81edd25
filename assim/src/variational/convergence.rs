//! Whether the minimisations of a variational method have converged.

use super::conjugate_gradient::Ending;
use crate::estimated::{EstimatedParameter, EstimatesParameters};
use serde::{Deserialize, Serialize};

/// What is known of the minimisations: of the last analysis, and how many have not converged.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Convergence {
    /// Most iterations of a system of the last analysis.
    iterations: usize,
    /// Largest gradient left, relative to the first.
    relative_gradient: f64,
    /// Whether all systems of the last analysis reached the tolerance.
    reached: bool,
    analyses: usize,
    unconverged_analyses: usize,
}

impl Convergence {
    /// Takes in the last minimisations of an analysis: that of the cost, and those of the covariance of the biases.
    pub fn add(&mut self, minimum: Ending, of_biases: &[Ending]) {
        let endings = || std::iter::once(minimum).chain(of_biases.iter().copied());
        self.iterations = endings().map(|ending| ending.iterations).max().unwrap_or(0);
        self.relative_gradient = endings().map(|ending| ending.relative_residual).fold(0.0, f64::max);
        self.reached = endings().all(|ending| ending.reached);
        self.analyses += 1;
        self.unconverged_analyses += usize::from(!self.reached);
    }

    /// Whether the last analysis is at the minimum.
    pub fn reached(&self) -> bool {
        self.reached
    }

    /// What there is to warn of after the last analysis.
    pub fn warning(&self) -> Option<String> {
        (!self.reached).then(|| {
            format!(
                "the minimisation has not converged: after {} iterations the gradient is {:.1e} of the first, and its \
                 tolerance is not reached; the analysis is not the minimum, and no χ² is given",
                self.iterations, self.relative_gradient
            )
        })
    }
}

impl EstimatesParameters for Convergence {
    /// Iterations, gradient and number of unconverged analyses.
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        let parameter = |name: &str, value: f64, verdict: &str| EstimatedParameter {
            name: name.into(),
            unit: "1".into(),
            value,
            sigma: None,
            verdict: verdict.into(),
        };
        let verdict = if self.reached { "converged" } else { "not converged: the tolerance was not reached" };
        let all = format!("of {} analyses", self.analyses);
        vec![
            parameter("minimiser/iterations", self.iterations as f64, verdict),
            parameter("minimiser/relative_gradient", self.relative_gradient, verdict),
            parameter("minimiser/unconverged_analyses", self.unconverged_analyses as f64, &all),
        ]
    }
}
