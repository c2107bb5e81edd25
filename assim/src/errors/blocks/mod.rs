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
mod calibration;
mod coarse_grid;
mod component;
mod compression;
mod division;
mod factored_covariance;
mod factors;
mod fixed_lag;
mod forecast;
mod free_columns;
mod fusion;
mod grid_blocks;
mod nested;
mod past_analyses;
mod product;
mod reflections;
pub(super) mod residual;
mod root;
mod separation;
mod separators;
mod settings;
mod solution;
mod structure;

pub use crate::tall_matrix::Precision;
pub use grid_blocks::BlockShape;
pub use settings::{BiasCoupling, FastKalmanSettings, Residual};

pub(super) use block_diagonal::BlockDiagonal;
pub(super) use coarse_grid::CoarseGrid;
pub(super) use component::{check_component, component_size, partition, set_blocks, update_rows};
pub(super) use compression::rounding;
pub(crate) use division::divide;
pub(crate) use factors::Factors;
pub(crate) use fusion::fuse;
pub(super) use grid_blocks::Blocks;
pub(super) use past_analyses::{FixedLag, PastAnalysis};
pub(super) use separators::{Separation, seen_variables, take_observed_part};
pub(crate) use solution::{Increments, SplitRows};
pub(super) use solution::{augmented, of_blocks};

use crate::augmented::Augmented;
use crate::covariance::{self, Covariance};
use crate::covariance_root::CovarianceRoot;
use crate::error::Error;
use crate::filter::{Cycle, ErrorBlocks, Errors, Filter, Fit};
use crate::fixed_lag::PastAnalyses;
use crate::memory::{read, require, write};
use crate::problem::{Innovations, Problem, require_memory};
use crate::tall_matrix::{TallMatrix, scaled_gram};
use factored_covariance::FactoredCovariance;
use factors::Further;
use faer::{Mat, MatRef, Scale};
use isobar_model::{Bands, Layout, TangentLinear, random};
use isobar_obs::ByPlacement;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::sync::Arc;

/// The Kalman filter with a covariance in blocks and common factors.
pub type FastKalmanFilter = Filter<BlockErrors>;

/// A covariance in blocks and common factors.
#[derive(Clone)]
pub struct BlockErrors {
    frame: Arc<Frame>,
    /// Where the factors are propagated, if not on the grid of the state.
    coarse: Option<Arc<CoarseGrid>>,
    memory: Memory,
}

/// What stays the same in all cycles.
struct Frame {
    settings: FastKalmanSettings,
    layout: Arc<Layout>,
    /// Which rank has which rows.
    bands: Bands,
    blocks: Blocks,
    /// Numbers of the local parameters in the calibration, in the order of their block variables.
    local: Vec<usize>,
    /// Numbers of the shared parameters, in the order of the border.
    shared: Vec<usize>,
    model_error: Option<ModelError>,
    /// The scale of each block variable in the norm by which factors are compressed: its standard deviation in B.
    scales: Vec<f64>,
    memory_limit_bytes: u64,
}

/// What changes from cycle to cycle.
#[derive(Clone, Serialize, Deserialize)]
pub struct Memory {
    covariance: FactoredCovariance,
    /// Draws the probes.
    random: ChaCha8Rng,
    smoother: Option<FixedLag>,
}

/// Q of the state's values, as far as the filter keeps it.
struct ModelError {
    /// The leading factors F_Q.
    factors: TallMatrix,
    /// F_Qᵀ S⁻² F_Q, S the scales of the state's values.
    gram: Mat<f64>,
    /// All of the blocks Q_k, what F_Q holds of them included.
    blocks: BlockDiagonal,
}

impl ModelError {
    /// What joins the common factors.
    fn further(&self) -> Further<'_> {
        Further { factors: &self.factors, gram: self.gram.as_ref() }
    }

    /// That of α Q.
    fn times(&self, factor: f64) -> Self {
        let (mut factors, mut blocks) = (self.factors.clone(), self.blocks.clone());
        factors.scale(factor.sqrt());
        blocks.values_mut().iter_mut().for_each(|value| *value *= factor);
        Self { factors, gram: &self.gram * Scale(factor), blocks }
    }
}

impl FastKalmanFilter {
    /// A filter that starts from the background, whose error covariance it truncates to the blocks.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the propagator and the blocks do not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn TangentLinear>>, settings: FastKalmanSettings) -> Result<Self, Error> {
        let problem = problem.into();
        let errors = BlockErrors::new(&problem, settings)?;
        Ok(Self::starting_with(problem, errors))
    }

    /// The same filter with its factors propagated by a model on a coarser grid of the same domain: where the errors'
    /// correlation length is many cells, so nearly the same, for k³ times less work with cells k times as wide.
    ///
    /// # Errors
    /// [`Error::Setting`] if the model's grid is not one of whole multiples of the state's cells, or if the blocks are
    /// propagated exactly, which needs the whole propagator.
    pub fn with_factors_on(mut self, model: Arc<dyn TangentLinear>) -> Result<Self, Error> {
        let errors = &mut self.belief.errors;
        if errors.frame.settings.residual == Residual::Exact {
            return Err(Error::Setting("an exact forecast of the blocks leaves nothing to a coarser grid".into()));
        }
        errors.coarse = Some(Arc::new(CoarseGrid::new(&errors.frame.layout, model)?));
        Ok(self)
    }

    /// The same filter with the smoother of `fixed_lag`, which revises the last `lag` analyses by the newer observations.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the rows of the factors of that many analyses do not fit into the memory limit;
    /// [`Error::Setting`] if the coupling of state and biases is dropped, and with it that of the times.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        self.belief.errors.smooth(lag)?;
        Ok(self)
    }

    /// The covariance of the errors of (state, calibration) as a dense matrix in that order, for tests and for queries
    /// on small problems. After an analysis, what observations have linked beyond the blocks is in it only if the forecast
    /// is exact; any other goes on with the blocks' own, as it does here.
    pub fn dense_covariance(&self) -> Mat<f64> {
        let errors = &self.belief.errors;
        let Frame { blocks, local, shared, layout, .. } = &*errors.frame;
        let m = layout.len();
        let dense = errors.memory.covariance.dense(blocks);
        let mut position: Vec<usize> = (0..m + local.len() + shared.len()).collect();
        local.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + i);
        shared.iter().enumerate().for_each(|(i, &number)| position[m + number] = m + local.len() + i);
        Mat::from_fn(position.len(), position.len(), |i, j| dense[(position[i], position[j])])
    }
}

impl BlockErrors {
    /// The errors of a problem's background.
    ///
    /// # Errors
    /// Those of [`FastKalmanFilter::new`].
    pub(crate) fn new(problem: &Problem<dyn TangentLinear>, settings: FastKalmanSettings) -> Result<Self, Error> {
        let layout = problem.background.layout().clone();
        let calibration = problem.estimated_calibration();
        let ByPlacement { shared, local } = calibration.by_placement();
        let (local, places): (Vec<usize>, Vec<(f64, f64)>) = local.into_iter().unzip();
        let local_cells: Vec<usize> = places.into_iter().map(|(x_m, y_m)| layout.grid.cell_at(x_m, y_m)).collect();
        let blocks = Blocks::new(&layout, settings.blocks, &local_cells);
        let bands = problem.bands();
        settings.check_bands(&bands, problem)?;
        settings.check(layout.len(), &blocks, shared.len(), problem.memory_limit_bytes, problem.share())?;
        let sigma_prior = |number: usize| calibration.parameters[number].sigma_prior;
        let (m, p) = (layout.len(), shared.len());
        let mut scales = covariance::middle_deviations(&*problem.background_error, &layout);
        scales.extend(local.iter().map(|&number| sigma_prior(number)));
        let leading = |operator: &dyn Covariance, random: &mut ChaCha8Rng| match settings.factors {
            0 => TallMatrix::zeros_in(&bands, m, 0, settings.factor_precision),
            rank => {
                let empty = TallMatrix::zeros_in(&bands, m, 0, settings.factor_precision);
                covariance::leading_columns(operator, &scales[..m], empty, rank, random)
            }
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
            let gram = scaled_gram(&factors, &scales[..m]);
            ModelError { factors, gram, blocks: BlockDiagonal::of(operator, &blocks, &bands) }
        });
        let mut state = leading(&*problem.background_error, &mut of_background);
        state.prepend(p);
        let factors = factors::with_priors(state, &calibration, &shared, &local)?;
        let mut own = BlockDiagonal::of(&*problem.background_error, &blocks, &bands);
        let mut all = vec![0.0; blocks.variables()];
        own.add_variances(&blocks, &mut all);
        own.add_factors(&blocks, -1.0, &factors);
        // What the factors hold of it has just been taken out.
        for (i, &number) in local.iter().enumerate() {
            for (j, &other) in local.iter().enumerate() {
                let ((block, _), (of_other, column)) = (blocks.place(m + i), blocks.place(m + j));
                if block == of_other {
                    own.edit(&blocks, m + i, |mut matrix, row| {
                        matrix[(row, column)] += calibration.prior_covariance(number, other);
                    });
                }
            }
        }
        local.iter().zip(&mut all[m..]).for_each(|(&number, all)| *all = calibration.prior_covariance(number, number));
        own.clear_rounding(&blocks, &all, rounding(factors.columns()));
        let memory =
            Memory { covariance: FactoredCovariance { own, linked: Vec::new(), factors }, random, smoother: None };
        let memory_limit_bytes = problem.memory_limit_bytes;
        let frame = Frame { settings, layout, bands, blocks, local, shared, model_error, scales, memory_limit_bytes };
        Ok(Self { frame: Arc::new(frame), coarse: None, memory })
    }

    /// Numbers of the shared parameters in the calibration, in the order of the border.
    pub(crate) fn shared(&self) -> &[usize] {
        &self.frame.shared
    }

    /// What changes from cycle to cycle.
    pub(crate) fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Number of block variables.
    pub(crate) fn block_variables(&self) -> usize {
        self.frame.blocks.variables()
    }

    /// Φ.
    pub(crate) fn factors(&self) -> &Factors {
        &self.memory.covariance.factors
    }

    /// Φ.
    pub(crate) fn factors_mut(&mut self) -> &mut Factors {
        &mut self.memory.covariance.factors
    }
}

impl Errors for BlockErrors {
    type Memory = Memory;

    const NAME: &'static str = "the covariance of blocks and factors";

    fn forecast(&mut self, s: &mut Augmented, cycle: &Cycle<'_>) -> Result<(), Error> {
        if let Some(kept) = cycle.kept() {
            self.decay(&kept);
        }
        self.propagate(&mut s.state, cycle)?;
        self.add_errors(cycle)
    }

    fn analyse(&mut self, s: &mut Augmented, d: &Innovations) -> Result<Fit, Error> {
        let analysis = self.analyse_rows(&self.split_rows(d), d, 0)?;
        self.add_increments(s, &analysis.increments);
        self.remember(s);
        Ok(Fit { chi2: analysis.chi2, partition: Some(analysis.partition) })
    }

    fn variances(&self) -> Vec<f64> {
        let Frame { blocks, local, shared, .. } = &*self.frame;
        let covariance = &self.memory.covariance;
        let (of_blocks, of_shared) = covariance.variances(blocks);
        augmented(&of_blocks, &of_shared, local, shared)
    }

    fn part(&self, number: usize) -> Option<String> {
        let Frame { blocks, local, layout, .. } = &*self.frame;
        let variable = match number.checked_sub(layout.len()) {
            None => Some(number),
            Some(parameter) => local.iter().position(|&own| own == parameter).map(|own| layout.len() + own),
        };
        variable.map(|variable| blocks.describe(blocks.place(variable).0, layout))
    }

    fn multiply(&self, h: &[f64]) -> Vec<f64> {
        self.product(h)
    }

    fn between(&self, a: &[(usize, f64)], b: &[(usize, f64)], _size: usize) -> f64 {
        self.bilinear(a, b)
    }

    fn widen_calibration(&mut self, widening: MatRef<'_, f64>) {
        self.widen(widening);
    }

    fn replace_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.replace(covariance)
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        let Memory { covariance: FactoredCovariance { own, linked, factors }, random, smoother } = &self.memory;
        let Factors { state, local, shared, past } = factors;
        write(&(linked, local, shared, past, random, smoother), to)?;
        own.save(&self.frame.bands, to)?;
        state.save(to)
    }

    fn read(&self, from: &mut dyn Read) -> Result<Memory, Error> {
        let (linked, local, shared, past, random, smoother) = read(from)?;
        let own = self.memory.covariance.own.read_like(&self.frame.blocks, from)?;
        let state = self.factors().state.read_like(from)?;
        let factors = Factors { state, local, shared, past };
        Ok(Memory { covariance: FactoredCovariance { own, linked, factors }, random, smoother })
    }

    fn recall(&mut self, memory: Memory, s: &Augmented) -> Result<(), Error> {
        let Frame { blocks, shared, layout, local, .. } = &*self.frame;
        memory.covariance.require(blocks, &self.memory.covariance)?;
        let fits = memory.covariance.factors.has_rows(layout.len(), local.len(), shared.len());
        require(fits, "the matrix of the factors")?;
        let past = memory.covariance.factors.past.len();
        match (&self.memory.smoother, &memory.smoother) {
            (None, None) => require(past == 0, "the smoother")?,
            (Some(own), Some(recalled)) => {
                recalled.require(own.lag(), s, layout.len() + local.len() + shared.len(), past)?;
            }
            _ => require(false, "the smoother")?,
        }
        self.memory = memory;
        Ok(())
    }

    fn require_memory(&self, observations: usize, _: usize, limit_bytes: u64) -> Result<(), Error> {
        // H Φ and its copies; what components of blocks need is known when they are.
        let r = self.factors().columns();
        let numbers = 2.0 * observations as f64 * r as f64 + 4.0 * (r as f64).powi(2);
        require_memory(limit_bytes, numbers, || format!("the analysis of {observations} observations with {r} factors"))
    }

    fn calibration_and_means(&self, _: usize, _: usize, _: usize) -> Mat<f64> {
        self.joint_covariance()
    }

    fn smoother(&self) -> Option<&dyn PastAnalyses> {
        self.memory.smoother.as_ref().map(|smoother| smoother as _)
    }

    fn blocks(&self) -> Option<&dyn ErrorBlocks> {
        Some(self)
    }

    fn root(&self) -> Option<&dyn CovarianceRoot> {
        (self.factors().columns() > 0).then_some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::BiasTreatment;
    use crate::testing::Still;
    use isobar_model::{Boundary, Grid, Location, State, Variable};
    use isobar_obs::Calibration;

    #[test]
    fn a_negative_variance_is_named_with_its_block() {
        let name = "h";
        let variable = Variable { name, long_name: name, standard_name: None, unit: "m", location: Location::Center };
        let grid = Grid { nx: 4, ny: 3, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let layout = Arc::new(Layout { grid, variables: vec![variable] });
        let problem = Problem::<dyn TangentLinear> {
            background: State::zeros(&layout),
            background_error: Arc::new(covariance::White::new(&layout, 0, 1.0)),
            model_error: None,
            calibration: Calibration::default(),
            bias: BiasTreatment::Estimate,
            memory_limit_bytes: 1 << 30,
            most_observations: 0,
            model: Arc::new(Still(Arc::clone(&layout))),
        };
        let settings = FastKalmanSettings {
            blocks: BlockShape::Cell,
            bias_coupling: BiasCoupling::Carry,
            factors: 0,
            retained_energy: 1.0,
            residual: Residual::Persist,
            largest_component: usize::MAX,
            separator_factors: 0,
            factor_precision: Precision::Double,
        };
        let mut filter = FastKalmanFilter::new(problem, settings).unwrap();
        filter.belief.errors.memory.covariance.own.values_mut()[6] = -0.5;
        let error = filter.belief.estimate(&filter.calibration).unwrap_err().to_string();
        let expected = "the variance of h at row 1, column 2 in block 6 (row 1, column 2) is -0.5";
        assert!(error.contains(expected), "{error}");
    }
}
