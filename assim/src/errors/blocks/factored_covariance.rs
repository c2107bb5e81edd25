//! The covariance of (b, c) in the form blkdiag(C_1 … C_K, 0) + Φ Φᵀ.

use super::block_diagonal::BlockDiagonal;
use super::factors::Factors;
use super::grid_blocks::Blocks;
use crate::error::Error;
use crate::linalg::product;
use crate::memory::{Matrix, require};
use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

/// The covariance of the block variables of some blocks that observations have linked.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Patch {
    /// Numbers of the block variables, ascending.
    pub variables: Vec<usize>,
    /// Their covariance, `[variables, variables]`.
    pub covariance: Matrix,
}

/// Cov(b, c): a block-diagonal part and common factors.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct FactoredCovariance {
    /// C_1 … C_K.
    pub own: BlockDiagonal,
    /// What an analysis has linked beyond the blocks: the whole covariance of those variables, whose part within each
    /// block is also in `own`. Empty unless the forecast is exact.
    pub linked: Vec<Patch>,
    /// Φ.
    pub factors: Factors,
}

impl FactoredCovariance {
    /// The variances of the block variables and of the shared parameters. Collective.
    pub fn variances(&self, blocks: &Blocks) -> (Vec<f64>, Vec<f64>) {
        let (mut of_blocks, of_shared) = self.factors.variances(0);
        self.own.add_variances(blocks, &mut of_blocks);
        let of_local = of_blocks.split_off(self.factors.state.rows());
        let mut of_blocks = self.factors.state.of_all_ranks(of_blocks);
        of_blocks.extend(self.of_owners(of_local, |local| blocks.place(self.factors.state.rows() + local).0));
        (of_blocks, of_shared)
    }

    /// What each rank has found of things that are in blocks, as the rank of the block has it.
    fn of_owners(&self, mut values: Vec<f64>, block_of: impl Fn(usize) -> usize) -> Vec<f64> {
        let elsewhere = |number: &usize| !self.own.own().contains(&block_of(*number));
        (0..values.len()).filter(elsewhere).for_each(|number| values[number] = 0.0);
        self.factors.sum(&mut values);
        values
    }

    /// The patches that make up the block-diagonal part, those of this rank: linked ones, and the blocks that are in none. A block is
    /// never split: all of it is in one patch.
    pub fn patches<'a>(&'a self, blocks: &'a Blocks) -> Vec<(&'a [usize], MatRef<'a, f64>)> {
        let mut in_patch = vec![false; blocks.count()];
        let mut patches = Vec::new();
        for patch in &self.linked {
            patch.variables.iter().for_each(|&variable| in_patch[blocks.place(variable).0] = true);
            patches.push((patch.variables.as_slice(), patch.covariance.as_ref()));
        }
        let alone = self.own.own().clone().filter(|&block| !in_patch[block]);
        patches.extend(alone.map(|block| (blocks.members(block), self.own.block(blocks, block))));
        patches
    }

    /// The whole matrix, `[block variables + shared parameters]²`, for tests and queries on small problems.
    pub fn dense(&self, blocks: &Blocks) -> Mat<f64> {
        let (b, c) = (blocks.variables(), self.factors.shared.nrows());
        let factors = Mat::from_fn(b + c, self.factors.columns(), |i, j| {
            if i < b { self.factors.value(i, j) } else { self.factors.shared[(i - b, j)] }
        });
        let mut dense = product(factors.as_ref(), factors.transpose());
        for (variables, covariance) in self.patches(blocks) {
            for (j, &column) in variables.iter().enumerate() {
                for (i, &row) in variables.iter().enumerate() {
                    dense[(row, column)] += covariance[(i, j)];
                }
            }
        }
        dense
    }

    /// Fails unless it is one of these blocks, as another is.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, blocks: &Blocks, like: &FactoredCovariance) -> Result<(), Error> {
        require(self.own.is_like(&like.own), "the covariance of the blocks")?;
        // No variable is in two patches, and those of a patch ascend.
        let mut held = vec![false; blocks.variables()];
        for Patch { variables, covariance } in &self.linked {
            let fits = variables.is_sorted_by(|a, b| a < b)
                && covariance.has_shape(variables.len(), variables.len())
                && variables.iter().all(|&variable| held.get(variable) == Some(&false));
            require(fits, "a patch of blocks")?;
            variables.iter().for_each(|&variable| held[variable] = true);
        }
        Ok(())
    }
}
