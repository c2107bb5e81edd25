//! The control vector of the variational methods.

use crate::covariance::Covariance;
use crate::error::Error;
use crate::linalg::{add_symmetric_product, cholesky, column, product, solve_lower};
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

    /// σ of the error of a parameter.
    pub fn bias_sigma(&self, parameter: usize) -> f64 {
        let row = self.bias_root.row(parameter);
        row.iter().map(|value| value * value).sum::<f64>().sqrt()
    }

    /// δx of χ.
    pub fn state_increment(&self, chi: &[f64]) -> Vec<f64> {
        let mut dx = vec![0.0; self.covariance.len()];
        self.covariance.root_add(chi, &mut dx);
        dx.iter_mut().for_each(|value| *value *= self.root_scale);
        dx
    }

    /// The adjoint of [`ControlSpace::state_increment`]: √s Uᵀ δx.
    pub fn state_control(&self, dx: &[f64]) -> Vec<f64> {
        let scaled: Vec<f64> = dx.iter().map(|value| value * self.root_scale).collect();
        let mut control = vec![0.0; self.covariance.control_len()];
        self.covariance.root_transpose_add(&scaled, &mut control);
        control
    }

    /// (δx, δc) of a control vector.
    pub fn increments(&self, control: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (chi, beta) = control.split_at(self.covariance.control_len());
        let dc = product(self.bias_root.as_ref(), column(beta).as_ref());
        (self.state_increment(chi), dc.col_as_slice(0).to_vec())
    }

    /// The adjoint of [`ControlSpace::increments`]: (√s Uᵀ δx, Lᵀ δc).
    pub fn controls(&self, dx: &[f64], dc: &[f64]) -> Vec<f64> {
        let mut control = self.state_control(dx);
        control.extend_from_slice(product(self.bias_root.transpose(), column(dc).as_ref()).col_as_slice(0));
        control
    }

    /// (P_c⁻¹ + M)⁻¹ = L (I + Lᵀ M L)⁻¹ Lᵀ with the observations' information M on the biases, `[p, p]`.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if M was found with too loose a tolerance.
    pub fn bias_covariance(&self, information: &Mat<f64>) -> Result<Mat<f64>, Error> {
        let (p, root) = (self.parameters(), self.bias_root.as_ref());
        let right = product(information.as_ref(), root);
        let mut whitened = Mat::identity(p, p);
        add_symmetric_product(whitened.as_mut(), 1.0, root.transpose(), right.as_ref());
        drop(right);
        let own = cholesky(whitened, || {
            "the information on the calibration parameters, which the minimisation's `tolerance` makes too inaccurate,"
                .into()
        })?;
        let mut half = root.transpose().to_owned();
        solve_lower(own.as_ref(), half.as_mut());
        let mut covariance = Mat::zeros(p, p);
        add_symmetric_product(covariance.as_mut(), 1.0, half.transpose(), half.as_ref());
        Ok(covariance)
    }
}

/// The numbers that the minimisation holds, given the lengths of χ and of the state (m), p biases and n observations: the control vectors of conjugate gradients and of the threads; P_c and what becomes of it; for each bias
/// what conjugate gradients hold in the space of the observations.
pub(super) fn numbers(state_controls: usize, m: usize, p: usize, observations: usize) -> f64 {
    let threads = rayon::current_num_threads() as f64;
    let [controls, m, p, n] = [state_controls, m, p, observations].map(|size| size as f64);
    6.0 * (controls + p) + threads * (controls + 2.0 * m) + 6.0 * p * p + 6.0 * n * (p + 1.0)
}
