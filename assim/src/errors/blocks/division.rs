//! The division of an estimate whose errors are in blocks and factors among local filters.

use super::BlockErrors;
use super::block_diagonal::BlockDiagonal;
use super::compression::{Joining, Kept, join_and_compress, rounding};
use super::factored_covariance::FactoredCovariance;
use super::factors::Factors;
use super::fusion::{Border, edit_blocks, inverse_roots};
use super::grid_blocks::Blocks;
use crate::error::Error;
use crate::filter::Belief;
use crate::linalg::{cholesky, eigen, product, solved_lower};
use crate::memory::Matrix;
use crate::tall_matrix::{TallMatrix, scaled_gram};
use faer::{Mat, Scale};
use std::collections::VecDeque;

/// What a division of a fused estimate among local filters needs of it.
pub(super) struct Division<'a> {
    own: &'a BlockDiagonal,
    factors: &'a Factors,
    /// (I + M)^-½, `[r, r]`, with M = Φ_bᵀ C⁻¹ Φ_b.
    given_state: Mat<f64>,
    /// The eigenvalues of M that are not zero, and the eigenvectors, `[r, k]`.
    values: Vec<f64>,
    vectors: Mat<f64>,
}

/// Eigenvalues of M below this part of the largest are of no state.
const LEAST: f64 = 1e-14;

impl<'a> Division<'a> {
    /// That of a covariance with these blocks C and factors Φ; see [`divide`](Self::divide).
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if a block is not.
    pub fn new(
        own: &'a BlockDiagonal,
        factors: &'a Factors,
        blocks: &Blocks,
        name: impl Fn(usize) -> String + Sync,
    ) -> Result<Self, Error> {
        let (mut total, _) = factors.variances(0);
        own.add_variances(blocks, &mut total);
        let (_, roots) = inverse_roots(blocks, &total, |block| own.block(blocks, block).to_owned(), name)?;
        let mut whitened = factors.state.clone();
        edit_blocks(blocks, &roots, &mut whitened);
        let Border { inverse, .. } = Border::new(&[(1.0, &whitened)], &vec![0.0; whitened.rows()]);
        let gram = scaled_gram(&whitened, &vec![1.0; whitened.rows()]);
        let (values, vectors) = eigen(gram.as_ref());
        let largest = values.last().copied().unwrap_or(0.0);
        let first = values.partition_point(|value| *value <= LEAST * largest);
        let vectors = vectors.get(.., first..).to_owned();
        Ok(Self { own, factors, given_state: inverse, values: values[first..].to_vec(), vectors })
    }

    /// The covariance of a local filter with the share β of the information on x, and all of that on its biases given x,
    ///
    /// ```text
    /// P_xx/β,    P_xc/β,    P_cc + (1/β − 1) P_cx P_xx⁻¹ P_xc,
    /// ```
    ///
    /// c being the parameters of these rows of Φ_c. With W = I − (I + M)⁻¹ it is P_cx P_xx⁻¹ P_xc = Φ_c W Φ_cᵀ. The first
    /// factors carry the biases, `Ω Ωᵀ = Φ_c (I + (1/β − 1) W) Φ_cᵀ`, and with them of the state Φ_b E, `E = Φ_cᵀ Ω⁻ᵀ/β`. What
    /// is left of the state's covariance is
    ///
    /// ```text
    /// C/β + Φ_b Y Φ_bᵀ,    Y = I/β − E Eᵀ.
    /// ```
    ///
    /// Y is not positive semidefinite, though the whole is: c goes with the blocks' errors as well, and the more of it that
    /// E holds, the less is left to them. With M = V D Vᵀ and D^½ Vᵀ Y V D^½ = U Λ Uᵀ the columns F = Φ_b V D^-½ U |Λ|^½ split it
    /// into F₊ F₊ᵀ − F₋ F₋ᵀ, and no λ is less than −1/β. The F₊ are further factors. Of F₋ F₋ᵀ the block diagonal is taken
    /// from C/β, which stays positive semidefinite, since C^-½ F₋ |Λ|^-½ has orthonormal columns; what it is between blocks,
    /// of the rank of the biases, is dropped, as what a compression leaves over. So every block keeps its own covariance,
    /// and with one block, or where there is nothing in the blocks, the division is that of dense covariances.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if the biases' covariance has lost its meaning.
    pub fn divide(&self, blocks: &Blocks, share: f64, parameters: &[usize]) -> Result<(BlockDiagonal, Factors), Error> {
        let (factors, mut own) = (self.factors, self.own.clone());
        let (p, r) = (parameters.len(), factors.columns());
        own.values_mut().iter_mut().for_each(|value| *value /= share);
        let mut state = factors.state.clone();
        let none = || TallMatrix::zeros(0, 0, factors.local.precision());
        let of = |state: TallMatrix, shared: Mat<f64>| {
            let mut local = none();
            local.append(state.columns());
            Factors { state, local, shared: Matrix(shared), past: VecDeque::new() }
        };
        if p == 0 {
            state.scale(1.0 / share.sqrt());
            return Ok((own, of(state, Mat::zeros(0, r))));
        }
        let biases = Mat::from_fn(p, r, |i, j| factors.shared[(parameters[i], j)]);
        let given = product(biases.as_ref(), self.given_state.as_ref());
        let mut covariance = product(biases.as_ref(), biases.transpose()) * Scale(1.0 / share);
        covariance -= product(given.as_ref(), given.transpose()) * Scale(1.0 / share - 1.0);
        let carried = cholesky(covariance, || "the covariance of the biases of a local filter".into())?;
        let with_state = solved_lower(carried.as_ref(), biases).transpose() * Scale(1.0 / share);
        // D^½ Vᵀ Y V D^½.
        let k = self.values.len();
        let seen = product(self.vectors.transpose(), with_state.as_ref());
        let root = |i: usize| self.values[i].sqrt();
        let outer = product(seen.as_ref(), seen.transpose());
        let left = Mat::from_fn(k, k, |i, j| {
            let identity = if i == j { 1.0 / share } else { 0.0 };
            root(i) * (identity - outer[(i, j)]) * root(j)
        });
        let (values, directions) = eigen(left.as_ref());
        let columns = |wanted: &dyn Fn(f64) -> bool| {
            let chosen: Vec<usize> = (0..k).filter(|&j| wanted(values[j])).collect();
            let scaled = Mat::from_fn(k, chosen.len(), |i, j| {
                directions[(i, chosen[j])] * values[chosen[j]].abs().sqrt() / root(i)
            });
            product(self.vectors.as_ref(), scaled.as_ref())
        };
        let least = LEAST * values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let (more, less) = (columns(&|value| value > least), columns(&|value| value < -least));
        let mut all = vec![0.0; blocks.variables()];
        own.add_variances(blocks, &mut all);
        let mut taken = state.clone();
        taken.recombine(None, less.as_ref());
        own.add_factors(blocks, -1.0, &of(taken, Mat::zeros(0, less.ncols())));
        own.clear_rounding(blocks, &all, rounding(r));
        let mut recombination = Mat::zeros(r, p + more.ncols());
        recombination.as_mut().get_mut(.., ..p).copy_from(&with_state);
        recombination.as_mut().get_mut(.., p..).copy_from(&more);
        state.recombine(None, recombination.as_ref());
        let shared = Mat::from_fn(p, p + more.ncols(), |i, j| if j < p { carried[(i, j)] } else { 0.0 });
        Ok((own, of(state, shared)))
    }
}

/// Divides a master's estimate among local filters, each with its share β and the numbers of its parameters. The master's
/// factors are compressed for it to as many as a filter keeps beside those of the biases.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if a covariance has lost its meaning.
pub(crate) fn divide(
    master: &Belief<BlockErrors>,
    local: &mut [(&mut Belief<BlockErrors>, f64, &[usize])],
) -> Result<(), Error> {
    let frame = &*master.errors.frame;
    let mut covariance = master.errors.memory.covariance.clone();
    let p = covariance.factors.shared.nrows();
    let joining = Joining { model_error: None, drift: &vec![0.0; p] };
    let kept = Kept { at_most: frame.settings.factors, retained: frame.settings.retained_energy };
    join_and_compress(&mut covariance, &joining, kept, &frame.scales, &frame.blocks);
    let FactoredCovariance { own, factors, .. } = covariance;
    let division = Division::new(&own, &factors, &frame.blocks, |block| frame.blocks.describe(block, &frame.layout))?;
    for (belief, share, numbers) in local {
        let numbers = if p == 0 { &[] } else { *numbers };
        let (own, factors) = division.divide(&frame.blocks, *share, numbers)?;
        belief.s.state.values_mut().copy_from_slice(master.s.state.values());
        let values = numbers.iter().map(|&number| master.s.bias[number]);
        belief.s.bias.iter_mut().zip(values).for_each(|(own, value)| *own = value);
        belief.errors.memory.covariance = FactoredCovariance { own, linked: Vec::new(), factors };
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::fusion::tests::{blocks, covariance};
    use super::*;
    use faer::Side;
    use faer::linalg::solvers::Solve;

    /// The covariance within each block, that of the biases, and of these with the state are those of the dense division, and
    /// the whole is a covariance.
    #[test]
    fn what_a_division_keeps_is_exact() {
        let blocks = blocks();
        let m = blocks.variables();
        for (r, share, parameters) in
            [(5, 0.3, vec![1]), (5, 0.6, vec![0, 2]), (3, 0.5, vec![0, 1, 2]), (4, 0.5, vec![])]
        {
            let whole = covariance(&blocks, 3, r, 7);
            let dense = whole.dense(&blocks);
            let FactoredCovariance { own, factors, .. } = &whole;
            let division = Division::new(own, factors, &blocks, |block| block.to_string()).unwrap();
            let (own, factors) = division.divide(&blocks, share, &parameters).unwrap();
            let found = FactoredCovariance { own, linked: Vec::new(), factors }.dense(&blocks);
            let of_state = dense.get(..m, ..m).to_owned();
            let regression = of_state.llt(Side::Lower).unwrap().solve(dense.get(..m, m..).to_owned());
            let explained = product(dense.get(m.., ..m), regression.as_ref());
            let mut dropped: f64 = 0.0;
            for (i, j) in (0..found.nrows()).flat_map(|i| (0..found.nrows()).map(move |j| (i, j))) {
                let number = |i: usize| if i < m { i } else { m + parameters[i - m] };
                let value = dense[(number(i), number(j))];
                let expected = if i >= m && j >= m {
                    value + (1.0 / share - 1.0) * explained[(parameters[i - m], parameters[j - m])]
                } else {
                    value / share
                };
                let error = (found[(i, j)] - expected).abs();
                if i < m && j < m && blocks.place(i).0 != blocks.place(j).0 {
                    dropped = dropped.max(error);
                } else {
                    assert!(error < 1e-8, "{r} factors, {parameters:?}, ({i}, {j}): {error:e}");
                }
            }
            assert_eq!(dropped > 1e-8, !parameters.is_empty(), "{parameters:?}: {dropped:e}");
            let eigenvalues = found.self_adjoint_eigenvalues(Side::Lower).unwrap();
            assert!(eigenvalues[0] > -1e-10, "{}", eigenvalues[0]);
        }
    }
}
