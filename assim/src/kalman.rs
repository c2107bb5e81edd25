//! The dense (extended) Kalman filter on the augmented state s = (x, c): the reference for every other method.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::covariance;
use crate::error::Error;
use crate::linalg::{
    add_product, add_symmetric_product, cholesky, column, product, solve_lower, solve_lower_transposed, squared_norm,
};
use crate::problem::{Innovations, Problem};
use crate::propagator::propagator;
use crate::spread::standard_deviations;
use faer::{Mat, MatRef};
use isobar_model::{Duration, State};
use isobar_obs::{BlockAngular, Calibration, ObservationWindow};

/// Forecast (21), (24) of WO 93/22625: `s~ = M(ŝ)`, `P = A Cov(ŝ) Aᵀ + Q`; analysis in gain form,
/// `K = P Hᵀ (H P Hᵀ + R)⁻¹`, with the covariance in Joseph's form `(I − K H) P (I − K H)ᵀ + K R Kᵀ`.
pub struct KalmanFilter {
    problem: Problem,
    calibration: Calibration,
    state: State,
    bias: Vec<f64>,
    /// P, `[m + p, m + p]`.
    covariance: Mat<f64>,
    /// Q of the state, `[m, m]`.
    model_error: Option<Mat<f64>>,
}

impl KalmanFilter {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit.
    pub fn new(problem: Problem) -> Result<Self, Error> {
        let calibration = problem.estimated_calibration();
        let (m, p) = (problem.background.values().len(), calibration.len());
        check_memory(&problem, m + p)?;
        let mut covariance = Mat::zeros(m + p, m + p);
        covariance.as_mut().get_mut(..m, ..m).copy_from(covariance::dense(&*problem.background_error));
        for (i, parameter) in calibration.parameters.iter().enumerate() {
            covariance[(m + i, m + i)] = parameter.sigma_prior.powi(2);
        }
        let model_error = problem.model_error.as_deref().map(covariance::dense);
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        Ok(Self { problem, calibration, state, bias, covariance, model_error })
    }

    /// The covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.covariance.as_ref()
    }

    fn estimate(&self) -> Result<Estimate, Error> {
        let m = self.state.values().len();
        let variances: Vec<f64> = (0..self.covariance.nrows()).map(|i| self.covariance[(i, i)]).collect();
        let mut spread = standard_deviations(&variances, "the covariance P", |i| match i < m {
            true => self.state.layout().describe(i),
            false => self.calibration.parameters[i - m].name.clone(),
        })?;
        let calibration_spread = spread.split_off(m);
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: Some(spread),
            calibration_spread: (!self.calibration.is_empty()).then_some(calibration_spread),
        })
    }
}

impl Assimilator for KalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        let steps = self.problem.steps(window)?;
        let a = propagator(&*self.problem.model, &mut self.state, steps)?;
        let a = MatRef::from_column_major_slice(&a, self.state.values().len(), self.state.values().len());
        let (m, s) = (a.nrows(), self.covariance.nrows());
        // A P_xx Aᵀ and A P_xc.
        let rows = product(a, self.covariance.as_ref().get(..m, ..));
        let mut forecast = Mat::zeros(s, s);
        if let Some(model_error) = &self.model_error {
            forecast.as_mut().get_mut(..m, ..m).copy_from(model_error);
        }
        add_symmetric_product(forecast.as_mut().get_mut(..m, ..m), 1.0, rows.as_ref().get(.., ..m), a.transpose());
        forecast.as_mut().get_mut(..m, m..).copy_from(rows.as_ref().get(.., m..));
        forecast.as_mut().get_mut(m.., ..m).copy_from(rows.as_ref().get(.., m..).transpose());
        forecast.as_mut().get_mut(m.., m..).copy_from(self.covariance.as_ref().get(m.., m..));
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            forecast[(m + i, m + i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * window.days();
        }
        self.covariance = forecast;
        self.estimate()
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        let m = self.state.values().len();
        let Innovations { departures, jacobian, variance } = &innovations;
        let cross = cross_covariance(self.covariance.as_ref(), jacobian, m);
        let root = cholesky(innovation_covariance(cross.as_ref(), jacobian, variance, m), || {
            "the innovation covariance H P H' + R".into()
        })?;
        let mut whitened = column(departures);
        solve_lower(root.as_ref(), whitened.as_mut());
        let innovation_chi2 = squared_norm(whitened.col_as_slice(0));
        let mut transposed_gain = cross.transpose().to_owned();
        solve_lower(root.as_ref(), transposed_gain.as_mut());
        solve_lower_transposed(root.as_ref(), transposed_gain.as_mut());
        let gain = transposed_gain.transpose();
        let increment = product(gain, column(departures).as_ref());
        for (value, i) in self.state.values_mut().iter_mut().zip(0..) {
            *value += increment[(i, 0)];
        }
        for (value, i) in self.bias.iter_mut().zip(m..increment.nrows()) {
            *value += increment[(i, 0)];
        }
        self.update_covariance(cross, gain, jacobian, variance);
        let estimate = self.estimate()?;
        let analysis_departures = self.problem.departures(observed, &estimate.state, &estimate.calibration);
        Ok(Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2),
            partition: None,
        })
    }
}

impl KalmanFilter {
    /// Joseph's form in two rank-n steps: P ← P − K (H P), then P ← P − (P Hᵀ) Kᵀ + K R Kᵀ.
    fn update_covariance(&mut self, cross: Mat<f64>, gain: MatRef<'_, f64>, jacobian: &BlockAngular, variance: &[f64]) {
        let m = self.state.values().len();
        let mut p = std::mem::replace(&mut self.covariance, Mat::zeros(0, 0));
        add_product(p.as_mut(), -1.0, gain, cross.transpose());
        // p is now (I − K H) P; left is −(I − K H) P Hᵀ + K R.
        let mut left = Mat::zeros(p.nrows(), variance.len());
        for (row, &variance) in variance.iter().enumerate() {
            let target = left.col_as_slice_mut(row);
            for (column, weight) in entries(jacobian, row, m) {
                for (value, p) in target.iter_mut().zip(p.col_as_slice(column)) {
                    *value -= weight * p;
                }
            }
            for (i, value) in target.iter_mut().enumerate() {
                *value += variance * gain[(i, row)];
            }
        }
        add_symmetric_product(p.as_mut(), 1.0, left.as_ref(), gain.transpose());
        self.covariance = p;
    }
}

/// The entries of a row of (X, G) on the augmented state.
fn entries(jacobian: &BlockAngular, row: usize, m: usize) -> impl Iterator<Item = (usize, f64)> {
    let state = jacobian.state.row(row).iter().copied();
    state.chain(jacobian.calibration.row(row).iter().map(move |&(parameter, weight)| (m + parameter, weight)))
}

/// P Hᵀ for a symmetric P, `[m + p, n]`.
fn cross_covariance(covariance: MatRef<'_, f64>, jacobian: &BlockAngular, m: usize) -> Mat<f64> {
    let mut cross = Mat::zeros(covariance.nrows(), jacobian.rows());
    for row in 0..jacobian.rows() {
        for (column, weight) in entries(jacobian, row, m) {
            let source = covariance.col(column).try_as_col_major().expect("columns are contiguous").as_slice();
            for (value, source) in cross.col_as_slice_mut(row).iter_mut().zip(source) {
                *value += weight * source;
            }
        }
    }
    cross
}

/// H P Hᵀ + R from P Hᵀ.
fn innovation_covariance(cross: MatRef<'_, f64>, jacobian: &BlockAngular, variance: &[f64], m: usize) -> Mat<f64> {
    let n = variance.len();
    Mat::from_fn(n, n, |i, j| {
        let covariance: f64 = entries(jacobian, i, m).map(|(column, weight)| weight * cross[(column, j)]).sum();
        covariance + if i == j { variance[i] } else { 0.0 }
    })
}

fn check_memory(problem: &Problem, size: usize) -> Result<(), Error> {
    // P, Q, the propagator A and two products of the same size.
    let needed_bytes = 5 * 8 * (size as u64).pow(2);
    if needed_bytes > problem.memory_limit_bytes {
        return Err(Error::TooLarge {
            what: format!("the dense Kalman filter for {size} unknowns"),
            needed_bytes,
            limit_bytes: problem.memory_limit_bytes,
        });
    }
    Ok(())
}
