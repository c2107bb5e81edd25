//! The equations of a flight linearised about the present estimates, and their solution: one block for each fix without a
//! motion of the balloon, a chain of fixes with one.

use super::geometry::{derivatives, from, half_turn, values};
use super::readings::{Fix, Motion, Tracker, offsets_of};
use crate::block_angular::{
    Block, Prior, RegressionRows, Solution, SparseRegression, SparseSolution, solve, solve_sparse,
};
use crate::error::Error;
use crate::linalg::product;
use faer::{Mat, MatRef};
use isobar_obs::SparseRows;
use rayon::prelude::*;

/// Unknowns of a part of the chain of fixes: 32 fixes.
const LARGEST_PART: usize = 96;

/// The equation of a reading: `left = derivatives δb + δc_offset + e`, Var(e) = σ², b the position at its fix.
struct ReadingRow {
    offset: usize,
    derivatives: [f64; 3],
    left: f64,
    sigma: f64,
}

/// The equations of all readings of a flight about the present estimates.
pub(super) struct Linearised {
    /// Those of each fix.
    rows: Vec<Vec<ReadingRow>>,
    /// Number of offsets.
    offsets: usize,
}

impl Linearised {
    pub fn new(trackers: &[Tracker], fixes: &[Fix], positions_m: &[[f64; 3]], offsets: &[f64]) -> Self {
        let numbers = offsets_of(trackers);
        let rows = |(fix, &position): (&Fix, &[f64; 3])| {
            let (mut rows, mut offset) = (Vec::new(), 0);
            for of_tracker in numbers.chunk_by(|a, b| a.0 == b.0) {
                let (tracker, reading) = (&trackers[of_tracker[0].0], fix.readings[of_tracker[0].0].values());
                let relative = from(tracker, position);
                let (model, derivatives, sigmas) = (values(relative), derivatives(relative), tracker.sigmas());
                for &(_, kind) in of_tracker {
                    if let (Some(value), Some(sigma)) = (reading[kind], sigmas[kind]) {
                        let left = value - model[kind] - offsets[offset];
                        let left = if kind == 0 { left } else { half_turn(left) };
                        rows.push(ReadingRow { offset, derivatives: derivatives[kind], left, sigma });
                    }
                    offset += 1;
                }
            }
            rows
        };
        Self { rows: fixes.par_iter().zip(positions_m).map(rows).collect(), offsets: offsets.len() }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.iter().map(Vec::len).sum()
    }

    /// Number of rows of a fix.
    pub fn rows_of(&self, fix: usize) -> usize {
        self.rows[fix].len()
    }

    /// The rows of a fix as a block of eq. (15).
    pub fn block(&self, fix: usize) -> Block {
        let rows = &self.rows[fix];
        let n = rows.len();
        Block::Regression(RegressionRows {
            x: Mat::from_fn(n, 3, |row, i| rows[row].derivatives[i]),
            g: Mat::from_fn(n, self.offsets, |row, j| f64::from(rows[row].offset == j)),
            y: rows.iter().map(|row| row.left).collect(),
            v: Mat::from_fn(n, n, |i, j| if i == j { rows[i].sigma.powi(2) } else { 0.0 }),
        })
    }

    /// The changes of all estimates without a motion.
    pub fn solve_blocks(&self, prior: Option<&Prior>) -> Result<Solved, Error> {
        let blocks: Vec<Block> = (0..self.rows.len()).into_par_iter().map(|fix| self.block(fix)).collect();
        Ok(Solved::Blocks(solve(&blocks, self.offsets, prior)?))
    }

    /// The changes of all estimates with the rows of a motion: three for each fix that has one before and one after it.
    ///
    /// Eq. (2) of WO 93/22625, s_t = s_{t−1} + u_{t−1} + a_t, with the increment u_{t−1} of uniform motion taken from the
    /// interval before, which leaves the random change of the velocity:
    ///
    /// ```text
    /// (b_{k+1} − b_k) / Δ_k − (b_k − b_{k−1}) / Δ_{k−1} = a_k        Var(a_k) = σ² (Δ_{k−1} + Δ_k) / (2 · 60 s)
    /// ```
    pub fn solve_chain(
        &self,
        motion: Motion,
        (fixes, positions_m): (&[Fix], &[[f64; 3]]),
        prior: Option<&Prior>,
    ) -> Result<Solved, Error> {
        let mut x = SparseRows::new();
        let (mut y, mut variance) = (Vec::new(), Vec::new());
        let mut offset = Vec::new();
        for (fix, row) in self.rows.iter().enumerate().flat_map(|(fix, rows)| rows.iter().map(move |row| (fix, row))) {
            x.push_row((0..3).map(|i| (3 * fix + i, row.derivatives[i])));
            y.push(row.left);
            variance.push(row.sigma.powi(2));
            offset.push(row.offset);
        }
        for k in 1..fixes.len() - 1 {
            let span = |k: usize| fixes[k + 1].seconds - fixes[k].seconds;
            let (before, after) = (span(k - 1).recip(), span(k).recip());
            let weights = [(k - 1, before), (k, -before - after), (k + 1, after)];
            for i in 0..3 {
                x.push_row(weights.map(|(fix, weight)| (3 * fix + i, weight)));
                // Differences first: the sum of large terms would lose digits.
                let later = (positions_m[k + 1][i] - positions_m[k][i]) * after;
                y.push((positions_m[k][i] - positions_m[k - 1][i]) * before - later);
                variance.push(motion.variance((span(k - 1) + span(k)) / 2.0));
            }
        }
        let g = Mat::from_fn(y.len(), self.offsets, |row, j| f64::from(offset.get(row) == Some(&j)));
        let system = SparseRegression { unknowns: 3 * fixes.len(), x: &x, g: g.as_ref(), y: &y, variance: &variance };
        Ok(Solved::Chain(solve_sparse(&system, prior, LARGEST_PART)?))
    }
}

/// The solution of the linearised equations.
pub(super) enum Solved {
    Blocks(Solution),
    Chain(SparseSolution),
}

/// Covariances of a coordinate of consecutive positions given the offsets, for each fix and coordinate.
pub(super) struct Moments {
    /// Of a position with itself, `[fixes]`.
    pub variances: Vec<[f64; 3]>,
    /// With the one after it, `[fixes − 1]`.
    pub with_next: Vec<[f64; 3]>,
}

impl Solved {
    /// The changes of the positions.
    pub fn changes(&self) -> Vec<[f64; 3]> {
        match self {
            Self::Blocks(solution) => {
                solution.blocks.iter().map(|block| [0, 1, 2].map(|i| block.estimate[i])).collect()
            }
            Self::Chain(solution) => solution.estimate.as_chunks().0.to_vec(),
        }
    }

    /// The changes of the offsets, and their covariance.
    pub fn border(&self) -> (&[f64], MatRef<'_, f64>) {
        match self {
            Self::Blocks(solution) => (&solution.border, solution.border_covariance.as_ref()),
            Self::Chain(solution) => (&solution.border, solution.border_covariance.as_ref()),
        }
    }

    /// Sum of squares of the whitened residuals.
    pub fn residual_chi2(&self) -> f64 {
        match self {
            Self::Blocks(solution) => solution.residual_chi2,
            Self::Chain(solution) => solution.residual_chi2,
        }
    }

    /// The covariances of positions given the offsets.
    pub fn moments(&self) -> Moments {
        match self {
            Self::Blocks(Solution { blocks, .. }) => Moments {
                variances: blocks.iter().map(|block| [0, 1, 2].map(|i| block.covariance[(i, i)])).collect(),
                with_next: vec![[0.0; 3]; blocks.len() - 1],
            },
            Self::Chain(solution) => {
                let fixes = solution.estimate.len() / 3;
                // The rows of the motion touch a coordinate of neighbours together.
                let pairs: Vec<Vec<usize>> = (0..3 * (fixes - 1)).map(|it| vec![it, it + 3]).collect();
                let found = solution.conditional_covariances(&pairs);
                let entry = |k: usize, at: (usize, usize)| [0, 1, 2].map(|i| found[3 * k + i][at]);
                let mut variances: Vec<[f64; 3]> = (0..fixes - 1).map(|k| entry(k, (0, 0))).collect();
                variances.push(entry(fixes - 2, (1, 1)));
                Moments { variances, with_next: (0..fixes - 1).map(|k| entry(k, (1, 0))).collect() }
            }
        }
    }

    /// −∂b/∂c of a position, `[3, p]`.
    pub fn sensitivity(&self, fix: usize) -> MatRef<'_, f64> {
        match self {
            Self::Blocks(solution) => solution.blocks[fix].sensitivity.as_ref(),
            Self::Chain(solution) => solution.sensitivity.as_ref().get(3 * fix..3 * fix + 3, ..),
        }
    }

    /// The diagonal of D S Dᵀ: variances that the uncertainty of the offsets adds.
    pub fn through_offsets(&self, d: MatRef<'_, f64>) -> [f64; 3] {
        let spread = product(d, self.border().1);
        [0, 1, 2].map(|i| (0..d.ncols()).map(|j| spread[(i, j)] * d[(i, j)]).sum())
    }
}
