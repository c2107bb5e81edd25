//! 3D-Var with the biases in the control vector.

use super::bias_information::BiasInformation;
use super::conjugate_gradient::{Stopping, minimise};
use super::control_space::{self, ControlSpace};
use super::convergence::Convergence;
use crate::assimilator::{Adjustments, Assimilator, Views};
use crate::calibrated_state::CalibratedState;
use crate::covariance::Covariance;
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::linalg::squared_norm;
use crate::memory::{read, write};
use crate::problem::{Innovations, Problem};
use isobar_model::vector::add;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use rayon::prelude::*;
use std::io::{Read, Write};
use std::sync::Arc;

/// How 3D-Var is tuned.
#[derive(Clone, Debug, PartialEq)]
pub struct ThreeDVarSettings {
    /// Factor on the covariance B of the problem.
    pub covariance_scale: f64,
    /// The minimiser stops when the gradient's norm has fallen by this factor.
    pub tolerance: f64,
    /// The largest number of iterations.
    pub max_iterations: usize,
}

/// Minimises, each cycle anew with the static B = s U Uᵀ,
///
/// ```text
/// J(χ, β) = ½ χᵀχ + ½ βᵀβ + ½ |R^-½ (d − H √s U χ − G L β)|²,       δx = √s U χ,   δc = L β,   L Lᵀ = P_c
/// ```
///
/// by conjugate gradients on the Hessian I + KᵀK, K = R^-½ \[H √s U, G L\]. The covariance of the biases is carried from
/// cycle to cycle: its analysis, the block of the inverse Hessian, follows from the information on the biases, by one
/// solution for each of them in the space of the observations; their errors' correlation with the state's is dropped, because
/// B is static. 2 J at the minimum, a sum of squares, is the
/// normalised innovation squared. With a complete minimisation this is optimal interpolation (Lorenc 1986); biases in the control
/// vector: Derber and Wu (1998), Dee (2005).
#[derive(Clone)]
pub struct ThreeDVar {
    problem: Problem<dyn Model>,
    settings: ThreeDVarSettings,
    /// Another factor of B, that others may change.
    error_factor: f64,
    present: CalibratedState,
    convergence: Convergence,
}

impl ThreeDVar {
    /// 3D-Var from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the analysis of the most observations does not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn Model>>, settings: ThreeDVarSettings) -> Result<Self, Error> {
        let problem = problem.into();
        check_memory(&problem, problem.background_error.control_len(), problem.most_observations)?;
        let present = CalibratedState::new(&problem)?;
        Ok(Self { present, problem, settings, error_factor: 1.0, convergence: Convergence::default() })
    }

    /// Replaces the covariance B of the problem.
    pub(super) fn set_background_error(&mut self, background_error: Arc<dyn Covariance>) {
        self.problem.background_error = background_error;
    }
}

impl Assimilator for ThreeDVar {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.present.forecast(&*self.problem.model, window)?;
        Ok(Background { estimate: self.present.estimate(None)?, window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        check_memory(&self.problem, self.problem.background_error.control_len(), observed.len())?;
        let innovations = self.problem.innovations(observed, &self.present.s.state, &self.present.s.bias)?;
        let background_error = &*self.problem.background_error;
        let scale = self.settings.covariance_scale * self.error_factor;
        let control = ControlSpace::new(background_error, scale, &self.present.bias_covariance)?;
        let cost = Cost { control: &control, innovations: &innovations };
        let whitened = innovations.whiten(innovations.departures.clone());
        let right = cost.multiply_transposed(&whitened);
        let stopping = Stopping { tolerance: self.settings.tolerance, max_iterations: self.settings.max_iterations };
        let minimum = minimise(right, whitened.len(), stopping, |direction| cost.hessian(direction));
        let information = BiasInformation::new(std::slice::from_ref(&innovations), &control, stopping, |vectors| {
            vectors.par_iter().map(|whitened| cost.multiply_state(whitened)).collect()
        });
        self.convergence.add(minimum.ending, &information.endings);
        let (state_increment, bias_increment) = control.increments(&minimum.values);
        let fitted = innovations.whiten(innovations.jacobian.apply(&state_increment, &bias_increment));
        let misfit: f64 = whitened.iter().zip(fitted).map(|(d, fitted)| (d - fitted).powi(2)).sum();
        let innovation_chi2 = self.convergence.reached().then(|| misfit + squared_norm(&minimum.values));
        let bias_covariance = control.bias_covariance(&information.matrix)?;
        self.present.add(&state_increment, &bias_increment);
        self.present.bias_covariance = bias_covariance.into();
        let analysis = self.problem.analysis(observed, innovations, self.present.estimate(None)?, innovation_chi2);
        Ok(Analysis { warnings: self.convergence.warning().into_iter().collect(), ..analysis })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&(&self.present, &self.convergence), to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let (present, convergence): (CalibratedState, Convergence) = read(from)?;
        present.require_like(&self.present)?;
        (self.present, self.convergence) = (present, convergence);
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views { calibration: self.present.view(), parameters: Some(&self.convergence), ..Views::default() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        Adjustments { calibration: self.present.adjustment(), error_factor: Some(&mut self.error_factor) }
    }
}

/// The quadratic cost: K takes a control vector to whitened observations.
struct Cost<'a> {
    control: &'a ControlSpace<'a>,
    innovations: &'a Innovations,
}

impl Cost<'_> {
    /// Kᵀ y.
    fn multiply_transposed(&self, whitened: &[f64]) -> Vec<f64> {
        let weighted = self.innovations.whiten(whitened.to_vec());
        let (mut dx, mut dc) = (vec![0.0; self.control.state_values()], vec![0.0; self.control.parameters()]);
        self.innovations.jacobian.apply_ad(&weighted, &mut dx, &mut dc);
        self.control.controls(&dx, &dc)
    }

    /// K_x K_xᵀ y, of the state alone.
    fn multiply_state(&self, whitened: &[f64]) -> Vec<f64> {
        let jacobian = &self.innovations.jacobian.state;
        let mut dx = vec![0.0; self.control.state_values()];
        jacobian.transpose_multiply_add(&self.innovations.whiten(whitened.to_vec()), &mut dx);
        let dx = self.control.state_increment(&self.control.state_control(&dx));
        let mut image = vec![0.0; whitened.len()];
        jacobian.multiply_add(&dx, &mut image);
        self.innovations.whiten(image)
    }

    /// (I + KᵀK) v.
    fn hessian(&self, control: &[f64]) -> Vec<f64> {
        let (dx, dc) = self.control.increments(control);
        let whitened = self.innovations.whiten(self.innovations.jacobian.apply(&dx, &dc));
        let mut image = self.multiply_transposed(&whitened);
        add(&mut image, control);
        image
    }
}

/// Fails unless the minimisation fits into the memory limit; `controls` is the length of χ.
///
/// # Errors
/// [`Error::TooLarge`].
pub(super) fn check_memory(problem: &Problem<dyn Model>, controls: usize, observations: usize) -> Result<(), Error> {
    let (m, p) = (problem.background.values().len(), problem.estimated_calibration().len());
    problem.require_memory(control_space::numbers(controls, m, p, observations), || {
        format!("the minimisation for {controls} control variables, {p} biases and {observations} observations")
    })
}
