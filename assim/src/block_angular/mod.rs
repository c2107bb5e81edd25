//! Block-angular regression: Lange's eqs. (15), (28), (29) of WO 93/22625, a solver that knows nothing of weather.
//!
//! Blocks k = 1 … K of rows `y_k = X_k b_k + G_k c + e_k`, Cov(e_k) = V_k, share the border unknowns c, for which there
//! may be prior rows `y_0 = c + e_0`, Cov(e_0) = V_0. With
//!
//! ```text
//! C_k = (X_k' V_k^-1 X_k)^-1          R_k = V_k^-1 − V_k^-1 X_k C_k X_k' V_k^-1       D_k = C_k X_k' V_k^-1 G_k
//! S   = (V_0^-1 + Σ_k G_k' R_k G_k)^-1
//! ĉ   = S (V_0^-1 y_0 + Σ_k G_k' R_k y_k)             b̂_k = C_k X_k' V_k^-1 (y_k − G_k ĉ)
//! Cov(b̂_i, b̂_j) = δ_ij C_i + D_i S D_j'     Cov(b̂_k, ĉ) = −D_k S     Cov(ĉ) = S
//! ```
//!
//! The blocks are independent given c: one parallel map, one ordered reduction of the border's information, one
//! parallel map back. R_k is never formed.
//!
//! [`solve`] takes blocks as they are given; [`BorderRows`] solves without a prior for what they determine, and names the
//! rest. [`solve_sparse`] takes sparse rows and finds the blocks: unknowns that rows
//! link, directly or through others, are a block, and one over a size limit is cut by separators ([`Dissection`]), each of
//! which borders what it separates.

mod block;
mod border;
mod determined;
mod dissection;
mod front;
mod graph;
mod partition;
mod separator;
mod sparse;
mod sparse_regression;

pub(crate) use block::Eliminated;
pub use block::{Block, RegressionRows, UpdateRows};
pub(crate) use border::Information;
pub use border::Prior;
pub(crate) use determined::reduced_basis;
pub use determined::{BorderRows, DeterminedBorder};
pub use dissection::{Dissection, Member};
pub use graph::Graph;
pub use partition::{Component, PartitionReport, components};
pub use sparse::{PartitionSizes, SparseSolution, solve_sparse};
pub use sparse_regression::SparseRegression;

use crate::error::Error;
use crate::linalg::{add_product, column};
use faer::Mat;
use rayon::prelude::*;

/// The estimates, and their covariance in the form blkdiag(C_1 … C_K, 0) + Γ S Γ', Γ = [−D; I].
#[derive(Clone, Debug)]
pub struct Solution {
    /// ĉ, `[p]`.
    pub border: Vec<f64>,
    /// S = Cov(ĉ), `[p, p]`.
    pub border_covariance: Mat<f64>,
    /// b̂_k, C_k and D_k of each block, in the order of the blocks given.
    pub blocks: Vec<BlockSolution>,
    /// Sum of squares of the whitened residuals, of the prior's included: dᵀ Cov(d)⁻¹ d if the rows are innovations d.
    pub residual_chi2: f64,
}

/// The solution of one block.
#[derive(Clone, Debug)]
pub struct BlockSolution {
    /// b̂_k, `[m_k]`.
    pub estimate: Vec<f64>,
    /// C_k = Cov(b̂_k | c), `[m_k, m_k]`.
    pub covariance: Mat<f64>,
    /// D_k = −∂b̂_k/∂c, `[m_k, p]`.
    pub sensitivity: Mat<f64>,
}

/// Solves the block-angular system; exact, and the same bits on any number of threads.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] names a V_k that is not; [`Error::RankDeficient`] a block or a border that the rows
/// do not determine.
///
/// # Panics
/// If the blocks' matrices do not fit each other, or differ in the number of border unknowns.
pub fn solve(blocks: &[Block], border_unknowns: usize, prior: Option<&Prior>) -> Result<Solution, Error> {
    let eliminated: Vec<Eliminated> = blocks
        .par_iter()
        .enumerate()
        .map(|(number, block)| block.eliminate(number, border_unknowns))
        .collect::<Result<_, _>>()?;
    let border = border::solve(&eliminated, border_unknowns, prior)?;
    let solutions = eliminated.into_par_iter().map(|block| back_substitute(block, &border.estimate)).collect();
    Ok(Solution {
        border: border.estimate,
        border_covariance: border.covariance,
        blocks: solutions,
        residual_chi2: border.residual_chi2,
    })
}

/// b̂_k = b̂_k(c = 0) − D_k ĉ.
fn back_substitute(block: Eliminated, border: &[f64]) -> BlockSolution {
    let mut estimate = block.estimate_without_border;
    add_product(estimate.as_mut(), -1.0, block.sensitivity.as_ref(), column(border).as_ref());
    BlockSolution {
        estimate: estimate.col_as_slice(0).to_vec(),
        covariance: block.covariance,
        sensitivity: block.sensitivity,
    }
}
