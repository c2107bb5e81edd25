//! Optimal interpolation.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::covariance;
use crate::error::Error;
use crate::linalg::{cholesky, column, product, solve_lower, solve_lower_transposed, squared_norm};
use crate::problem::{Innovations, Problem};
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes};
use crate::spread::standard_deviations;
use faer::Mat;
use isobar_model::{Duration, State, forecast};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;

/// The best linear estimate with a background covariance s B that never changes (Gandin 1963; Lorenc 1981), in the space
/// of the observations:
///
/// ```text
/// S = s H B Hᵀ + G P_c Gᵀ + R,     δx = s B Hᵀ S⁻¹ d,     δc = P_c Gᵀ S⁻¹ d,     P_c ← P_c − P_c Gᵀ S⁻¹ G P_c
/// ```
///
/// What 3D-Var finds by iteration, found directly; here with the spread that it claims of its analysis.
pub struct OptimalInterpolation {
    problem: Problem,
    covariance_scale: f64,
    calibration: Calibration,
    state: State,
    bias: Vec<f64>,
    /// P_c, `[p, p]`.
    bias_covariance: Mat<f64>,
    /// √s of the diagonal of B.
    background_spread: Vec<f64>,
}

impl OptimalInterpolation {
    /// Optimal interpolation from the background, with the problem's B times a factor.
    pub fn new(problem: Problem, covariance_scale: f64) -> Self {
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        let bias_covariance =
            Mat::from_fn(p, p, |i, j| if i == j { calibration.parameters[i].sigma_prior.powi(2) } else { 0.0 });
        let mut background_spread = covariance::standard_deviations(&*problem.background_error);
        background_spread.iter_mut().for_each(|sigma| *sigma *= covariance_scale.sqrt());
        let (state, bias) = (problem.background.clone(), vec![0.0; problem.calibration.len()]);
        Self { problem, covariance_scale, calibration, state, bias, bias_covariance, background_spread }
    }

    fn estimate(&self, state_spread: Vec<f64>) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.calibration.len()).map(|i| self.bias_covariance[(i, i)]).collect();
        let spread = standard_deviations(&variances, "the covariance of the calibration parameters", |i| {
            self.calibration.parameters[i].name.clone()
        })?;
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: Some(state_spread),
            calibration_spread: (!self.calibration.is_empty()).then_some(spread),
        })
    }

    /// s B Hᵀ, `[m, n]`.
    fn cross_covariance(&self, innovations: &Innovations) -> Mat<f64> {
        let (m, n) = (self.state.values().len(), innovations.variance.len());
        let columns: Vec<Vec<f64>> = (0..n)
            .into_par_iter()
            .map(|row| {
                let mut unit = vec![0.0; m];
                innovations.jacobian.state.row(row).iter().for_each(|&(index, weight)| unit[index] += weight);
                covariance::multiply(&*self.problem.background_error, &unit)
            })
            .collect();
        Mat::from_fn(m, n, |i, j| self.covariance_scale * columns[j][i])
    }

    /// P_c Gᵀ, `[p, n]`.
    fn bias_cross_covariance(&self, innovations: &Innovations) -> Mat<f64> {
        let rows = &innovations.jacobian.calibration;
        Mat::from_fn(self.calibration.len(), innovations.variance.len(), |i, row| {
            rows.row(row).iter().map(|&(parameter, weight)| weight * self.bias_covariance[(i, parameter)]).sum()
        })
    }
}

impl Assimilator for OptimalInterpolation {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        forecast::forecast(&*self.problem.model, &mut self.state, self.problem.steps(window)?)?;
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            self.bias_covariance[(i, i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * window.days();
        }
        self.estimate(self.background_spread.clone())
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        let (cross, bias_cross) = (self.cross_covariance(&innovations), self.bias_cross_covariance(&innovations));
        let n = innovations.variance.len();
        let jacobian = &innovations.jacobian;
        let covariance = Mat::from_fn(n, n, |i, j| {
            let of_state = jacobian.state.row_dot(i, cross.col_as_slice(j));
            let of_biases = jacobian.calibration.row_dot(i, bias_cross.col_as_slice(j));
            of_state + of_biases + if i == j { innovations.variance[i] } else { 0.0 }
        });
        let root = cholesky(covariance, || "the innovation covariance s H B H' + G P G' + R".into())?;
        let mut whitened = column(&innovations.departures);
        solve_lower(root.as_ref(), whitened.as_mut());
        let innovation_chi2 = squared_norm(whitened.col_as_slice(0));
        let mut weights = whitened;
        solve_lower_transposed(root.as_ref(), weights.as_mut());
        let state_increment = product(cross.as_ref(), weights.as_ref());
        let bias_increment = product(bias_cross.as_ref(), weights.as_ref());
        let changes = state_increment.col_as_slice(0);
        self.state.values_mut().iter_mut().zip(changes).for_each(|(value, change)| *value += change);
        let changes = bias_increment.col_as_slice(0);
        self.bias.iter_mut().zip(changes).for_each(|(value, change)| *value += change);

        // What the observations took off the variances: the squares of the columns of L⁻¹ H B.
        let mut reduction = cross.transpose().to_owned();
        solve_lower(root.as_ref(), reduction.as_mut());
        let variances: Vec<f64> = self
            .background_spread
            .iter()
            .enumerate()
            .map(|(i, sigma)| sigma * sigma - squared_norm(reduction.col_as_slice(i)))
            .collect();
        let layout = self.state.layout();
        let spread = standard_deviations(&variances, "the analysis covariance", |i| layout.describe(i))?;
        let mut reduction = bias_cross.transpose().to_owned();
        solve_lower(root.as_ref(), reduction.as_mut());
        self.bias_covariance -= product(reduction.transpose(), reduction.as_ref());
        Ok(self.problem.analysis(observed, innovations, self.estimate(spread)?, innovation_chi2))
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&(self.state.values(), &self.bias, Matrix::from(&self.bias_covariance)))
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let (state, bias, bias_covariance): (Vec<f64>, Vec<f64>, Matrix) = from_bytes(saved)?;
        restore_state(&mut self.state, &state)?;
        restore_bias(&mut self.bias, &bias)?;
        let p = self.calibration.len();
        self.bias_covariance = bias_covariance.restored(p, Some(p), "the covariance of the calibration")?;
        Ok(())
    }
}
