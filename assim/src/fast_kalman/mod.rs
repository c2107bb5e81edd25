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
mod block_diagonal;
mod blocks;
mod calibration;
mod coarse_grid;
mod compression;
mod factored_covariance;
mod factors;
mod forecast;
mod free_columns;
mod nested;
mod query;
mod residual;
mod saved;
mod separation;
mod structure;
pub mod time_volume;

pub use crate::tall_matrix::Precision;
pub use blocks::BlockShape;

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::calibration_accuracy::CalibrationAccuracy;
use crate::covariance::{self, Covariance};
use crate::covariance_column::{CovarianceColumn, Unknown};
use crate::error::Error;
use crate::problem::Problem;
use crate::propagator::propagator;
use crate::spread::standard_deviations;
use crate::structure::Structure;
use crate::tall_matrix::{TallMatrix, stored};
use block_diagonal::BlockDiagonal;
use blocks::Blocks;
use coarse_grid::CoarseGrid;
use compression::{Joining, Kept, join_and_compress};
use factored_covariance::FactoredCovariance;
use factors::Factors;
use faer::{Mat, MatRef};
use free_columns::FreeColumns;
use isobar_model::forecast::forecast_tl;
use isobar_model::{Duration, Layout, State, TangentLinear, random};
use isobar_obs::{ByPlacement, ObservationWindow};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// What becomes of the covariance of the blocks' errors with those of c in a forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasCoupling {
    /// It is propagated as common factors, Φ_b ← A Φ_b (Friedland's separate-bias filter).
    Carry,
    /// It is dropped, as the printed formulae (28)/(29) do: only its block diagonal stays, in P_k.
    Drop,
}

/// How the filter is set up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FastKalmanSettings {
    /// The blocks.
    pub blocks: BlockShape,
    /// The covariance of blocks and shared parameters.
    pub bias_coupling: BiasCoupling,
    /// Common factors beside those of the shared parameters, at most.
    pub factors: usize,
    /// The share of the factors' energy, each variable divided by its scale, for which a forecast keeps the leading
    /// ones; 1 for as many as there may be.
    pub retained_energy: f64,
    /// How the common factors and those of the model error are stored: they take up nearly all of the filter's memory.
    pub factor_precision: Precision,
    /// The forecast of the blocks.
    pub residual: Residual,
    /// Variables of the largest component that observations may merge; a larger one is cut by separators.
    pub largest_component: usize,
    /// The most factors that separators may add to the common ones for an analysis; with more the elimination is nested.
    pub separator_factors: usize,
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
    model_error: Option<ModelError>,
    /// The same times a factor, if it has one.
    adapted_model_error: Option<ModelError>,
    /// The scale of each block variable in the norm by which factors are compressed: its standard deviation in B.
    scales: Vec<f64>,
    /// Draws the probes.
    random: ChaCha8Rng,
    /// Where the factors are propagated, if not on the grid of the state.
    coarse: Option<CoarseGrid>,
    /// The first columns of Φ, if they are not factors but sensitivities to unknowns without a prior.
    free: Option<FreeColumns>,
}

/// Q of the state's values, as far as the filter keeps it.
struct ModelError {
    /// The leading factors F_Q.
    factors: TallMatrix,
    /// All of the blocks Q_k, what F_Q holds of them included.
    blocks: BlockDiagonal,
}

impl ModelError {
    /// That of α Q.
    fn times(&self, factor: f64) -> Self {
        let (mut factors, mut blocks) = (self.factors.clone(), self.blocks.clone());
        factors.scale(factor.sqrt());
        blocks.values_mut().iter_mut().for_each(|value| *value *= factor);
        Self { factors, blocks }
    }
}

impl FastKalmanFilter {
    /// A filter that starts from the background, whose error covariance it truncates to the blocks.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the propagator and the blocks do not fit into the memory limit.
    pub fn new(problem: Problem, settings: FastKalmanSettings) -> Result<Self, Error> {
        let layout = problem.background.layout().clone();
        let calibration = problem.estimated_calibration();
        let ByPlacement { shared, local } = calibration.by_placement();
        let (local, places): (Vec<usize>, Vec<(f64, f64)>) = local.into_iter().unzip();
        let local_cells: Vec<usize> = places.into_iter().map(|(x_m, y_m)| layout.grid.cell_at(x_m, y_m)).collect();
        let blocks = Blocks::new(&layout, settings.blocks, &local_cells);
        check_settings(&problem, &blocks, shared.len() as u64, settings)?;
        let sigma_prior = |number: usize| calibration.parameters[number].sigma_prior;
        let (m, p) = (layout.len(), shared.len());
        let mut scales = state_scales(&*problem.background_error, &layout);
        scales.extend(local.iter().map(|&number| sigma_prior(number)));
        let leading = |operator: &dyn Covariance, random: &mut ChaCha8Rng| match settings.factors {
            0 => TallMatrix::zeros(m, 0, settings.factor_precision),
            rank => covariance::leading_columns(operator, &scales[..m], rank, settings.factor_precision, random),
        };
        // What is drawn for B comes first in the stream, then what is for Q, then the probes. But Q is factored first:
        // its working space is gone when Φ comes, whose own is needed later for the probes.
        let mut random = random::stream(0, "fast kalman filter");
        let mut of_background = random.clone();
        if settings.factors > 0 {
            covariance::skip_draws(m, settings.factors, &mut random);
        }
        let model_error = problem.model_error.as_deref().map(|operator| {
            let mut factors = leading(operator, &mut random);
            factors.shrink_to_fit();
            ModelError { factors, blocks: BlockDiagonal::of(operator, &blocks) }
        });

        let mut state = leading(&*problem.background_error, &mut of_background);
        state.prepend(p);
        let r = state.columns();
        let prior = calibration::Prior::new(&calibration, &shared, &local)?;
        let mut local_factors = TallMatrix::zeros(local.len(), r, Precision::Double);
        prior.copy_into(&mut local_factors);
        let shared_factors = Mat::from_fn(p, r, |i, j| if j < p { prior.shared[(i, j)] } else { 0.0 });
        let factors = Factors { state, local: local_factors, shared: shared_factors };
        let mut own = BlockDiagonal::of(&*problem.background_error, &blocks);
        own.add_factors(&blocks, -1.0, &factors);
        // What the factors hold of it has just been taken out.
        for (i, &number) in local.iter().enumerate() {
            for (j, &other) in local.iter().enumerate() {
                let ((block, row), (of_other, column)) = (blocks.place(m + i), blocks.place(m + j));
                if block == of_other {
                    own.block_mut(&blocks, block)[(row, column)] += calibration.prior_covariance(number, other);
                }
            }
        }
        let covariance = FactoredCovariance { own, linked: Vec::new(), factors };
        let state = problem.background.clone();
        let bias = vec![0.0; problem.calibration.len()];
        Ok(Self {
            problem,
            settings,
            blocks,
            local,
            shared,
            state,
            bias,
            covariance,
            model_error,
            adapted_model_error: None,
            scales,
            random,
            coarse: None,
            free: None,
        })
    }

    /// The same filter with its factors propagated by a model on a coarser grid of the same domain: where the errors'
    /// correlation length is many cells, so nearly the same, for k³ times less work with cells k times as wide.
    ///
    /// # Errors
    /// [`Error::Setting`] if the model's grid is not one of whole multiples of the state's cells, or if the blocks are
    /// propagated exactly, which needs the whole propagator.
    pub fn with_factors_on(mut self, model: Arc<dyn TangentLinear>) -> Result<Self, Error> {
        if self.settings.residual == Residual::Exact {
            return Err(Error::Setting("an exact forecast of the blocks leaves nothing to a coarser grid".into()));
        }
        self.coarse = Some(CoarseGrid::new(self.state.layout(), model)?);
        Ok(self)
    }

    /// The covariance of the errors of (state, calibration) as a dense matrix in that order, for tests and for queries
    /// on small problems. After an analysis, what observations have linked beyond the blocks is in it only if the forecast
    /// is exact; any other goes on with the blocks' own, as it does here.
    pub fn dense_covariance(&self) -> Mat<f64> {
        let m = self.state.values().len();
        let own = self.covariance.dense(&self.blocks);
        let mut position = vec![0; m + self.local.len() + self.shared.len()];
        (0..m).for_each(|i| position[i] = i);
        self.local.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + i);
        self.shared.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + self.local.len() + i);
        Mat::from_fn(position.len(), position.len(), |i, j| own[(position[i], position[j])])
    }

    fn estimate(&self) -> Result<Estimate, Error> {
        let m = self.state.values().len();
        let place = |variable: usize| match variable < m {
            true => format!("{} (block {})", self.state.layout().describe(variable), self.blocks.place(variable).0),
            false => self.problem.calibration.parameters[self.local[variable - m]].name.clone(),
        };
        let variances = self.covariance.block_variances(&self.blocks);
        let mut spread = standard_deviations(&variances, "the covariance of the blocks", place)?;
        let of_local = spread.split_off(m);
        spread.resize(m + self.local.len() + self.shared.len(), 0.0);
        for (&number, sigma) in self.local.iter().zip(of_local) {
            spread[m + number] = sigma;
        }
        // Sums of squares, none of which can be negative.
        for (&number, variance) in self.shared.iter().zip(&self.covariance.factors.shared_variances()) {
            spread[m + number] = variance.sqrt();
        }
        Ok(Estimate::with_spread(self.state.clone(), self.bias.clone(), spread))
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
            covariance.own = forecast::propagate_blocks(a, covariance, &self.blocks);
            covariance.linked.clear();
            forecast::propagate_factors(a, &mut covariance.factors);
            return Ok(());
        }
        let layout = self.state.layout().clone();
        let count = if let Residual::Probe { count } = self.settings.residual { count } else { 0 };
        let columns = &mut covariance.factors.state;
        let r = columns.columns();
        columns.append(count);
        residual::draw_probes(&covariance.own, &self.blocks, columns, r, &mut self.random);
        let before = residual::energy(&layout, columns, r);
        let model = &*self.problem.model;
        let outcome = stored!(columns.values_mut(), columns => match &self.coarse {
            None => forecast_tl(model, &mut self.state, columns, steps).map_err(Error::from),
            Some(coarse) => {
                let (factors, probes) = columns.split_at_mut(r * m);
                coarse.forecast(model, &mut self.state, (window, steps), factors, probes)
            }
        });
        let after = residual::energy(&layout, columns, r);
        columns.truncate(r);
        outcome?;
        if count > 0 {
            let persistence = residual::persistence(&before, &after);
            residual::scale(&mut covariance.own, &self.blocks, &layout, &persistence);
        }
        Ok(())
    }

    /// Adds what a window adds to the covariance: model error and the parameters' random walks.
    fn add_errors(&mut self, window: Duration) -> Result<(), Error> {
        let m = self.state.values().len();
        let (local_drift, shared_drift) = (self.drift(&self.local, window), self.drift(&self.shared, window));
        let covariance = &mut self.covariance;
        let model_error = self.adapted_model_error.as_ref().or(self.model_error.as_ref());
        if let Some(model_error) = model_error {
            covariance.own.add(&model_error.blocks);
        }
        for (number, sigma) in local_drift.iter().enumerate() {
            let (block, position) = self.blocks.place(m + number);
            covariance.own.block_mut(&self.blocks, block)[(position, position)] += sigma * sigma;
        }
        if self.settings.bias_coupling == BiasCoupling::Drop {
            return forecast::drop_coupling(covariance, &shared_drift, &self.blocks);
        }
        let model_error = model_error.map(|model_error| &model_error.factors);
        let joining = Joining { model_error, drift: &shared_drift };
        let kept = Kept { at_most: self.settings.factors, retained: self.settings.retained_energy };
        join_and_compress(covariance, &joining, kept, &self.scales, &self.blocks);
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
        let (innovation_chi2, partition) = self.analyse_rows(&rows, &innovations)?;
        let analysis = self.problem.resolved_analysis(observed, innovations, self.estimate()?, innovation_chi2)?;
        Ok(Analysis { partition: Some(partition), ..analysis })
    }

    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.column(unknown)
    }

    fn set_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        calibration::set(self, estimate, covariance)
    }

    fn set_error_factor(&mut self, factor: f64) -> Result<(), Error> {
        self.adapted_model_error = self.model_error.as_ref().map(|model_error| model_error.times(factor));
        Ok(())
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        saved::save(self)
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        saved::restore(self, saved)
    }

    fn calibration_accuracy(&self) -> Option<CalibrationAccuracy> {
        calibration::accuracy(self)
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        calibration::widen(self, covariance);
        Ok(())
    }

    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Option<Structure> {
        Some(self.structure_after(observed, factors))
    }
}

/// The standard deviation of each variable in the middle of the domain, for every value of the state.
fn state_scales(operator: &dyn Covariance, layout: &Layout) -> Vec<f64> {
    let (cells, grid) = (layout.grid.cells(), &layout.grid);
    let middle = grid.ny / 2 * grid.nx + grid.nx / 2;
    let scale = |variable: usize| {
        let variance = operator.covariance(variable * cells + middle, variable * cells + middle);
        if variance > 0.0 { variance.sqrt() } else { 1.0 }
    };
    (0..layout.variables.len()).flat_map(|variable| std::iter::repeat_n(scale(variable), cells)).collect()
}

fn check_settings(problem: &Problem, blocks: &Blocks, shared: u64, settings: FastKalmanSettings) -> Result<(), Error> {
    let (m, b, r) = (problem.background.values().len() as u64, blocks.variables() as u64, settings.factors as u64);
    if r > b {
        return Err(Error::Setting(format!("{r} common factors are more than the {b} variables they describe")));
    }
    if r > 0 && settings.bias_coupling == BiasCoupling::Drop {
        return Err(Error::Setting("the printed formulae (28)/(29), which drop the coupling, have no factors".into()));
    }
    let probes = if let Residual::Probe { count } = settings.residual { count as u64 } else { 0 };
    let extra = probes.max(covariance::OVERSAMPLING as u64);
    // The blocks, those of Q and their roots; the factors with the probes, and the factors of Q.
    let mut needed_bytes =
        8 * 3 * blocks.matrices_len() as u64 + settings.factor_precision.bytes() * b * (2 * r + shared + extra);
    if settings.residual == Residual::Exact {
        // The propagator A, and A C as products and as a whole.
        needed_bytes += 8 * (m * m + 2 * m * b);
    }
    if needed_bytes > problem.memory_limit_bytes {
        let what = format!("the covariance of {b} unknowns in {} blocks with {r} factors", blocks.count());
        return Err(Error::TooLarge { what, needed_bytes, limit_bytes: problem.memory_limit_bytes });
    }
    Ok(())
}
