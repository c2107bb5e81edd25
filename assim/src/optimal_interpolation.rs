//! Optimal interpolation.

use crate::assimilator::{Adjustments, Assimilator, Views};
use crate::calibrated_state::CalibratedState;
use crate::covariance;
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::linalg::{cholesky, column, product, solve_lower, solve_lower_transposed, squared_norm};
use crate::memory::{read, write};
use crate::problem::{Innovations, Problem};
use crate::spread::standard_deviations;
use faer::Mat;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use rayon::prelude::*;
use std::io::{Read, Write};

/// The best linear estimate with a background covariance s B that never changes (Gandin 1963; Lorenc 1981), in the space
/// of the observations:
///
/// ```text
/// S = s H B Hᵀ + G P_c Gᵀ + R,     δx = s B Hᵀ S⁻¹ d,     δc = P_c Gᵀ S⁻¹ d,     P_c ← P_c − P_c Gᵀ S⁻¹ G P_c
/// ```
///
/// What 3D-Var finds by iteration, found directly; here with the spread that it claims of its analysis.
#[derive(Clone)]
pub struct OptimalInterpolation {
    problem: Problem<dyn Model>,
    covariance_scale: f64,
    /// Another factor of B, that others may change.
    error_factor: f64,
    present: CalibratedState,
    /// √s of the diagonal of B.
    background_spread: Vec<f64>,
}

impl OptimalInterpolation {
    /// Optimal interpolation from the background, with the problem's B times a factor.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the analysis of the most observations does not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn Model>>, covariance_scale: f64) -> Result<Self, Error> {
        let problem = problem.into();
        check_memory(&problem, problem.most_observations)?;
        let mut background_spread = covariance::standard_deviations(&*problem.background_error);
        background_spread.iter_mut().for_each(|sigma| *sigma *= covariance_scale.sqrt());
        let present = CalibratedState::new(&problem)?;
        Ok(Self { problem, covariance_scale, error_factor: 1.0, present, background_spread })
    }

    /// The standard deviations of the background's errors.
    fn background_spread(&self) -> impl Iterator<Item = f64> {
        self.background_spread.iter().map(|sigma| sigma * self.error_factor.sqrt())
    }

    /// s B Hᵀ, `[m, n]`.
    fn cross_covariance(&self, innovations: &Innovations) -> Mat<f64> {
        let (m, n) = (innovations.state_values, innovations.len());
        let columns: Vec<Vec<f64>> = (0..n)
            .into_par_iter()
            .map(|row| {
                let mut unit = vec![0.0; m];
                innovations.jacobian.state.row(row).iter().for_each(|&(index, weight)| unit[index] += weight);
                covariance::multiply(&*self.problem.background_error, &unit)
            })
            .collect();
        let scale = self.covariance_scale * self.error_factor;
        Mat::from_fn(m, n, |i, j| scale * columns[j][i])
    }

    /// P_c Gᵀ, `[p, n]`.
    fn bias_cross_covariance(&self, innovations: &Innovations) -> Mat<f64> {
        let rows = &innovations.jacobian.calibration;
        Mat::from_fn(self.present.parameters(), innovations.len(), |i, row| {
            rows.row(row).iter().map(|&(parameter, weight)| weight * self.present.bias_covariance[(i, parameter)]).sum()
        })
    }
}

impl Assimilator for OptimalInterpolation {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.present.forecast(&*self.problem.model, window)?;
        Ok(Background { estimate: self.present.estimate(Some(self.background_spread().collect()))?, window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        check_memory(&self.problem, observed.len())?;
        let innovations = self.problem.innovations(observed, &self.present.s.state, &self.present.s.bias)?;
        let (cross, bias_cross) = (self.cross_covariance(&innovations), self.bias_cross_covariance(&innovations));
        let n = innovations.len();
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
        self.present.add(state_increment.col_as_slice(0), bias_increment.col_as_slice(0));

        // What the observations took off the variances: the squares of the columns of L⁻¹ H B.
        let mut reduction = cross.transpose().to_owned();
        solve_lower(root.as_ref(), reduction.as_mut());
        let variances: Vec<f64> = self
            .background_spread()
            .enumerate()
            .map(|(i, sigma)| sigma * sigma - squared_norm(reduction.col_as_slice(i)))
            .collect();
        let layout = self.present.s.state.layout();
        let spread = standard_deviations(&variances, "the analysis covariance", |i| layout.describe(i))?;
        let mut reduction = bias_cross.transpose().to_owned();
        solve_lower(root.as_ref(), reduction.as_mut());
        *self.present.bias_covariance -= product(reduction.transpose(), reduction.as_ref());
        let estimate = self.present.estimate(Some(spread))?;
        self.problem.resolved_analysis(observed, innovations, estimate, innovation_chi2)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.present, to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let present: CalibratedState = read(from)?;
        present.require_like(&self.present)?;
        self.present = present;
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views { calibration: self.present.view(), ..Views::default() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        Adjustments { calibration: self.present.adjustment(), error_factor: Some(&mut self.error_factor) }
    }
}

/// s B Hᵀ, its columns before and its transpose after; S; P_c Gᵀ and its transpose; P_c and what is taken off it.
fn check_memory(problem: &Problem<dyn Model>, observations: usize) -> Result<(), Error> {
    let (m, p) = (problem.background.values().len(), problem.estimated_calibration().len());
    let [values, parameters, n] = [m, p, observations].map(|size| size as f64);
    let numbers = 2.0 * n * (values + parameters) + n * n + 2.0 * parameters * parameters;
    problem.require_memory(numbers, || {
        format!("optimal interpolation of {observations} observations to {m} values and {p} biases")
    })
}
