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
//!
//! With r further factors (WO 97/18442) what the blocks' errors have in common is kept, as far as r directions can: the
//! leading directions of B at the start, and in each forecast those of A Φ_b and of Q together. What a compression
//! leaves over joins the C_k as a block diagonal, so that every block keeps its own covariance. The C_k then hold only
//! a nearly white residual, which need not be propagated exactly: see [`Residual`].

mod analysis;
mod blocks;
mod compression;
mod factored_covariance;
mod forecast;
mod residual;
mod structure;

pub use blocks::BlockShape;

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::block_angular::{self, Block, Prior};
use crate::covariance::{self, Covariance};
use crate::error::Error;
use crate::linalg::add_symmetric_product;
use crate::problem::Problem;
use crate::propagator::propagator;
use crate::spread::standard_deviations;
use crate::structure::Structure;
use blocks::Blocks;
use compression::{Joining, join_and_compress};
use factored_covariance::{FactoredCovariance, Patch};
use faer::{Mat, MatRef};
use isobar_model::forecast::forecast_tl;
use isobar_model::{Duration, Layout, State, random};
use isobar_obs::{ObservationWindow, Placement};
use rand_chacha::ChaCha8Rng;
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
    /// Common factors beside those of the shared parameters.
    pub factors: usize,
    /// The forecast of the blocks.
    pub residual: Residual,
}

/// How the block-diagonal part C_k of the covariance is forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Residual {
    /// `Σ_j A_kj C_j A_kjᵀ`, with the propagator as a matrix: for small grids.
    Exact,
    /// C_k stays as it is.
    Persist,
    /// ρ_i ρ_j C_k, where ρ is how much of its standard deviation each variable keeps, as so many random draws from
    /// N(0, blkdiag(C_k)) show that ride along with the factors.
    Probe {
        /// Number of draws.
        count: usize,
    },
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
    model_error: ModelError,
    /// The scale of each block variable in the norm by which factors are compressed: its standard deviation in B.
    scales: Vec<f64>,
    /// Draws the probes.
    random: ChaCha8Rng,
}

/// Q of the state's values as F_Q F_Qᵀ + blkdiag(Q_k).
struct ModelError {
    factors: Mat<f64>,
    /// Q_k; none for a perfect model.
    blocks: Vec<Mat<f64>>,
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
        check_settings(&problem, &blocks, settings)?;
        let sigma_prior = |number: usize| parameters[number].sigma_prior;
        let (m, p) = (layout.len(), shared.len());
        let mut scales = state_scales(&*problem.background_error, &layout);
        scales.extend(local.iter().map(|&number| sigma_prior(number)));
        let mut random = random::stream(0, "fast kalman filter");
        let split = |operator: &dyn Covariance, random: &mut ChaCha8Rng| {
            split(operator, &blocks, &scales[..m], settings.factors, random)
        };

        let (background_factors, background_blocks) = split(&*problem.background_error, &mut random);
        let patches = background_blocks.into_iter().zip(&blocks.members).map(|(state_part, variables)| {
            let on_grid = state_part.nrows();
            let mut covariance = Mat::zeros(variables.len(), variables.len());
            covariance.as_mut().get_mut(..on_grid, ..on_grid).copy_from(state_part);
            for position in on_grid..variables.len() {
                covariance[(position, position)] = sigma_prior(local[variables[position] - m]).powi(2);
            }
            Patch { variables: variables.clone(), covariance }
        });
        let r = background_factors.ncols();
        let mut block_factors = Mat::zeros(blocks.variables(), p + r);
        block_factors.as_mut().get_mut(..m, p..).copy_from(background_factors);
        let shared_factors = Mat::from_fn(p, p + r, |i, j| if i == j { sigma_prior(shared[i]) } else { 0.0 });
        let covariance = FactoredCovariance { patches: patches.collect(), block_factors, shared_factors };

        let (factors, model_error_blocks) = match problem.model_error.as_deref() {
            Some(model_error) => split(model_error, &mut random),
            None => (Mat::zeros(m, 0), Vec::new()),
        };
        let model_error = ModelError { factors, blocks: model_error_blocks };
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        Ok(Self { problem, settings, blocks, local, shared, state, bias, covariance, model_error, scales, random })
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

    fn estimate(&self) -> Result<Estimate, Error> {
        let m = self.state.values().len();
        let place = |variable: usize| match variable < m {
            true => format!("{} (block {})", self.state.layout().describe(variable), self.blocks.place[variable].0),
            false => self.problem.calibration.parameters[self.local[variable - m]].name.clone(),
        };
        let variances = self.covariance.block_variances();
        let mut spread = standard_deviations(&variances, "the covariance of the blocks", place)?;
        let mut calibration_spread = vec![0.0; self.local.len() + self.shared.len()];
        for (&number, sigma) in self.local.iter().zip(spread.split_off(m)) {
            calibration_spread[number] = sigma;
        }
        // Sums of squares, none of which can be negative.
        for (&number, variance) in self.shared.iter().zip(&self.covariance.shared_variances()) {
            calibration_spread[number] = variance.sqrt();
        }
        Ok(Estimate {
            state: self.state.clone(),
            calibration: self.bias.clone(),
            state_spread: Some(spread),
            calibration_spread: (!calibration_spread.is_empty()).then_some(calibration_spread),
        })
    }

    /// Standard deviations of what the parameters' random walks add over a window.
    fn drift(&self, numbers: &[usize], window: Duration) -> Vec<f64> {
        let parameters = &self.problem.calibration.parameters;
        numbers.iter().map(|&number| parameters[number].sigma_drift_per_sqrt_day * window.days().sqrt()).collect()
    }

    /// Forecasts state, factors and blocks.
    fn propagate(&mut self, window: Duration) -> Result<(), Error> {
        let steps = self.problem.steps(window)?;
        let m = self.state.values().len();
        let covariance = &mut self.covariance;
        if self.settings.residual == Residual::Exact {
            let a = propagator(&*self.problem.model, &mut self.state, steps)?;
            let a = MatRef::from_column_major_slice(&a, m, m);
            covariance.patches = forecast::propagate_blocks(a, &covariance.patches, &self.blocks);
            forecast::propagate_factors(a, &mut covariance.block_factors);
            return Ok(());
        }
        covariance.patches = residual::return_to_blocks(&covariance.patches, &self.blocks);
        let count = if let Residual::Probe { count } = self.settings.residual { count } else { 0 };
        let probes = residual::draw_probes(&covariance.patches, m, count, &mut self.random);
        let r = covariance.block_factors.ncols();
        let mut columns = Vec::with_capacity(m * r + probes.len());
        (0..r).for_each(|j| columns.extend_from_slice(&covariance.block_factors.col_as_slice(j)[..m]));
        columns.extend_from_slice(&probes);
        forecast_tl(&*self.problem.model, &mut self.state, &mut columns, steps)?;
        for (j, column) in columns.chunks_exact(m).take(r).enumerate() {
            covariance.block_factors.col_as_slice_mut(j)[..m].copy_from_slice(column);
        }
        if count > 0 {
            let layout = self.state.layout();
            let persistence = residual::persistence(layout, &probes, &columns[m * r..]);
            residual::scale(&mut covariance.patches, layout, &persistence);
        }
        Ok(())
    }

    /// Adds what a window adds to the covariance: model error and the parameters' random walks.
    fn add_errors(&mut self, window: Duration) -> Result<(), Error> {
        let m = self.state.values().len();
        let (local_drift, shared_drift) = (self.drift(&self.local, window), self.drift(&self.shared, window));
        let covariance = &mut self.covariance;
        for (patch, model_error) in covariance.patches.iter_mut().zip(&self.model_error.blocks) {
            let on_grid = model_error.nrows();
            let mut grid_part = patch.covariance.as_mut().get_mut(..on_grid, ..on_grid);
            grid_part += model_error;
        }
        for (number, sigma) in local_drift.iter().enumerate() {
            let (block, position) = self.blocks.place[m + number];
            covariance.patches[block].covariance[(position, position)] += sigma * sigma;
        }
        if self.settings.bias_coupling == BiasCoupling::Drop {
            return forecast::drop_coupling(covariance, &shared_drift, &self.blocks);
        }
        let joining = Joining { model_error: self.model_error.factors.as_ref(), drift: &shared_drift };
        join_and_compress(covariance, &joining, self.settings.factors, &self.scales, &self.blocks);
        Ok(())
    }
}

impl Assimilator for FastKalmanFilter {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        self.propagate(window)?;
        self.add_errors(window)?;
        self.estimate()
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
        let r = self.covariance.block_factors.ncols();
        let prior = Prior { mean: vec![0.0; r], covariance: Mat::identity(r, r) };
        let solution = block_angular::solve(&updates, r, Some(&prior))?;
        let innovation_chi2 = solution.residual_chi2;
        self.apply(&components, variables, solution)?;
        let estimate = self.estimate()?;
        let analysis_departures = self.problem.departures(observed, &estimate.state, &estimate.calibration);
        Ok(Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2),
            partition: Some(partition),
        })
    }

    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Option<Structure> {
        Some(self.structure_after(observed, factors))
    }
}

/// A covariance of states as its leading factors, and the blocks of the rest.
fn split(
    operator: &dyn Covariance,
    blocks: &Blocks,
    scales: &[f64],
    rank: usize,
    random: &mut ChaCha8Rng,
) -> (Mat<f64>, Vec<Mat<f64>>) {
    let m = operator.len();
    let factors = match rank {
        0 => Mat::zeros(m, 0),
        _ => covariance::leading_factors(operator, scales, rank, random),
    };
    let rest = |variables: &Vec<usize>| {
        let own = &variables[..variables.partition_point(|&variable| variable < m)];
        let rows = Mat::from_fn(own.len(), factors.ncols(), |i, j| factors[(own[i], j)]);
        let mut rest = covariance::block(operator, own);
        add_symmetric_product(rest.as_mut(), -1.0, rows.as_ref(), rows.transpose());
        rest
    };
    let rests = blocks.members.iter().map(rest).collect();
    (factors, rests)
}

/// The standard deviation of each variable in the middle of the domain, for every value of the state.
fn state_scales(operator: &dyn Covariance, layout: &Layout) -> Vec<f64> {
    let (cells, grid) = (layout.grid.cells(), &layout.grid);
    let middle = grid.ny / 2 * grid.nx + grid.nx / 2;
    let scale = |variable: usize| {
        let variance = covariance::block(operator, &[variable * cells + middle])[(0, 0)];
        if variance > 0.0 { variance.sqrt() } else { 1.0 }
    };
    (0..layout.variables.len()).flat_map(|variable| std::iter::repeat_n(scale(variable), cells)).collect()
}

fn check_settings(problem: &Problem, blocks: &Blocks, settings: FastKalmanSettings) -> Result<(), Error> {
    let (m, b, r) = (problem.background.values().len() as u64, blocks.variables() as u64, settings.factors as u64);
    if r > b {
        return Err(Error::Setting(format!("{r} common factors are more than the {b} variables they describe")));
    }
    if r > 0 && settings.bias_coupling == BiasCoupling::Drop {
        return Err(Error::Setting("the printed formulae (28)/(29), which drop the coupling, have no factors".into()));
    }
    let own: u64 = blocks.members.iter().map(|variables| (variables.len() as u64).pow(2)).sum();
    // The blocks before and after, and Q; the factors, their forecast with those of Q, and both rotated.
    let mut needed_bytes = 8 * (3 * own + 6 * b * r);
    if settings.residual == Residual::Exact {
        // The propagator A, and A C as products and as a whole.
        needed_bytes += 8 * (m * m + 2 * m * b);
    }
    if needed_bytes > problem.memory_limit_bytes {
        let what = format!("the covariance of {b} unknowns in {} blocks with {r} factors", blocks.members.len());
        return Err(Error::TooLarge { what, needed_bytes, limit_bytes: problem.memory_limit_bytes });
    }
    Ok(())
}
