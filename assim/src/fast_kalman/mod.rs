//! The Fast Kalman Filter: the recursion (26)–(29) of WO 93/22625 on the blocks of a grid.
//!
//! The covariance of all errors is kept as a block-diagonal part and a few common factors that carry the shared
//! calibration parameters c and what the blocks' errors have in common with them:
//!
//! ```text
//! Cov(b, c) = blkdiag(C_1 … C_K, 0) + Φ Φᵀ,     Φ = [Φ_b; Φ_c]
//! ```
//!
//! Analysis: the block-angular regression with X_k = H_k on β_k ~ N(0, C_k) and the factors' amplitudes ξ ~ N(0, I) as
//! border, G_k := H_k Φ_b + G_k Φ_c. With its results, `b̂ = b~ + β̂ + Φ_b ξ̂`, `ĉ = c~ + Φ_c ξ̂`,
//! `Φ ← [Φ_b − D; Φ_c] S^½`: exactly the Kalman filter's analysis for this covariance. Forecast: P_k = Σ_j A_kj C_j A_kjᵀ
//! + Q_k and Φ_b ← A Φ_b; what the blocks' errors get in common beyond the factors is dropped.

mod analysis;
mod blocks;
mod factored_covariance;
mod forecast;

pub use blocks::BlockShape;

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::block_angular::{self, Block, Prior};
use crate::covariance;
use crate::error::Error;
use crate::linalg::{cholesky, product};
use crate::problem::Problem;
use crate::propagator::propagator;
use blocks::Blocks;
use factored_covariance::{FactoredCovariance, Patch};
use faer::{Mat, MatRef};
use isobar_model::{Duration, State};
use isobar_obs::{ObservationWindow, Placement};
use rayon::prelude::*;

/// What becomes of the covariance of the blocks' errors with those of c in a forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasCoupling {
    /// It is propagated as common factors, Φ_b ← A Φ_b (Friedland's separate-bias filter).
    Carry,
    /// It is dropped, as the printed formulae (28)/(29) do: only its block diagonal stays, in P_k.
    Drop,
}

/// How the filter is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FastKalmanSettings {
    /// The blocks.
    pub blocks: BlockShape,
    /// The covariance of blocks and shared parameters.
    pub bias_coupling: BiasCoupling,
}

/// The Fast Kalman Filter.
pub struct FastKalmanFilter {
    problem: Problem,
    settings: FastKalmanSettings,
    blocks: Blocks,
    /// Numbers of the local parameters in the calibration, in the order of their block variables.
    local: Vec<usize>,
    /// Numbers of the shared parameters, in the order of the border.
    shared: Vec<usize>,
    state: State,
    bias: Vec<f64>,
    covariance: FactoredCovariance,
    /// Q_k of the state's values.
    model_error: Option<Vec<Mat<f64>>>,
}

impl FastKalmanFilter {
    /// A filter that starts from the background, whose error covariance it truncates to the blocks.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the propagator and the blocks do not fit into the memory limit.
    pub fn new(problem: Problem, settings: FastKalmanSettings) -> Result<Self, Error> {
        let layout = problem.background.layout().clone();
        let parameters = problem.estimated_calibration().parameters;
        let (mut local, mut shared, mut local_cells) = (Vec::new(), Vec::new(), Vec::new());
        for (number, parameter) in parameters.iter().enumerate() {
            match parameter.placement {
                Placement::Shared => shared.push(number),
                Placement::Local { x_m, y_m } => {
                    local.push(number);
                    local_cells.push(layout.grid.cell_at(x_m, y_m));
                }
            }
        }
        let blocks = Blocks::new(&layout, settings.blocks, &local_cells);
        check_memory(&problem, &blocks)?;
        let sigma_prior = |number: usize| parameters[number].sigma_prior;
        let m = layout.len();
        let patches = state_blocks(&*problem.background_error, &blocks, m)
            .into_iter()
            .zip(&blocks.members)
            .map(|(state_part, variables)| {
                let on_grid = state_part.nrows();
                let mut covariance = Mat::zeros(variables.len(), variables.len());
                covariance.as_mut().get_mut(..on_grid, ..on_grid).copy_from(state_part);
                for position in on_grid..variables.len() {
                    covariance[(position, position)] = sigma_prior(local[variables[position] - m]).powi(2);
                }
                Patch { variables: variables.clone(), covariance }
            })
            .collect();
        let shared_factors =
            Mat::from_fn(shared.len(), shared.len(), |i, j| if i == j { sigma_prior(shared[i]) } else { 0.0 });
        let covariance =
            FactoredCovariance { patches, block_factors: Mat::zeros(blocks.variables(), shared.len()), shared_factors };
        let model_error = problem.model_error.as_deref().map(|model_error| state_blocks(model_error, &blocks, m));
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        Ok(Self { problem, settings, blocks, local, shared, state, bias, covariance, model_error })
    }

    /// The covariance of the errors of (state, calibration) as a dense matrix in that order, for tests and for queries
    /// on small problems.
    pub fn dense_covariance(&self) -> Mat<f64> {
        let m = self.state.values().len();
        let own = self.covariance.dense();
        let mut position = vec![0; m + self.local.len() + self.shared.len()];
        (0..m).for_each(|i| position[i] = i);
        self.local.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + i);
        self.shared.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + self.local.len() + i);
        Mat::from_fn(position.len(), position.len(), |i, j| own[(position[i], position[j])])
    }

    fn estimate(&self) -> Estimate {
        let m = self.state.values().len();
        let sigma = |variance: &f64| variance.max(0.0).sqrt();
        let variances = self.covariance.block_variances();
        let mut calibration_spread = vec![0.0; self.local.len() + self.shared.len()];
        for (&number, variance) in self.local.iter().zip(&variances[m..]) {
            calibration_spread[number] = sigma(variance);
        }
        for (&number, variance) in self.shared.iter().zip(&self.covariance.shared_variances()) {
            calibration_spread[number] = sigma(variance);
        }
        Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: Some(variances[..m].iter().map(sigma).collect()),
            calibration_spread: (!calibration_spread.is_empty()).then_some(calibration_spread),
        }
    }

    /// Standard deviations of what the parameters' random walks add over a window.
    fn drift(&self, numbers: &[usize], window: Duration) -> Vec<f64> {
        let parameters = &self.problem.calibration.parameters;
        numbers.iter().map(|&number| parameters[number].sigma_drift_per_sqrt_day * window.days().sqrt()).collect()
    }

    fn forecast_covariance(&mut self, a: MatRef<'_, f64>, window: Duration) -> Result<(), Error> {
        let m = a.nrows();
        let (local_drift, shared_drift) = (self.drift(&self.local, window), self.drift(&self.shared, window));
        let covariance = &mut self.covariance;
        covariance.patches = forecast::propagate_blocks(a, &covariance.patches, &self.blocks);
        for (block, patch) in covariance.patches.iter_mut().enumerate() {
            if let Some(model_error) = &self.model_error {
                let on_grid = model_error[block].nrows();
                let mut grid_part = patch.covariance.as_mut().get_mut(..on_grid, ..on_grid);
                grid_part += &model_error[block];
            }
        }
        for (number, sigma) in local_drift.iter().enumerate() {
            let (block, position) = self.blocks.place[m + number];
            covariance.patches[block].covariance[(position, position)] += sigma * sigma;
        }
        forecast::propagate_factors(a, &mut covariance.block_factors);
        match self.settings.bias_coupling {
            BiasCoupling::Carry => forecast::add_shared_drift(covariance, &shared_drift, &self.blocks),
            BiasCoupling::Drop => {
                let factors = covariance.block_factors.as_ref();
                forecast::add_block_diagonal(&mut covariance.patches, factors, &self.blocks);
                covariance.block_factors = Mat::zeros(self.blocks.variables(), self.shared.len());
                let mut shared = product(covariance.shared_factors.as_ref(), covariance.shared_factors.transpose());
                for (i, sigma) in shared_drift.iter().enumerate() {
                    shared[(i, i)] += sigma * sigma;
                }
                covariance.shared_factors =
                    cholesky(shared, || "the covariance of the shared calibration parameters".into())?;
            }
        }
        Ok(())
    }
}

impl Assimilator for FastKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        let steps = self.problem.steps(window)?;
        let a = propagator(&*self.problem.model, &mut self.state, steps)?;
        let m = self.state.values().len();
        self.forecast_covariance(MatRef::from_column_major_slice(&a, m, m), window)?;
        Ok(self.estimate())
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let innovations = self.problem.innovations(observed, &self.state, &self.bias)?;
        let rows = self.split_rows(&innovations);
        let touched: Vec<Vec<usize>> = (0..rows.block.rows())
            .map(|row| rows.block.row(row).iter().map(|&(variable, _)| self.blocks.place[variable].0).collect())
            .collect();
        let components = block_angular::components(self.blocks.members.len(), &touched);
        let partition = self.report(&components);
        for component in &components {
            self.check_component(component)?;
        }
        let updates: Vec<(Vec<usize>, Block)> =
            components.par_iter().map(|component| self.update_rows(component, &rows, &innovations)).collect();
        let (variables, updates): (Vec<_>, Vec<_>) = updates.into_iter().unzip();
        let r = self.shared.len();
        let prior = Prior { mean: vec![0.0; r], covariance: Mat::identity(r, r) };
        let solution = block_angular::solve(&updates, r, Some(&prior))?;
        let innovation_chi2 = solution.residual_chi2;
        self.apply(&components, variables, solution)?;
        let estimate = self.estimate();
        let analysis_departures = self.problem.departures(observed, &estimate.state, &estimate.calibration);
        Ok(Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2),
            partition: Some(partition),
        })
    }
}

/// The blocks of a covariance of states.
fn state_blocks(operator: &dyn covariance::Covariance, blocks: &Blocks, m: usize) -> Vec<Mat<f64>> {
    let state_part = |variables: &Vec<usize>| {
        covariance::block(operator, &variables[..variables.partition_point(|&variable| variable < m)])
    };
    blocks.members.iter().map(state_part).collect()
}

fn check_memory(problem: &Problem, blocks: &Blocks) -> Result<(), Error> {
    let (m, b) = (problem.background.values().len() as u64, blocks.variables() as u64);
    let own: u64 = blocks.members.iter().map(|variables| (variables.len() as u64).pow(2)).sum();
    // The propagator A, A C as products and as a whole; the blocks before and after, and Q.
    let needed_bytes = 8 * (m * m + 2 * m * b + 3 * own);
    if needed_bytes > problem.memory_limit_bytes {
        return Err(Error::TooLarge {
            what: format!("the propagator and the blocks for {b} unknowns"),
            needed_bytes,
            limit_bytes: problem.memory_limit_bytes,
        });
    }
    Ok(())
}
