//! The fixed-lag smoother with local factors: ŝ_{t−l} of (20)/(25) of WO 93/22625.
//!
//! The errors of an earlier analysis are further rows Ψ_l of the factors and of the border, as in `blocks::fixed_lag`,
//!
//! ```text
//! Cov(e_{t−l}, b_t) = Σ_j Ψ_lj F_jᵀ + Γ_l S Γᵀ        Cov(e_{t−l}, c_t) = Γ_l S
//! ```
//!
//! with Ψ_lj = F_j and Γ_l = [Γ; I] at the analysis itself, where the last rows are those of the shared parameters. No model
//! changes them, and no observation sees them. What recombines the columns of the tiles, `F'_j = Σ_i F_i T_ij`, recombines
//! theirs: rotations, compression and the root of an analysis, each on the support of its tile. Model error and the drift of
//! biases, c' = φ c + w, are independent of them:
//!
//! ```text
//! drift      Γ_l ← Γ_l S φ S'⁻¹
//! analysis   ŝ_{t−l} ← ŝ_{t−l} + Σ_j Ψ_lj ξ̂_j + Γ_l δc
//!            Γ_l ← Γ_l − Σ_j Ψ_lj (M⁻¹ M_xc)_j        Ψ_lj ← Σ_i Ψ_li (M^-½)_ij
//!            Var ← Var + diag(Σ_j Ψ_lj Ψ_ljᵀ + Γ_l S Γ_lᵀ) after − the same before
//! ```
//!
//! What is cut off or dropped stays in the variances as an error that nothing later sees. Where a compression mixes what it
//! leaves over, the squares of the random sums replace those of their terms in the variances, as they do in the present.
//!
//! A cycle costs lag + 1 products of the rows of each support with r × r matrices for each tile nearby, and never a covariance.

use super::amplitudes::{Amplitudes, Solved};
use super::local_factors::LocalFactors;
use super::recombination::Recombination;
use super::{Frame, LocalErrors};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::blocks::{FixedLag, PastAnalysis, augmented};
use crate::filter::Errors;
use crate::linalg::{column, product};
use crate::memory::{Matrix, require};
use crate::problem::require_memory;
use faer::{Mat, MatRef};
use isobar_model::vector::add;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The earlier analyses, and the rows of their errors.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Past {
    analyses: FixedLag,
    /// One for each of them.
    rows: VecDeque<PastRows>,
}

/// The rows of an earlier analysis' errors.
#[derive(Clone, Serialize, Deserialize)]
struct PastRows {
    /// Ψ_lj, each on the support of its tile.
    factors: Vec<LocalFactors>,
    /// Γ_l, `[block variables + shared, shared]`.
    sensitivity: Matrix,
}

impl PastRows {
    /// The variances through the factors and through the border, `[block variables + shared]`.
    fn variances(&self, shared: MatRef<'_, f64>) -> Vec<f64> {
        let mut variances = vec![0.0; self.sensitivity.nrows()];
        self.factors.iter().for_each(|factors| factors.add_squared_rows(&mut variances));
        add_border_variances(self.sensitivity.as_ref(), shared, &mut variances);
        variances
    }
}

/// Adds diag(Γ S Γᵀ).
pub(super) fn add_border_variances(sensitivity: MatRef<'_, f64>, shared: MatRef<'_, f64>, variances: &mut [f64]) {
    let of_border = product(sensitivity, shared);
    for j in 0..shared.ncols() {
        let products = of_border.col(j).iter().zip(sensitivity.col(j).iter());
        variances.iter_mut().zip(products).for_each(|(variance, (a, b))| *variance += a * b);
    }
}

impl Past {
    pub fn lag(&self) -> usize {
        self.analyses.lag
    }

    pub fn analyses(&self) -> &FixedLag {
        &self.analyses
    }

    /// Fails unless it is that of a smoother of this lag, of estimates like `s`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, lag: usize, s: &Augmented, frame: &Frame, present: &[LocalFactors]) -> Result<(), Error> {
        let (b, p) = (frame.blocks.variables(), frame.shared.len());
        self.analyses.require(lag, s, b + p, self.rows.len())?;
        let fits = self.rows.iter().all(|rows| {
            let mut pairs = rows.factors.iter().zip(present);
            rows.factors.len() == present.len()
                && pairs.all(|(own, now)| {
                    own.is_whole()
                        && own.variables == now.variables
                        && (own.columns(), own.precision()) == (now.columns(), now.precision())
                })
                && rows.sensitivity.has_shape(b + p, p)
        });
        require(fits, "the rows of an earlier analysis")
    }
}

impl LocalErrors {
    /// From now on the last `lag` analyses are kept, and revised.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if their rows do not fit into the memory limit.
    pub(super) fn smooth(&mut self, lag: usize) -> Result<(), Error> {
        let Frame { blocks, shared, supports, settings, memory_limit_bytes, .. } = &*self.frame;
        let held: usize = supports.iter().map(Vec::len).sum();
        let rows = held as f64 * (1.0 + settings.per_tile as f64 * settings.factor_precision.bytes() as f64 / 8.0);
        let border = (blocks.variables() + shared.len()) as f64 * (shared.len() + 2) as f64;
        require_memory(*memory_limit_bytes, (lag as f64 + 1.0) * (rows + border), || {
            format!("a smoother of {lag} analyses with {} factors of each tile", settings.per_tile)
        })?;
        self.memory.past = Some(Past { analyses: FixedLag::new(lag), rows: VecDeque::with_capacity(lag + 1) });
        Ok(())
    }

    /// Takes in the newest analysis, which led to `s`.
    pub(super) fn remember(&mut self, s: &Augmented) {
        let variances = self.memory.past.is_some().then(|| self.variances());
        let super::Memory { factors, sensitivity, past, .. } = &mut self.memory;
        let (Some(past), Some(variances)) = (past, variances) else { return };
        let (b, p) = (sensitivity.nrows(), sensitivity.ncols());
        let row = |i: usize, j: usize| if i < b { sensitivity[(i, j)] } else { f64::from(u8::from(i - b == j)) };
        let rows = PastRows { factors: factors.clone(), sensitivity: Matrix(Mat::from_fn(b + p, p, row)) };
        past.analyses.analyses.push_back(PastAnalysis { s: s.clone(), variances });
        past.rows.push_back(rows);
    }

    /// Drops the analyses that the next one will no longer revise.
    pub(super) fn drop_past(&mut self) {
        if let Some(Past { analyses, rows }) = &mut self.memory.past {
            rows.drain(..analyses.drop_past());
        }
    }

    /// Forgets the earlier analyses: what follows is independent of them.
    pub(super) fn forget(&mut self) {
        if let Some(Past { analyses, rows }) = &mut self.memory.past {
            analyses.analyses.clear();
            rows.clear();
        }
    }

    /// Γ_l ← Γ_l S φ S'⁻¹, where `transition` is S φ S'⁻¹, `[shared, shared]`.
    pub(super) fn drift_past(&mut self, transition: MatRef<'_, f64>) {
        for rows in self.memory.past.iter_mut().flat_map(|past| &mut past.rows) {
            rows.sensitivity = Matrix(product(rows.sensitivity.as_ref(), transition));
        }
    }

    /// Ψ_lj ← Σ_i Ψ_li T_ij on the support of each tile. `left`, if any, is the recombination that yields the columns which are
    /// mixed, and the number of the first column that is a sum of these: in the variances its squares replace theirs.
    pub(super) fn recombine_past(&mut self, recombination: &Recombination, left: Option<(&Recombination, usize)>) {
        let Some(Past { analyses, rows }) = &mut self.memory.past else { return };
        let Frame { supports, blocks, local, shared, .. } = &*self.frame;
        for (past, rows) in analyses.analyses.iter_mut().zip(rows) {
            let recombined = recombination.within(&rows.factors, supports);
            if let Some((left, kept)) = left {
                let mut changes = vec![0.0; blocks.variables()];
                left.within(&rows.factors, supports).iter().for_each(|factors| factors.add_squared_rows(&mut changes));
                changes.iter_mut().for_each(|change| *change = -*change);
                for factors in &recombined {
                    factors.add_squared_rows_from(kept, &mut changes);
                }
                add(&mut past.variances, &augmented(&changes, &vec![0.0; shared.len()], local, shared));
            }
            rows.factors = recombined;
        }
    }

    /// Revises the earlier analyses by the amplitudes of a new one, whose border had the covariance `before`.
    pub(super) fn revise_past(
        &mut self,
        amplitudes: &Amplitudes,
        solved: &Solved,
        roots: &Recombination,
        before: MatRef<'_, f64>,
    ) {
        let Some(Past { analyses, rows }) = &mut self.memory.past else { return };
        let Frame { supports, blocks, local, shared, .. } = &*self.frame;
        let (b, p) = (blocks.variables(), shared.len());
        for (past, rows) in analyses.analyses.iter_mut().zip(rows) {
            let mut increment = vec![0.0; b + p];
            let mut changes: Vec<f64> = rows.variances(before).into_iter().map(|variance| -variance).collect();
            for (tile, factors) in rows.factors.iter().enumerate() {
                factors.multiply_add(&solved.amplitudes[amplitudes.of(tile)], &mut increment);
            }
            let of_border = product(rows.sensitivity.as_ref(), column(&solved.border).as_ref());
            add(&mut increment, of_border.col_as_slice(0));
            past.s.add(&augmented(&increment[..b], &increment[b..], local, shared));
            for (tile, factors) in rows.factors.iter().enumerate() {
                factors.subtract_products(solved.of_border.get(amplitudes.of(tile), ..), &mut rows.sensitivity);
            }
            let (inside, outside): (Vec<_>, Vec<_>) = roots.parts(&rows.factors, supports, b).into_iter().unzip();
            inside.iter().chain(&outside).for_each(|factors: &LocalFactors| factors.add_squared_rows(&mut changes));
            add_border_variances(rows.sensitivity.as_ref(), solved.shared.as_ref(), &mut changes);
            add(&mut past.variances, &augmented(&changes[..b], &changes[b..], local, shared));
            rows.factors = inside;
        }
    }
}
