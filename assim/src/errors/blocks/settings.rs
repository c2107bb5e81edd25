//! How the Fast Kalman Filter is set up.

use super::grid_blocks::{BlockShape, Blocks};
use crate::covariance;
use crate::error::Error;
use crate::problem::Problem;
use crate::tall_matrix::Precision;
use isobar_model::{Bands, TangentLinear};

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
    /// ρ_i ρ_j C_k, where ρ is how much of its standard deviation each variable keeps, as random draws from
    /// N(0, blkdiag(C_k)) show that are propagated with the factors.
    Probe {
        /// Number of draws.
        count: usize,
    },
}

impl Residual {
    /// Number of draws.
    pub(in crate::errors) fn probes(self) -> usize {
        if let Self::Probe { count } = self { count } else { 0 }
    }
}

impl FastKalmanSettings {
    /// Fails if several ranks cannot divide the filter's work among them.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub(super) fn check_bands(&self, bands: &Bands, problem: &Problem<dyn TangentLinear>) -> Result<(), Error> {
        if self.residual == Residual::Exact {
            problem.require_one_rank("an exact forecast of the blocks")?;
        }
        let (_, rows) = self.blocks.cells(bands.grid());
        let is_cut = |rank: usize| !bands.of_rank(rank).start.is_multiple_of(rows);
        match (0..bands.communicator().ranks()).find(|&rank| is_cut(rank)) {
            None => Ok(()),
            Some(rank) => {
                let first = bands.of_rank(rank).start;
                let message = format!("rank {rank} begins with row {first} of the grid, within blocks of {rows} rows");
                Err(Error::Setting(format!("{message}: choose other blocks, or another number of ranks")))
            }
        }
    }

    /// Fails if they make no sense for a state of `m` values, or need more memory than the limit where a rank has this share of the
    /// blocks and of the factors' rows.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooLarge`].
    pub(super) fn check(
        &self,
        m: usize,
        blocks: &Blocks,
        shared: usize,
        limit_bytes: u64,
        share: f64,
    ) -> Result<(), Error> {
        let (m, b, r) = (m as u64, blocks.variables() as u64, self.factors as u64);
        if r > b {
            return Err(Error::Setting(format!("{r} common factors are more than the {b} variables they describe")));
        }
        if r > 0 && self.bias_coupling == BiasCoupling::Drop {
            let message = "the printed formulae (28)/(29), which drop the coupling, have no factors";
            return Err(Error::Setting(message.into()));
        }
        if self.residual != Residual::Exact && self.bias_coupling == BiasCoupling::Drop {
            let message = "the printed formulae (28)/(29), which drop the coupling, forecast the blocks exactly";
            return Err(Error::Setting(message.into()));
        }
        let extra = (self.residual.probes() as u64).max(covariance::OVERSAMPLING as u64);
        // The blocks, those of Q and their roots; the factors with the probes, and the factors of Q.
        let factors = self.factor_precision.bytes() * b * (2 * r + shared as u64 + extra);
        let of_blocks = 8 * 3 * blocks.matrices_len() as u64;
        let mut needed_bytes = ((of_blocks + factors) as f64 * share) as u64;
        if self.residual == Residual::Exact {
            // The propagator A, and A C as products and as a whole.
            needed_bytes += 8 * (m * m + 2 * m * b);
        }
        if needed_bytes > limit_bytes {
            let what = format!("the covariance of {b} unknowns in {} blocks with {r} factors", blocks.count());
            return Err(Error::TooLarge { what, needed_bytes, limit_bytes });
        }
        Ok(())
    }
}
