//! The fusion of estimates of one state with different biases, whose errors are in blocks and factors.

use super::block_diagonal::BlockDiagonal;
use super::factored_covariance::FactoredCovariance;
use super::factors::Factors;
use super::grid_blocks::Blocks;
use super::{BlockErrors, FastKalmanSettings, Residual};
use crate::augmented::Augmented;
use crate::covariance;
use crate::error::Error;
use crate::filter::Belief;
use crate::linalg::{cholesky, column, entries, product, qr, solve_lower, solve_lower_transposed, with_nugget};
use crate::memory::Matrix;
use crate::problem::Problem;
use crate::tall_matrix::TallMatrix;
use faer::{Mat, Scale};
use isobar_model::TangentLinear;
use isobar_model::vector::{add, difference};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;

/// Triangles, their inverse, and rows of the biases, each at most as large as the border, that a fusion holds at one time.
const BORDERS: f64 = 8.0;

/// Rows of factors that one thread triangularises at a time.
const ROWS: usize = 2048;

/// An estimate of x and of the biases of some systems, all of them shared, with its covariance
/// `blkdiag(C_1 … C_K, 0) + Φ Φᵀ`.
struct Fused {
    state: Vec<f64>,
    /// System after system.
    biases: Vec<f64>,
    own: BlockDiagonal,
    factors: Factors,
}

impl Fused {
    /// The estimate of a filter; p of the parameters are estimated.
    fn of(belief: &Belief<BlockErrors>) -> Self {
        let FactoredCovariance { own, factors, .. } = &belief.errors.memory.covariance;
        let Augmented { state, bias } = &belief.s;
        let biases = bias[..factors.shared.nrows()].to_vec();
        Self { state: state.values().to_vec(), biases, own: own.clone(), factors: factors.clone() }
    }

    /// The variances of the state's values.
    fn variances(&self, blocks: &Blocks) -> Vec<f64> {
        let (mut variances, _) = self.factors.variances(0);
        self.own.add_variances(blocks, &mut variances);
        variances
    }

    /// Takes in an estimate x' of the same x with independent errors. With the blocks' errors β ~ N(0, C) and the amplitudes
    /// ξ ~ N(0, I) of the factors, and the same of the other,
    ///
    /// ```text
    /// x = x̂ + β + Φ ξ = x̂' + β' + Φ' ξ'
    /// ```
    ///
    /// is the regression (28)/(29) of each block on the other estimate, with (ξ, ξ') as the border. Given these, with
    /// T_k = C_k + C'_k = L_k L_kᵀ and d = x̂' − x̂, block k is
    ///
    /// ```text
    /// x_k = x̂_k + C_k T_k⁻¹ d_k + Ψ_k (ξ, ξ'),    Ψ_k = [C'_k T_k⁻¹ Φ_k, C_k T_k⁻¹ Φ'_k],    Cov = C_k T_k⁻¹ C'_k,
    /// ```
    ///
    /// and they are what the discrepancies of all blocks make of them, with G_k = \[−Φ_k, Φ'_k\],
    ///
    /// ```text
    /// S = (I + Σ_k G_kᵀ T_k⁻¹ G_k)⁻¹,    (ξ̂, ξ̂') = −S Σ_k G_kᵀ T_k⁻¹ d_k.
    /// ```
    ///
    /// So the sum of the information in the state is of the same form, exactly: blocks C_k T_k⁻¹ C'_k and the factors
    /// \[Ψ; Φ_c, 0; 0, Φ'_c\] S^½, as many as both have together. Nothing is larger than a block or the border, and no C is
    /// inverted: where both are zero, a nugget in T stands for C'. S^½ is the inverse of the triangle of \[I; L⁻¹ G\], whose
    /// condition is the root of that of S.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if T of a block is not.
    fn fuse(self, other: Self, blocks: &Blocks, name: impl Fn(usize) -> String + Sync) -> Result<Self, Error> {
        let mut total = self.variances(blocks);
        add(&mut total, &other.variances(blocks));
        let sum = |block: usize| self.own.block(blocks, block).to_owned() + other.own.block(blocks, block);
        let (nuggets, roots) = inverse_roots(blocks, &total, sum, name)?;
        let Self { mut state, mut biases, mut own, factors } = self;
        let Self { state: their_state, biases: their_biases, own: mut of_first, factors: their_factors } = other;
        let Factors { state: mut first, local, shared, .. } = factors;
        let Factors { state: mut second, shared: their_shared, .. } = their_factors;
        // C' with the nugget, and C, times L⁻ᵀ.
        of_first.for_each_block(blocks, |block, mut matrix| {
            blocks.members(block).iter().enumerate().for_each(|(i, &variable)| matrix[(i, i)] += nuggets[variable]);
            let times = product(matrix.as_ref(), roots.block(blocks, block).transpose());
            matrix.copy_from(times);
        });
        let mut of_second = own.clone();
        of_second.for_each_block(blocks, |block, mut matrix| {
            let times = product(matrix.as_ref(), roots.block(blocks, block).transpose());
            matrix.copy_from(times);
        });
        let d = times_blocks(blocks, &roots, &difference(&their_state, &state));
        [&mut first, &mut second].into_iter().for_each(|factors| edit_blocks(blocks, &roots, factors));
        let Border { inverse, amplitudes } = Border::new(&[(-1.0, &first), (1.0, &second)], &d);
        edit_blocks(blocks, &of_first, &mut first);
        edit_blocks(blocks, &of_second, &mut second);
        let (r, others) = (first.columns(), second.columns());
        first.append(others);
        (0..others).for_each(|j| first.edit_column(r + j, |values| values.copy_from_slice(&second.column(j))));
        drop(second);

        add(&mut state, &times_blocks(blocks, &of_second, &d));
        first.multiply_add(&amplitudes, &mut state);
        let p = shared.nrows();
        let shared = Mat::from_fn(p + their_shared.nrows(), r + others, |i, j| match (i < p, j < r) {
            (true, true) => shared[(i, j)],
            (false, false) => their_shared[(i - p, j - r)],
            _ => 0.0,
        });
        biases.extend(their_biases);
        add(&mut biases, product(shared.as_ref(), column(&amplitudes).as_ref()).col_as_slice(0));
        own.for_each_block(blocks, |block, mut matrix| {
            let half = product(of_second.block(blocks, block), of_first.block(blocks, block).transpose());
            let size = half.nrows();
            for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
                matrix[(i, j)] = 0.5 * (half[(i, j)] + half[(j, i)]);
            }
        });
        first.recombine(None, inverse.as_ref());
        let local = TallMatrix::zeros(0, inverse.ncols(), local.precision());
        let shared = Matrix(product(shared.as_ref(), inverse.as_ref()));
        let factors = Factors { state: first, local, shared, past: VecDeque::new() };
        Ok(Self { state, biases, own, factors })
    }
}

/// What the border makes of factors W of some systems, whitened block by block, and of the discrepancies.
pub(super) struct Border {
    /// S^½, `[r, r]`.
    pub inverse: Mat<f64>,
    /// ξ̂, `[r]`.
    pub amplitudes: Vec<f64>,
}

impl Border {
    /// The least squares of \[I; W\] ξ + \[0; d\], W the given columns times a sign.
    pub fn new(parts: &[(f64, &TallMatrix)], d: &[f64]) -> Self {
        let r: usize = parts.iter().map(|(_, part)| part.columns()).sum();
        let starts: Vec<usize> = (0..d.len()).step_by(ROWS).collect();
        let triangle = |&first: &usize| {
            let (count, mut scratch) = (ROWS.min(d.len() - first), Vec::new());
            let (mut rows, mut at) = (Mat::zeros(count, r + 1), 0);
            for (sign, part) in parts {
                let values = part.part(first, count, 0, &mut scratch) * Scale(*sign);
                rows.as_mut().get_mut(.., at..at + part.columns()).copy_from(values);
                at += part.columns();
            }
            rows.col_as_slice_mut(r).copy_from_slice(&d[first..first + count]);
            qr(rows.as_ref()).thin_R().to_owned()
        };
        let triangles: Vec<Mat<f64>> = starts.par_iter().map(triangle).collect();
        let prior = Mat::from_fn(r + 1, r + 1, |i, j| if i == j && i < r { 1.0 } else { 0.0 });
        // In their order: the same sums on any number of threads.
        let all =
            triangles.into_iter().fold(prior, |before, next| {
                let rows = before.nrows();
                let both = Mat::from_fn(rows + next.nrows(), r + 1, |i, j| {
                    if i < rows { before[(i, j)] } else { next[(i - rows, j)] }
                });
                qr(both.as_ref()).thin_R().to_owned()
            });
        let triangle = all.get(..r, ..r);
        let mut inverse = Mat::identity(r, r);
        solve_lower_transposed(triangle.transpose(), inverse.as_mut());
        let found = product(inverse.as_ref(), all.get(..r, r..));
        let amplitudes = (0..r).map(|i| -found[(i, 0)]).collect();
        Self { inverse, amplitudes }
    }
}

/// The nuggets of all variables, as shares of these variances, those of the factors included, and the inverses of the lower
/// Cholesky factors of some blocks with them. A variable without any variance, such as that on a wall, is left alone by any
/// unit in its place.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] for a block that has none with any nugget; `name` says which.
pub(super) fn inverse_roots(
    blocks: &Blocks,
    total: &[f64],
    matrix: impl Fn(usize) -> Mat<f64> + Sync,
    name: impl Fn(usize) -> String + Sync,
) -> Result<(Vec<f64>, BlockDiagonal), Error> {
    let nugget = |variable: usize, share: f64| if total[variable] == 0.0 { 1.0 } else { share * total[variable] };
    let factor = |block: usize, share: f64| {
        let mut matrix = matrix(block);
        let members = blocks.members(block).iter().enumerate();
        members.for_each(|(i, &variable)| matrix[(i, i)] += nugget(variable, share));
        cholesky(matrix, || format!("the covariance that is fused in {}", name(block)))
    };
    let factored: Vec<(f64, Mat<f64>)> = (0..blocks.count())
        .into_par_iter()
        .map(|block| with_nugget(|share| factor(block, share)))
        .collect::<Result<_, Error>>()?;
    let mut roots = BlockDiagonal::zeros(blocks);
    roots.for_each_block(blocks, |block, mut root| {
        (0..root.nrows()).for_each(|i| root[(i, i)] = 1.0);
        solve_lower(factored[block].1.as_ref(), root);
    });
    let nuggets = (0..total.len()).map(|variable| nugget(variable, factored[blocks.place(variable).0].0)).collect();
    Ok((nuggets, roots))
}

/// M x, M in blocks.
fn times_blocks(blocks: &Blocks, matrices: &BlockDiagonal, x: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; x.len()];
    for block in 0..blocks.count() {
        let (members, matrix) = (blocks.members(block), matrices.block(blocks, block));
        for (j, &column) in members.iter().enumerate() {
            let entries = entries(matrix.col(j));
            members.iter().zip(entries).for_each(|(&row, entry)| product[row] += entry * x[column]);
        }
    }
    product
}

/// A ← M A, M in blocks.
pub(super) fn edit_blocks(blocks: &Blocks, matrices: &BlockDiagonal, columns: &mut TallMatrix) {
    columns.edit_columns(|column| {
        let product = times_blocks(blocks, matrices, column);
        column.copy_from_slice(&product);
    });
}

/// Fuses the estimates of local filters, each with the numbers of its parameters among those of the master, into the master's.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if the sum of two covariances in a block is not.
pub(crate) fn fuse(master: &mut Belief<BlockErrors>, local: &[(&Belief<BlockErrors>, &[usize])]) -> Result<(), Error> {
    let ((first, _), others) = local.split_first().expect("there is a system at least");
    if others.is_empty() {
        master.s = first.s.clone();
        master.errors.memory.covariance = first.errors.memory.covariance.clone();
        return Ok(());
    }
    let frame = Arc::clone(&master.errors.frame);
    let mut fused = Fused::of(first);
    for (other, _) in others {
        fused = fused.fuse(Fused::of(other), &frame.blocks, |block| frame.blocks.describe(block, &frame.layout))?;
    }
    let Fused { state, biases, own, mut factors } = fused;
    // The biases stand there system after system, and p of them are estimated.
    let p = biases.len();
    let order: Vec<usize> = local.iter().flat_map(|(_, numbers)| numbers.iter().copied()).take(p).collect();
    let mut shared = Mat::zeros(p, factors.columns());
    for (i, &number) in order.iter().enumerate() {
        master.s.bias[number] = biases[i];
        (0..shared.ncols()).for_each(|j| shared[(number, j)] = factors.shared[(i, j)]);
    }
    factors.shared = Matrix(shared);
    master.s.state.values_mut().copy_from_slice(&state);
    master.errors.memory.covariance = FactoredCovariance { own, linked: Vec::new(), factors };
    Ok(())
}

impl BlockErrors {
    /// Multiplies the covariances of the state's errors and of the model's; there are no local parameters with it unless it
    /// is 1.
    pub(crate) fn inflate(&mut self, factor: f64) {
        if factor == 1.0 {
            return;
        }
        let FactoredCovariance { own, factors, .. } = &mut self.memory.covariance;
        own.values_mut().iter_mut().for_each(|value| *value *= factor);
        factors.state.scale(factor.sqrt());
        let frame = Arc::get_mut(&mut self.frame).expect("no clone has been made yet");
        frame.model_error = frame.model_error.as_ref().map(|model_error| model_error.times(factor));
    }

    /// Fails unless there is memory for `systems` filters with these settings, their master and a fusion: factors of each with
    /// those of Q, the master's, and these twice more; the blocks of all; the border; and the propagators of exact forecasts.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    pub(crate) fn require_memory_of_federation(
        problem: &Problem<dyn TangentLinear>,
        settings: &FastKalmanSettings,
        systems: usize,
    ) -> Result<(), Error> {
        let layout = problem.background.layout();
        let blocks = Blocks::new(layout, settings.blocks, &[]).matrices_len() as f64;
        let (m, p) = (layout.len(), problem.estimated_calibration().len());
        let (count, r) = (systems as f64, settings.factors as f64);
        let extra = settings.residual.probes().max(covariance::OVERSAMPLING) as f64;
        let of_filters = count * (2.0 * r + extra) + p as f64;
        let of_master = count * r + p as f64;
        let stored = settings.factor_precision.bytes() as f64 / 8.0;
        // A, and A C as products and as a whole, in each filter.
        let exact = if settings.residual == Residual::Exact { 3.0 * count * (m as f64).powi(2) } else { 0.0 };
        let border = BORDERS * of_master * of_master;
        let numbers =
            stored * m as f64 * (of_filters + 3.0 * of_master) + (3.0 * count + 6.0) * blocks + border + exact;
        problem.require_memory(numbers, || {
            format!(
                "{systems} Fast Kalman Filters for {m} values each, with {} factors, and their fusion",
                settings.factors
            )
        })
    }
}

#[cfg(test)]
pub(super) mod tests;
