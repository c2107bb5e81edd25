//! The fast fixed-lag smoother: ŝ_{t−l} of (20)/(25) of WO 93/22625 by the common factors.
//!
//! The errors of an earlier analysis are rows Ψ_l of the factors as well,
//!
//! ```text
//! Cov(e_{t−l}, (b, c)_t) = Ψ_l Φᵀ,     Ψ_0 = Φ at the analysis,
//! ```
//!
//! rows that no observation sees and no model changes. So all that combines the columns of Φ combines those of Ψ_l: with
//! the forecast's compression `[A Φ, F_Q] V` it is Ψ_l ← Ψ_l V_old, V_old the rows of V that belong to Φ, and at the analysis,
//! with the amplitudes ξ̂ and their covariance S,
//!
//! ```text
//! ŝ_{t−l} ← ŝ_{t−l} + Ψ_l ξ̂,     Var ← Var − diag(Ψ_l (I − S) Ψ_lᵀ),     Ψ_l ← Ψ_l S^½.
//! ```
//!
//! That costs L products of m × r × r per cycle, and never a covariance. Dropped is what residual blocks of different times
//! have in common: estimates revised by less than could be known, with variances that say so. With as many factors as
//! unknowns there is nothing left to drop, and it is the Rauch–Tung–Striebel smoother (see [`crate::fixed_lag`]).

use super::factors::Factors;
use super::past_analyses::{FixedLag, PastAnalysis};
use super::solution::augmented;
use super::{BiasCoupling, BlockErrors, Frame};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::filter::Errors;
use crate::problem::require_memory;
use faer::MatRef;
use isobar_model::vector::add;

impl BlockErrors {
    /// From now on the last `lag` analyses are kept, and revised.
    ///
    /// # Errors
    /// Those of [`FastKalmanFilter::smoothing`](super::FastKalmanFilter::smoothing).
    pub(crate) fn smooth(&mut self, lag: usize) -> Result<(), Error> {
        let Frame { blocks, shared, settings, memory_limit_bytes, .. } = &*self.frame;
        if settings.bias_coupling == BiasCoupling::Drop {
            return Err(Error::Setting("a smoother needs the factors that bias_coupling = \"drop\" drops".into()));
        }
        if self.factors().state.bands().is_some() {
            return Err(Error::Setting("a smoother cannot be computed by several ranks together".into()));
        }
        let columns = (shared.len() + settings.factors) as f64;
        let numbers = (lag as f64 + 1.0) * (blocks.variables() + shared.len()) as f64 * (columns + 2.0);
        require_memory(*memory_limit_bytes, numbers, || {
            format!("a smoother of {lag} analyses with {columns} factors")
        })?;
        self.memory.smoother = Some(FixedLag::new(lag));
        Ok(())
    }

    /// Takes in the newest analysis, which led to `s`.
    pub(crate) fn remember(&mut self, s: &Augmented) {
        let variances = self.memory.smoother.is_some().then(|| self.variances());
        if let (Some(smoother), Some(variances)) = (&mut self.memory.smoother, variances) {
            smoother.analyses.push_back(PastAnalysis { s: s.clone(), variances });
            self.memory.covariance.factors.remember();
        }
    }

    /// Drops the analyses that the next one will no longer revise.
    pub(super) fn drop_past(&mut self) {
        if let Some(smoother) = &mut self.memory.smoother {
            self.memory.covariance.factors.past.drain(..smoother.drop_past());
        }
    }

    /// Forgets the earlier analyses: what follows is independent of them.
    pub(super) fn forget(&mut self) {
        if let Some(smoother) = &mut self.memory.smoother {
            smoother.analyses.clear();
            self.memory.covariance.factors.past.clear();
        }
    }

    /// Adds what the factors from `first` on hold of the earlier analyses to their variances: it was not in Φ before.
    pub(crate) fn widen_past(&mut self, first: usize) {
        let Some(smoother) = &mut self.memory.smoother else { return };
        let Frame { local, shared, .. } = &*self.frame;
        for (past, rows) in smoother.analyses.iter_mut().zip(&self.memory.covariance.factors.past) {
            let (of_blocks, of_shared) = rows.variances(first);
            add(&mut past.variances, &augmented(&of_blocks, &of_shared, local, shared));
        }
    }

    /// Adds U δ to the earlier analyses, for a change δ of what the columns of U are sensitivities to.
    pub(crate) fn shift_past(&mut self, sensitivity: &Factors, shift: &[f64]) {
        let Some(smoother) = &mut self.memory.smoother else { return };
        let Frame { blocks, local, shared, .. } = &*self.frame;
        for (past, rows) in smoother.analyses.iter_mut().zip(&sensitivity.past) {
            let mut of_blocks = vec![0.0; blocks.variables()];
            let of_shared = rows.increments(shift, &mut of_blocks);
            past.s.add(&augmented(&of_blocks, &of_shared, local, shared));
        }
    }

    /// Adds Φ ξ̂ to the increments of b, returns those of c, and revises the earlier analyses; Φ ← Φ T and Ψ ← Ψ T with a lower
    /// triangular T, `root`, where the first `free` columns are no factors.
    pub(super) fn take_in_amplitudes(
        &mut self,
        amplitudes: &[f64],
        root: MatRef<'_, f64>,
        free: usize,
        of_blocks: &mut [f64],
    ) -> Vec<f64> {
        let Frame { local, shared, .. } = &*self.frame;
        let variances = |rows: &Factors| {
            let (of_blocks, of_shared) = rows.variances(free);
            augmented(&of_blocks, &of_shared, local, shared)
        };
        let factors = &mut self.memory.covariance.factors;
        let of_shared = factors.increments(amplitudes, of_blocks);
        let analyses = self.memory.smoother.iter_mut().flat_map(|smoother| &mut smoother.analyses);
        let mut revised: Vec<(&mut PastAnalysis, Vec<f64>)> = analyses
            .zip(&factors.past)
            .map(|(past, rows)| {
                let mut of_blocks = vec![0.0; of_blocks.len()];
                let of_shared = rows.increments(amplitudes, &mut of_blocks);
                past.s.add(&augmented(&of_blocks, &of_shared, local, shared));
                (past, variances(rows))
            })
            .collect();
        factors.multiply_lower(root);
        for ((past, before), rows) in revised.iter_mut().zip(&factors.past) {
            let changes = past.variances.iter_mut().zip(variances(rows).into_iter().zip(before));
            changes.for_each(|(variance, (after, before))| *variance += after - *before);
        }
        of_shared
    }
}
