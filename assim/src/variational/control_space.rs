//! The control vector of the variational methods.

use super::conjugate_gradient::Solution;
use crate::covariance::Covariance;
use crate::error::Error;
use crate::linalg::{cholesky, column, product};
use faer::Mat;

/// Control vectors (χ, β) with δx = √s U χ, U Uᵀ = B, and δc = L β, L Lᵀ = P_c, in which the background term of the cost
/// is ½ χᵀχ + ½ βᵀβ.
pub(super) struct ControlSpace<'a> {
    covariance: &'a dyn Covariance,
    /// √s.
    root_scale: f64,
    /// L, `[p, p]`.
    bias_root: Mat<f64>,
}

impl<'a> ControlSpace<'a> {
    /// The space for s B and P_c.
    ///
    /// # Errors
    /// If P_c is not positive definite.
    pub fn new(covariance: &'a dyn Covariance, scale: f64, bias_covariance: &Mat<f64>) -> Result<Self, Error> {
        let bias_root = cholesky(bias_covariance.clone(), || "the covariance of the calibration parameters".into())?;
        Ok(Self { covariance, root_scale: scale.sqrt(), bias_root })
    }

    /// m, the number of values of a state.
    pub fn state_values(&self) -> usize {
        self.covariance.len()
    }

    /// p, the number of calibration parameters.
    pub fn parameters(&self) -> usize {
        self.bias_root.nrows()
    }

    /// (δx, δc) of a control vector.
    pub fn increments(&self, control: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (chi, beta) = control.split_at(self.covariance.control_len());
        let mut dx = vec![0.0; self.covariance.len()];
        self.covariance.root_add(chi, &mut dx);
        dx.iter_mut().for_each(|value| *value *= self.root_scale);
        (dx, product(self.bias_root.as_ref(), column(beta).as_ref()).col_as_slice(0).to_vec())
    }

    /// The adjoint of [`ControlSpace::increments`]: (√s Uᵀ δx, Lᵀ δc).
    pub fn controls(&self, dx: &[f64], dc: &[f64]) -> Vec<f64> {
        let scaled: Vec<f64> = dx.iter().map(|value| value * self.root_scale).collect();
        let mut control = vec![0.0; self.covariance.control_len()];
        self.covariance.root_transpose_add(&scaled, &mut control);
        control.extend_from_slice(product(self.bias_root.transpose(), column(dc).as_ref()).col_as_slice(0));
        control
    }

    /// The unit vectors of β, one for each parameter.
    pub fn bias_units(&self) -> impl Iterator<Item = Vec<f64>> {
        let states = self.covariance.control_len();
        (0..self.parameters()).map(move |parameter| {
            let mut unit = vec![0.0; states + self.parameters()];
            unit[states + parameter] = 1.0;
            unit
        })
    }

    /// L Z Lᵀ with Z the β block of the inverse Hessian, from the solutions of the Hessian for the unit vectors of β.
    pub fn bias_covariance(&self, solutions: &[Solution]) -> Mat<f64> {
        let (states, p) = (self.covariance.control_len(), self.parameters());
        let entry = |system: usize, parameter: usize| solutions[system].values[states + parameter];
        let whitened = Mat::from_fn(p, p, |i, j| 0.5 * (entry(j, i) + entry(i, j)));
        let left = product(self.bias_root.as_ref(), whitened.as_ref());
        product(left.as_ref(), self.bias_root.transpose())
    }
}
