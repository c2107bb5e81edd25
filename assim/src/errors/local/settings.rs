//! How the filter with local factors is set up.

use super::tiles::Tiles;
use crate::error::Error;
use crate::errors::blocks::{BlockShape, Blocks, Precision, Residual};
use isobar_model::Grid;

/// Where the directions of a tile go that a compression leaves over, and what a rotation leaves outside of a support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOver {
    /// Into the blocks, where they count as errors without a correlation between one block and another.
    Blocks,
    /// Into the factors that are kept, which grow until each variable has the variance that it had: the errors that are left
    /// over then have the correlations of those that are kept.
    Factors,
}

/// How the filter with local factors is set up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFactorSettings {
    /// The blocks.
    pub blocks: BlockShape,
    /// Factors r of each tile.
    pub per_tile: usize,
    /// Directions of Q that join the factors of each tile in a forecast.
    pub model_error_per_tile: usize,
    /// About how wide a tile is \[m\].
    pub tile_m: f64,
    /// How many tiles wide the support of a tile's factors is, q.
    pub support_tiles: usize,
    /// Of the factors of a tile, how many are random sums of the directions that a compression leaves over. These keep
    /// what blocks have in common there, in the mean, where a dissipative model would soon take it from the blocks.
    pub mixed: usize,
    /// Where the others go that it leaves over.
    pub left_over: LeftOver,
    /// How the factors and those of the model error are stored.
    pub factor_precision: Precision,
    /// Variables of the largest component that observations may merge; cells are cut out of a larger one.
    pub largest_component: usize,
    /// How the block-diagonal part is forecast: not exactly, which would need the whole propagator.
    pub residual: Residual,
}

impl LocalFactorSettings {
    /// The columns into which the factors of all tiles are packed for a forecast on a grid.
    pub fn packed_columns(&self, grid: &Grid) -> usize {
        self.per_tile * Tiles::new(grid, self.tile_m, self.support_tiles).colours(1).count
    }

    /// Fails if they make no sense, or need more memory than the limit.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooLarge`].
    pub(super) fn check(
        &self,
        supports: &[Vec<usize>],
        blocks: &Blocks,
        shared: usize,
        limit: u64,
    ) -> Result<(), Error> {
        if self.residual == Residual::Exact {
            return Err(Error::Setting("local factors leave a residual that is not forecast exactly".into()));
        }
        let Self { per_tile, model_error_per_tile, mixed, .. } = *self;
        let smallest = supports.iter().map(Vec::len).min().unwrap_or(0);
        if per_tile == 0 || per_tile.max(model_error_per_tile) > smallest {
            return Err(Error::Setting(format!(
                "{per_tile} factors of a tile, with {model_error_per_tile} of the model error, do not fit: there must be one at \
                 least, and no more than the {smallest} variables of the smallest support"
            )));
        }
        if mixed >= per_tile {
            return Err(Error::Setting(format!(
                "of {per_tile} factors of a tile, {mixed} cannot be sums of what is left over"
            )));
        }
        let (b, p) = (blocks.variables() as u64, shared as u64);
        let held: u64 = supports.iter().map(|support| support.len() as u64).sum();
        let columns = (per_tile + model_error_per_tile) as u64;
        // The factors with those of Q, these, both as rotations embed them, the packed columns, the blocks and the border; the
        // variables of each support, and for two pairs of each tile variables and weights.
        let largest = supports.iter().map(|support| support.len() as u64).max().unwrap_or(0);
        let packed = b * (held / b.max(1) + 1) * per_tile as u64;
        let needed_bytes = self.factor_precision.bytes() * (held * 3 * columns + packed)
            + 8 * (held * 7 + 4 * largest * columns + 3 * blocks.matrices_len() as u64 + 3 * b * p);
        if needed_bytes > limit {
            let what = format!("{columns} factors on each of {} supports of up to {largest} variables", supports.len());
            return Err(Error::TooLarge { what, needed_bytes, limit_bytes: limit });
        }
        Ok(())
    }
}
