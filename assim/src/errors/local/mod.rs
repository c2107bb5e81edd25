//! The Fast Kalman Filter with local common factors, whose number does not grow with the domain.
//!
//! ```text
//! b = b~ + Γ (c − c~) + Σ_j F_j ξ_j + e,     ξ_j ~ N(0, I_r),  c − c~ ~ N(0, S),  e ~ N(0, blkdiag(C_1 … C_K))
//!
//! Cov(b) = blkdiag(C_k) + Σ_j F_j F_jᵀ + Γ S Γᵀ        Cov(b, c) = Γ S        Cov(c) = S
//! ```
//!
//! Each tile j of the domain has r factors F_j, which are zero outside of a support of q × q tiles about it. The shared
//! calibration parameters c are the border, with the sensitivities Γ of all variables to them. It is a covariance
//! for any F_j and Γ, and any C_k ≥ 0 and S ≥ 0. The part that is cut off a factor, or left over by a compression, has a positive
//! semidefinite block diagonal. Either that joins the C_k, and each block keeps its covariance; or the rows of the factors are
//! lengthened, and each variable keeps its variance.
//!
//! In a cycle
//!
//! 1. the factors of tiles whose supports have no cell in common are *packed* into one column of the tangent-linear model:
//!    q² r columns, however large the domain is (`forecast`), on the grid of the state or a coarser one;
//! 2. the leading directions of Q that belong to a tile join its factors, the leading ones of all these go on, and *localising
//!    rotations* of neighbours' factors, which change no covariance, move each direction to the tile that it is nearest to
//!    (`compression`, `rotation`);
//! 3. each tile keeps its r leading directions, in its support (`compression`);
//! 4. the observations are analysed by a nested block-angular regression: cells, amplitudes ξ, border c (`analysis`).
//!
//! A smoother (`fixed_lag`) keeps the errors of earlier analyses as further rows of the factors.
//!
//! With one tile it is the Fast Kalman Filter of `blocks` with its border in another form.

mod amplitudes;
mod analysis;
mod calibration;
mod compression;
mod fixed_basis;
mod fixed_lag;
mod forecast;
mod inverse_roots;
mod local_factors;
mod recombination;
mod roots;
mod rotation;
mod separators;
mod settings;
#[cfg(test)]
mod tests;
mod tiles;

pub use settings::{LeftOver, LocalFactorSettings};

use super::blocks::{BlockDiagonal, Blocks, CoarseGrid, augmented, of_blocks, rounding};
use crate::augmented::Augmented;
use crate::covariance::{Covariance, middle_deviations};
use crate::error::Error;
use crate::filter::{Cycle, Errors, Filter, Fit};
use crate::fixed_lag::PastAnalyses;
use crate::linalg::product;
use crate::memory::{Matrix, read, require, write};
use crate::problem::{Innovations, Problem, require_memory};
use faer::{Mat, MatRef};
use fixed_basis::FixedBasis;
use fixed_lag::{Past, add_border_variances};
use isobar_model::{Layout, TangentLinear, random};
use isobar_obs::ByPlacement;
use local_factors::{LocalFactors, add_to_blocks, divided};
use rand_chacha::ChaCha8Rng;
use rotation::PairRows;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::sync::Arc;
use tiles::{Colours, Tiles};

/// The Kalman filter with a covariance in blocks and the factors of tiles.
pub type LocalFastKalmanFilter = Filter<LocalErrors>;

/// A covariance in blocks and the factors of tiles.
#[derive(Clone)]
pub struct LocalErrors {
    frame: Arc<Frame>,
    /// Where the packed columns are propagated, if not on the grid of the state.
    coarse: Option<Arc<CoarseGrid>>,
    memory: Memory,
}

/// What stays the same in all cycles.
struct Frame {
    settings: LocalFactorSettings,
    layout: Arc<Layout>,
    blocks: Blocks,
    tiles: Tiles,
    colours: Colours,
    /// The state's values that are in no support of each colour.
    uncovered: Vec<Vec<usize>>,
    /// The block variables of each tile's support, ascending.
    supports: Vec<Vec<usize>>,
    /// The pairs of neighbours, in groups of pairs without a tile in common.
    pairs: Vec<Vec<PairRows>>,
    /// The tiles in whose support each cell is, ascending.
    covering: Vec<Vec<usize>>,
    /// The cell of each block variable.
    cells: Vec<usize>,
    /// Numbers of the local parameters in the calibration, in the order of their block variables.
    local: Vec<usize>,
    /// Numbers of the shared parameters, in the order of the border.
    shared: Vec<usize>,
    model_error: Option<ModelError>,
    /// The scale of each block variable in the norm by which factors are compressed: its standard deviation in B.
    scales: Vec<f64>,
    fixed_basis: FixedBasis,
    memory_limit_bytes: u64,
}

/// What changes from cycle to cycle.
#[derive(Clone, Serialize, Deserialize)]
pub struct Memory {
    /// C_1 … C_K.
    own: BlockDiagonal,
    /// F_j, each on the support of its tile.
    factors: Vec<LocalFactors>,
    /// Γ, `[block variables, shared]`.
    sensitivity: Matrix,
    /// S, `[shared, shared]`.
    shared: Matrix,
    /// Draws the probes, and the signs of what is mixed.
    random: ChaCha8Rng,
    /// The earlier analyses, if there is a smoother.
    past: Option<Past>,
}

/// Q of the state's values.
struct ModelError {
    /// The leading directions of each tile.
    factors: Vec<LocalFactors>,
    /// The blocks of what is left.
    rest: BlockDiagonal,
}

impl LocalFastKalmanFilter {
    /// A filter that starts from the background, whose error covariance it truncates to the factors and blocks.
    ///
    /// # Errors
    /// [`Error::TooLarge`] beyond the memory limit; [`Error::Setting`] for a B or Q without places for its control vector.
    pub fn with_local_factors(
        problem: impl Into<Problem<dyn TangentLinear>>,
        settings: LocalFactorSettings,
    ) -> Result<Self, Error> {
        let problem = problem.into();
        let errors = LocalErrors::new(&problem, settings)?;
        Ok(Self::starting_with(problem, errors))
    }

    /// The same filter with its packed columns and those of the border propagated by a model on a coarser grid of the same
    /// domain: see [`FastKalmanFilter::with_factors_on`](crate::fast_kalman::FastKalmanFilter::with_factors_on).
    ///
    /// # Errors
    /// [`Error::Setting`] if the model's grid is not one of whole multiples of the state's cells.
    pub fn with_factors_on(mut self, model: Arc<dyn TangentLinear>) -> Result<Self, Error> {
        let errors = &mut self.belief.errors;
        errors.coarse = Some(Arc::new(CoarseGrid::new(&errors.frame.layout, model)?));
        Ok(self)
    }

    /// The same filter with the smoother of `fixed_lag`, which revises the last `lag` analyses by the newer observations.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the rows of the factors of that many analyses do not fit into the memory limit.
    pub fn smoothing(mut self, lag: usize) -> Result<Self, Error> {
        self.belief.errors.smooth(lag)?;
        Ok(self)
    }

    /// The columns that a forecast propagates, whatever the size of the domain: packed factors, the border's and probes.
    pub fn propagated_columns(&self) -> usize {
        let errors = &self.belief.errors;
        let Frame { settings, colours, shared, .. } = &*errors.frame;
        colours.count * settings.per_tile + shared.len() + settings.residual.probes()
    }
}

impl LocalErrors {
    fn new(problem: &Problem<dyn TangentLinear>, settings: LocalFactorSettings) -> Result<Self, Error> {
        problem.require_one_rank("a Fast Kalman Filter with local factors")?;
        let layout = problem.background.layout().clone();
        let calibration = problem.estimated_calibration();
        let ByPlacement { shared, local } = calibration.by_placement();
        let (local, places): (Vec<usize>, Vec<(f64, f64)>) = local.into_iter().unzip();
        let local_cells: Vec<usize> = places.into_iter().map(|(x_m, y_m)| layout.grid.cell_at(x_m, y_m)).collect();
        let blocks = Blocks::new(&layout, settings.blocks, &local_cells);
        let tiles = Tiles::new(&layout.grid, settings.tile_m, settings.support_tiles);
        let (m, cell_count) = (layout.len(), layout.grid.cells());
        let cells: Vec<usize> = (0..m).map(|value| value % cell_count).chain(local_cells).collect();
        let mut covering = vec![Vec::new(); cell_count];
        for tile in 0..tiles.count() {
            tiles.support(tile).into_iter().for_each(|cell| covering[cell].push(tile));
        }
        let mut supports = vec![Vec::new(); tiles.count()];
        for (variable, &cell) in cells.iter().enumerate() {
            covering[cell].iter().for_each(|&tile| supports[tile].push(variable));
        }
        settings.check(&supports, &blocks, shared.len(), problem.memory_limit_bytes)?;
        let mut scales = middle_deviations(&*problem.background_error, &layout);
        scales.extend(local.iter().map(|&number| calibration.parameters[number].sigma_prior));
        let state_supports: Vec<Vec<usize>> = supports
            .iter()
            .map(|support| support[..support.partition_point(|&variable| variable < m)].to_vec())
            .collect();
        let precision = settings.factor_precision;
        let mut random = random::stream(0, "local common factors");
        let mut factored = |covariance: &dyn Covariance, rank: usize| {
            let factors =
                roots::leading_local_factors(covariance, &tiles, &state_supports, &scales, rank, &mut random)?;
            let mut rest = BlockDiagonal::of(covariance, &blocks, &problem.bands());
            let mut all = vec![0.0; blocks.variables()];
            rest.add_variances(&blocks, &mut all);
            add_to_blocks(&mut rest, &blocks, -1.0, &factors);
            rest.clear_rounding(&blocks, &all, rounding(rank * covering.iter().map(Vec::len).max().unwrap_or(0)));
            let rounded = |(factors, support): (&LocalFactors, &Vec<usize>)| factors.extended(support, precision);
            let factors = factors.iter().zip(&supports).map(rounded).collect();
            Ok::<_, Error>(ModelError { factors, rest })
        };
        let background = factored(&*problem.background_error, settings.per_tile)?;
        let model_error = problem.model_error.as_deref();
        let model_error = model_error.map(|operator| factored(operator, settings.model_error_per_tile)).transpose()?;
        let largest = supports.iter().map(Vec::len).max().unwrap_or(0);
        let fixed_basis = FixedBasis::new(largest, settings.per_tile + settings.model_error_per_tile);
        let turned = |(factors, support): (LocalFactors, &Vec<usize>)| {
            let (values, r) = (factors.to_matrix(), factors.columns());
            let scaled = divided(values.as_ref(), support, |variable| scales[variable]);
            let turn = fixed_basis.rotation(scaled.as_ref(), Mat::identity(r, r).as_ref(), r);
            LocalFactors::new(factors.variables, product(values.as_ref(), turn.as_ref()).as_ref(), precision)
        };
        let memory = Memory {
            own: background.rest,
            factors: background.factors.into_iter().zip(&supports).map(turned).collect(),
            sensitivity: Matrix(Mat::zeros(blocks.variables(), shared.len())),
            shared: Matrix(Mat::zeros(shared.len(), shared.len())),
            random,
            past: None,
        };
        let colours = tiles.colours(1);
        let is_uncovered =
            |value: &usize, colour: usize| covering[cells[*value]].iter().all(|&tile| colours.of_tile[tile] != colour);
        let uncovered = |colour| (0..m).filter(|value| is_uncovered(value, colour)).collect();
        let uncovered: Vec<Vec<usize>> = (0..colours.count).map(uncovered).collect();
        let memory_limit_bytes = problem.memory_limit_bytes;
        let frame = Frame {
            settings,
            layout,
            blocks,
            colours,
            uncovered,
            pairs: PairRows::all(&tiles, &supports, &cells, &scales),
            tiles,
            supports,
            covering,
            cells,
            local,
            shared,
            model_error,
            scales,
            fixed_basis,
            memory_limit_bytes,
        };
        let mut errors = Self { frame: Arc::new(frame), coarse: None, memory };
        let p = calibration.len();
        let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
        errors.add_calibration_errors(prior.as_ref())?;
        Ok(errors)
    }

    /// L with L Lᵀ = S.
    fn shared_root(&self) -> Result<Mat<f64>, Error> {
        crate::linalg::cholesky(self.memory.shared.0.clone(), || "the covariance of the shared parameters".into())
    }
}

impl Errors for LocalErrors {
    type Memory = Memory;

    const NAME: &'static str = "the covariance of blocks and local factors";

    fn forecast(&mut self, s: &mut Augmented, cycle: &Cycle<'_>) -> Result<(), Error> {
        self.propagate(&mut s.state, cycle)?;
        self.add_errors(cycle)
    }

    fn analyse(&mut self, s: &mut Augmented, d: &Innovations) -> Result<Fit, Error> {
        let fit = self.analyse_rows(s, d)?;
        self.remember(s);
        Ok(fit)
    }

    fn variances(&self) -> Vec<f64> {
        let Frame { blocks, local, shared, .. } = &*self.frame;
        let memory = &self.memory;
        let mut variances = vec![0.0; blocks.variables()];
        memory.own.add_variances(blocks, &mut variances);
        memory.factors.iter().for_each(|factors| factors.add_squared_rows(&mut variances));
        add_border_variances(memory.sensitivity.as_ref(), memory.shared.as_ref(), &mut variances);
        let of_shared: Vec<f64> = (0..shared.len()).map(|i| memory.shared[(i, i)]).collect();
        augmented(&variances, &of_shared, local, shared)
    }

    /// (blkdiag(C) + Σ F_j F_jᵀ) h_b + Γ S (Γᵀ h_b + h_c), and S (Γᵀ h_b + h_c).
    fn multiply(&self, h: &[f64]) -> Vec<f64> {
        let Frame { blocks, local, shared, layout, .. } = &*self.frame;
        let (m, memory) = (layout.len(), &self.memory);
        let of_blocks: Vec<f64> = of_blocks(h, m, local).collect();
        let mut image = vec![0.0; blocks.variables()];
        for block in 0..blocks.count() {
            let members = blocks.members(block);
            if members.iter().any(|&member| of_blocks[member] != 0.0) {
                let own = memory.own.block(blocks, block);
                for (i, &row) in members.iter().enumerate() {
                    image[row] +=
                        members.iter().enumerate().map(|(j, &column)| own[(i, j)] * of_blocks[column]).sum::<f64>();
                }
            }
        }
        for factors in &memory.factors {
            factors.multiply_add(&factors.transposed_product(&of_blocks), &mut image);
        }
        let p = shared.len();
        let seen: Vec<f64> = (0..p)
            .map(|i| h[m + shared[i]] + isobar_model::vector::dot(memory.sensitivity.col_as_slice(i), &of_blocks))
            .collect();
        let of_shared: Vec<f64> = (0..p).map(|i| (0..p).map(|j| memory.shared[(i, j)] * seen[j]).sum()).collect();
        for (i, &amplitude) in of_shared.iter().enumerate() {
            isobar_model::vector::axpy(amplitude, memory.sensitivity.col_as_slice(i), &mut image);
        }
        augmented(&image, &of_shared, local, shared)
    }

    fn widen_calibration(&mut self, widening: MatRef<'_, f64>) {
        self.widen(widening);
    }

    fn replace_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.replace(covariance)
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.memory, to)
    }

    fn read(&self, from: &mut dyn Read) -> Result<Memory, Error> {
        read(from)
    }

    fn recall(&mut self, memory: Memory, s: &Augmented) -> Result<(), Error> {
        let Frame { blocks, shared, supports, settings, .. } = &*self.frame;
        let (b, p) = (blocks.variables(), shared.len());
        require(memory.own.is_like(&self.memory.own), "the covariance of the blocks")?;
        let fits = memory.factors.len() == supports.len()
            && memory.factors.iter().zip(supports).all(|(factors, support)| {
                factors.variables == *support
                    && factors.is_whole()
                    && factors.precision() == settings.factor_precision
                    && factors.columns() == memory.factors[0].columns()
            });
        require(fits, "the matrix of the local factors")?;
        require(memory.sensitivity.has_shape(b, p) && memory.shared.has_shape(p, p), "the border")?;
        match (&self.memory.past, &memory.past) {
            (None, None) => {}
            (Some(own), Some(recalled)) => recalled.require(own.lag(), s, &self.frame, &memory.factors)?,
            _ => require(false, "the smoother")?,
        }
        self.memory = memory;
        Ok(())
    }

    fn smoother(&self) -> Option<&dyn PastAnalyses> {
        self.memory.past.as_ref().map(|past| past.analyses() as _)
    }

    fn require_memory(&self, observations: usize, _: usize, limit_bytes: u64) -> Result<(), Error> {
        // M has a block for each two tiles whose supports overlap, its factor some times as much; the rows of a chunk of
        // components see the tiles whose supports cover a cell.
        let columns: usize = self.memory.factors.iter().map(LocalFactors::columns).sum();
        let seen = self.frame.colours.count * self.frame.settings.per_tile + self.frame.shared.len();
        let numbers = 16.0 * columns as f64 * seen as f64 + 4.0 * observations as f64 * seen as f64;
        require_memory(limit_bytes, numbers, || {
            format!("the analysis of {observations} observations with {columns} local factors")
        })
    }
}
