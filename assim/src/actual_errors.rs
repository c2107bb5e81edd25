//! The actual errors of an estimate whose gains are given: what any linear method is worth, without random numbers.

use crate::error::Error;
use crate::linalg::{add_product, product};
use crate::problem::entries;
use crate::propagator;
use crate::response::Gain;
use faer::{Mat, MatRef};
use isobar_model::vector::subtract;
use isobar_model::{State, TangentLinear};
use isobar_obs::Jacobian;

/// Mean and covariance of the errors e = (x̂ − x, ĉ − c) of a method in a linear world whose covariances are known.
///
/// Forecast and analysis of the errors, with the propagator A, the model error q ~ N(0, Q), the drift φ and w of the parameters,
/// the gain K of the method, H = (X, G) and the observation error o ~ N(0, R):
///
/// ```text
/// e ← (A e_x − q, φ e_c − w)      P ← A P Aᵀ + Q
/// e ← (I − K H) e + K o           P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ
/// ```
///
/// with the actual Q and R, whatever the method assumes (Joseph's form holds for any gain: Bucy and Joseph 1968; Todling
/// and Cohn 1994, Mon. Wea. Rev. 122, eqs. 12 and 13, who measure suboptimal schemes so). No gain has a smaller trace of P
/// than the Kalman filter's.
#[derive(Clone, Debug)]
pub struct ActualErrors {
    /// Number of the state's values.
    m: usize,
    /// E\[e\], `[m + p]`.
    mean: Vec<f64>,
    /// Cov(e), `[m + p, m + p]`.
    covariance: Mat<f64>,
}

impl ActualErrors {
    /// Errors of independent state and parameters: the state's covariance `[m, m]`, means and variances of the `p`
    /// parameters' errors.
    pub fn new(state_covariance: MatRef<'_, f64>, calibration_mean: &[f64], calibration_variance: &[f64]) -> Self {
        let (m, p) = (state_covariance.nrows(), calibration_mean.len());
        let mut covariance = Mat::zeros(m + p, m + p);
        covariance.as_mut().get_mut(..m, ..m).copy_from(state_covariance);
        for (i, &variance) in calibration_variance.iter().enumerate() {
            covariance[(m + i, m + i)] = variance;
        }
        let mut mean = vec![0.0; m];
        mean.extend_from_slice(calibration_mean);
        Self { m, mean, covariance }
    }

    /// A of a linear model over `steps` time steps, `[m, m]`.
    ///
    /// # Errors
    /// If the model leaves the finite numbers.
    pub fn propagator(model: &dyn TangentLinear, state: &State, steps: usize) -> Result<Mat<f64>, Error> {
        let m = state.values().len();
        let columns = propagator::propagator(model, &mut state.clone(), steps)?;
        Ok(MatRef::from_column_major_slice(&columns, m, m).to_owned())
    }

    /// A forecast with propagator `[m, m]` and model error `[m, m]`; the parts φ of the parameters that are kept and the variances
    /// that are added, `[p]`, and by how much the mean of each parameter's true value changes beside.
    pub fn forecast(
        &mut self,
        propagator: MatRef<'_, f64>,
        model_error: Option<MatRef<'_, f64>>,
        kept: &[f64],
        added_variance: &[f64],
        mean_change: &[f64],
    ) {
        let m = self.m;
        let rows = product(propagator, self.covariance.as_ref().get(..m, ..));
        let mut state = product(rows.as_ref().get(.., ..m), propagator.transpose());
        if let Some(model_error) = model_error {
            state += model_error;
        }
        let mut covariance = self.covariance.as_mut();
        covariance.as_mut().get_mut(..m, ..m).copy_from(&state);
        covariance.as_mut().get_mut(..m, m..).copy_from(rows.as_ref().get(.., m..));
        covariance.as_mut().get_mut(m.., ..m).copy_from(rows.as_ref().get(.., m..).transpose());
        for (i, (kept, variance)) in kept.iter().zip(added_variance).enumerate() {
            for j in 0..self.mean.len() {
                self.covariance[(m + i, j)] *= kept;
                self.covariance[(j, m + i)] *= kept;
            }
            self.covariance[(m + i, m + i)] += variance;
            self.mean[m + i] *= kept;
        }
        let state_mean: Vec<f64> = (0..m).map(|i| (0..m).map(|j| propagator[(i, j)] * self.mean[j]).sum()).collect();
        self.mean[..m].copy_from_slice(&state_mean);
        subtract(&mut self.mean[m..], mean_change);
    }

    /// An analysis with a gain, of observations with these Jacobians and rows of R. Without `with_biases` they have no biases:
    /// G is zero.
    pub fn analyse(&mut self, gain: &Gain, jacobian: &Jacobian, error_covariance: &[Vec<f64>], with_biases: bool) {
        let (m, n, size) = (self.m, error_covariance.len(), self.mean.len());
        let row = |row: usize| entries(jacobian, row, m).filter(move |entry| with_biases || entry.0 < m);
        let gain = Mat::from_fn(size, n, |i, j| if i < m { gain.state[(i, j)] } else { gain.calibration[(i - m, j)] });
        // P Hᵀ and H P Hᵀ + R.
        let mut cross = Mat::zeros(size, n);
        for j in 0..n {
            for (column, weight) in row(j) {
                (0..size).for_each(|i| cross[(i, j)] += weight * self.covariance[(i, column)]);
            }
        }
        let innovation = Mat::from_fn(n, n, |i, j| {
            let own: f64 = row(i).map(|(column, weight)| weight * cross[(column, j)]).sum();
            own + error_covariance[i][j]
        });
        // K S Kᵀ − K (P Hᵀ)ᵀ − P Hᵀ Kᵀ = −K Dᵀ − D Kᵀ with D = P Hᵀ − ½ K S.
        let mut half = cross;
        add_product(half.as_mut(), -0.5, gain.as_ref(), innovation.as_ref());
        add_product(self.covariance.as_mut(), -1.0, gain.as_ref(), half.transpose());
        add_product(self.covariance.as_mut(), -1.0, half.as_ref(), gain.transpose());
        let simulated: Vec<f64> =
            (0..n).map(|j| row(j).map(|(column, weight)| weight * self.mean[column]).sum()).collect();
        for (i, mean) in self.mean.iter_mut().enumerate() {
            *mean -= simulated.iter().enumerate().map(|(j, value)| gain[(i, j)] * value).sum::<f64>();
        }
    }

    /// E\[e_i²\] of every value of the state and of every parameter, `[m + p]`.
    pub fn mean_squares(&self) -> Vec<f64> {
        self.mean.iter().enumerate().map(|(i, mean)| self.covariance[(i, i)] + mean * mean).collect()
    }
}
