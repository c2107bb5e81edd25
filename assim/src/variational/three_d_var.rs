//! 3D-Var with the biases in the control vector.

use super::conjugate_gradient::{self, Stopping};
use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::covariance::Covariance;
use crate::error::Error;
use crate::linalg::{cholesky, column, product};
use crate::problem::{Innovations, Problem};
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes};
use crate::spread::standard_deviations;
use faer::Mat;
use isobar_model::{Duration, State, forecast};
use isobar_obs::{Calibration, ObservationWindow};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How 3D-Var is tuned.
#[derive(Clone, Debug, PartialEq)]
pub struct ThreeDVarSettings {
    /// Factor on the covariance B of the problem.
    pub covariance_scale: f64,
    /// The minimiser stops when the gradient's norm has fallen by this factor,
    pub tolerance: f64,
    /// or after so many iterations.
    pub max_iterations: usize,
}

/// Minimises, each cycle anew with the static B = s U Uᵀ,
///
/// ```text
/// J(χ, β) = ½ χᵀχ + ½ βᵀβ + ½ |R^-½ (d − H √s U χ − G L β)|²,       δx = √s U χ,   δc = L β,   L Lᵀ = P_c
/// ```
///
/// by conjugate gradients on the Hessian I + KᵀK, K = R^-½ \[H √s U, G L\]. The covariance of the biases is carried from
/// cycle to cycle: its analysis is the β block of the inverse Hessian, by one solution for each parameter; their
/// errors' correlation with the state's is dropped, because B is static. 2 J at the minimum is the normalised
/// innovation squared. With a complete minimisation this is optimal interpolation (Lorenc 1986); biases in the control
/// vector: Derber and Wu (1998), Dee (2005).
pub struct ThreeDVar {
    problem: Problem,
    settings: ThreeDVarSettings,
    calibration: Calibration,
    state: State,
    bias: Vec<f64>,
    /// P_c, `[p, p]`.
    bias_covariance: Mat<f64>,
}

impl ThreeDVar {
    /// 3D-Var from the background.
    pub fn new(problem: Problem, settings: ThreeDVarSettings) -> Self {
        let calibration = problem.estimated_calibration();
        let p = calibration.len();
        let bias_covariance =
            Mat::from_fn(p, p, |i, j| if i == j { calibration.parameters[i].sigma_prior.powi(2) } else { 0.0 });
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        Self { problem, settings, calibration, state, bias, bias_covariance }
    }

    /// Replaces the covariance B of the problem.
    pub(super) fn set_background_error(&mut self, background_error: Arc<dyn Covariance>) {
        self.problem.background_error = background_error;
    }

    fn estimate(&self) -> Result<Estimate, Error> {
        let variances: Vec<f64> = (0..self.calibration.len()).map(|i| self.bias_covariance[(i, i)]).collect();
        let spread = standard_deviations(&variances, "the covariance of the calibration parameters", |i| {
            self.calibration.parameters[i].name.clone()
        })?;
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: None,
            calibration_spread: (!self.calibration.is_empty()).then_some(spread),
        })
    }
}

impl Assimilator for ThreeDVar {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        forecast::forecast(&*self.problem.model, &mut self.state, self.problem.steps(window)?)?;
        for (i, parameter) in self.calibration.parameters.iter().enumerate() {
            self.bias_covariance[(i, i)] += parameter.sigma_drift_per_sqrt_day.powi(2) * window.days();
        }
        self.estimate()
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        let bias_root =
            cholesky(self.bias_covariance.clone(), || "the covariance of the calibration parameters".into())?;
        let control = ControlSpace {
            problem: &self.problem,
            innovations: &innovations,
            covariance_scale: self.settings.covariance_scale,
            bias_root: &bias_root,
        };
        let stopping = Stopping { tolerance: self.settings.tolerance, max_iterations: self.settings.max_iterations };
        let solve = |right: &[f64]| {
            conjugate_gradient::solve(right, stopping, |direction, image| control.hessian(direction, image))
        };
        let (n_state, p) = (control.state_len(), self.calibration.len());

        let whitened = control.whiten(innovations.departures.clone());
        let right = control.multiply_transposed(&whitened);
        let minimum = solve(&right);
        let innovation_chi2 = dot(&whitened, &whitened) - dot(&right, &minimum);
        let (state_increment, bias_increment) = control.increments(&minimum);

        let posterior: Vec<Vec<f64>> = (0..p)
            .into_par_iter()
            .map(|parameter| {
                let mut unit = vec![0.0; n_state + p];
                unit[n_state + parameter] = 1.0;
                solve(&unit).split_off(n_state)
            })
            .collect();

        self.state.values_mut().iter_mut().zip(&state_increment).for_each(|(value, change)| *value += change);
        self.bias.iter_mut().zip(&bias_increment).for_each(|(value, change)| *value += change);
        let whitened_posterior = Mat::from_fn(p, p, |i, j| 0.5 * (posterior[j][i] + posterior[i][j]));
        let left = product(bias_root.as_ref(), whitened_posterior.as_ref());
        self.bias_covariance = product(left.as_ref(), bias_root.transpose());

        let estimate = self.estimate()?;
        Ok(self.problem.analysis(observed, innovations, estimate, innovation_chi2))
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&Saved {
            state: self.state.values().to_vec(),
            bias: self.bias.clone(),
            bias_covariance: (&self.bias_covariance).into(),
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let Saved { state, bias, bias_covariance } = from_bytes(saved)?;
        restore_state(&mut self.state, &state)?;
        restore_bias(&mut self.bias, &bias)?;
        let p = self.calibration.len();
        self.bias_covariance = bias_covariance.restored(p, Some(p), "the covariance of the calibration")?;
        Ok(())
    }
}

/// What a checkpoint holds of the method.
#[derive(Serialize, Deserialize)]
struct Saved {
    state: Vec<f64>,
    bias: Vec<f64>,
    bias_covariance: Matrix,
}

/// The control vector (χ, β) and the operator K that takes it to whitened observations.
struct ControlSpace<'a> {
    problem: &'a Problem,
    innovations: &'a Innovations,
    covariance_scale: f64,
    /// L.
    bias_root: &'a Mat<f64>,
}

impl ControlSpace<'_> {
    fn state_len(&self) -> usize {
        self.problem.background_error.control_len()
    }

    /// R^-½ d.
    fn whiten(&self, mut departures: Vec<f64>) -> Vec<f64> {
        departures.iter_mut().zip(&self.innovations.variance).for_each(|(value, variance)| *value /= variance.sqrt());
        departures
    }

    /// (δx, δc) of a control vector.
    fn increments(&self, control: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (chi, beta) = control.split_at(self.state_len());
        let mut dx = vec![0.0; self.problem.background_error.len()];
        self.problem.background_error.root_add(chi, &mut dx);
        let scale = self.covariance_scale.sqrt();
        dx.iter_mut().for_each(|value| *value *= scale);
        let dc = product(self.bias_root.as_ref(), column(beta).as_ref());
        (dx, dc.col_as_slice(0).to_vec())
    }

    /// Kᵀ y.
    fn multiply_transposed(&self, whitened: &[f64]) -> Vec<f64> {
        let n_state = self.state_len();
        let weighted = self.whiten(whitened.to_vec());
        let mut dx = vec![0.0; self.problem.background_error.len()];
        let mut dc = vec![0.0; self.bias_root.nrows()];
        self.innovations.jacobian.apply_ad(&weighted, &mut dx, &mut dc);
        let scale = self.covariance_scale.sqrt();
        dx.iter_mut().for_each(|value| *value *= scale);
        let mut control = vec![0.0; n_state];
        self.problem.background_error.root_transpose_add(&dx, &mut control);
        let beta = product(self.bias_root.transpose(), column(&dc).as_ref());
        control.extend_from_slice(beta.col_as_slice(0));
        control
    }

    /// (I + KᵀK) v.
    fn hessian(&self, control: &[f64], image: &mut [f64]) {
        let (dx, dc) = self.increments(control);
        let whitened = self.whiten(self.innovations.jacobian.apply(&dx, &dc));
        let curved = self.multiply_transposed(&whitened);
        for (image, (own, curved)) in image.iter_mut().zip(control.iter().zip(curved)) {
            *image = own + curved;
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
