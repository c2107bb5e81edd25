//! The calibration parameters in the covariance with local factors.

use super::{Frame, LocalErrors};
use crate::error::Error;
use crate::errors::blocks::rounding;
use crate::linalg::{cholesky, product, semidefinite_root, solve_lower, solve_lower_transposed};
use crate::memory::Matrix;
use faer::{Mat, MatRef};
use isobar_model::vector::scale;
use std::sync::Arc;

impl LocalErrors {
    /// Adds an error of the parameters, with covariance ΔP in the order of the calibration, `[p, p]`.
    ///
    /// # Errors
    /// If the covariance of the shared parameters is not positive definite then.
    pub(super) fn add_calibration_errors(&mut self, added: MatRef<'_, f64>) -> Result<(), Error> {
        let kept = vec![1.0; added.nrows()];
        self.change_calibration(&kept, added)
    }

    /// c ← φ c + w, φ and ΔP = Cov(w) in the order of the calibration, `[p]` and `[p, p]`.
    ///
    /// ```text
    /// S' = φ S φ + ΔP_cc      Γ' = (Γ S φ + ΔP_bc) S'⁻¹      C' = C + blockdiag(Γ S Γᵀ + ΔP_bb − Γ' S' Γ'ᵀ)
    /// ```
    ///
    /// with φ applied first to the rows of the local parameters among b.
    ///
    /// What joins C is the block diagonal of a Schur complement of a positive semidefinite matrix. Cov(b, c), Cov(c) and the
    /// covariance of each block are exact.
    ///
    /// # Errors
    /// If S' is not positive definite.
    pub(super) fn change_calibration(&mut self, kept: &[f64], added: MatRef<'_, f64>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        self.decay_local(kept);
        let Frame { local, shared, layout, blocks, .. } = &*frame;
        let (m, p) = (layout.len(), shared.len());
        // The local parameters' own.
        for (i, &number) in local.iter().enumerate() {
            for (j, &other) in local.iter().enumerate() {
                let ((block, row), (of_other, column)) = (blocks.place(m + i), blocks.place(m + j));
                if block == of_other {
                    self.memory.own.block_mut(blocks, block)[(row, column)] += added[(number, other)];
                }
            }
        }
        if p == 0 {
            return Ok(());
        }
        let memory = &mut self.memory;
        let of_shared = Mat::from_fn(p, p, |i, j| added[(shared[i], shared[j])]);
        let with_local = |i: usize, j: usize| added[(local[i], shared[j])];
        let links_local = (0..local.len()).any(|i| (0..p).any(|j| with_local(i, j) != 0.0));
        if !links_local && of_shared.norm_max() == 0.0 && shared.iter().all(|&number| kept[number] == 1.0) {
            return Ok(());
        }
        // Γ L, where S = L Lᵀ: S may be singular, as it is before the prior joins.
        let before_root = semidefinite_root(memory.shared.as_ref());
        let before = product(memory.sensitivity.as_ref(), before_root.as_ref());
        // Γ S φ + ΔP_bc.
        let mut joint = product(before.as_ref(), before_root.transpose());
        for (j, &number) in shared.iter().enumerate() {
            scale(joint.col_as_slice_mut(j), kept[number]);
        }
        for (i, j) in (0..local.len()).flat_map(|i| (0..p).map(move |j| (i, j))) {
            joint[(m + i, j)] += with_local(i, j);
        }
        let shared_now =
            Mat::from_fn(p, p, |i, j| kept[shared[i]] * memory.shared[(i, j)] * kept[shared[j]] + of_shared[(i, j)]);
        let root = cholesky(shared_now.clone(), || "the covariance of the shared calibration parameters".into())?;
        // Γ' L' = (Γ S φ + ΔP_bc) L'⁻ᵀ.
        let mut transposed = joint.transpose().to_owned();
        solve_lower(root.as_ref(), transposed.as_mut());
        let after = transposed.transpose().to_owned();
        solve_lower_transposed(root.as_ref(), transposed.as_mut());
        // (S φ S'⁻¹)ᵀ for the earlier analyses, whose errors depend on c but are not part of the covariance.
        let mut of_past = Mat::from_fn(p, p, |i, j| kept[shared[i]] * memory.shared[(i, j)]);
        solve_lower(root.as_ref(), of_past.as_mut());
        solve_lower_transposed(root.as_ref(), of_past.as_mut());
        memory.own.add_columns(blocks, 1.0, before.as_ref());
        let mut all = vec![0.0; blocks.variables()];
        memory.own.add_variances(blocks, &mut all);
        memory.own.add_columns(blocks, -1.0, after.as_ref());
        memory.own.clear_rounding(blocks, &all, rounding(p));
        memory.sensitivity = Matrix(transposed.transpose().to_owned());
        memory.shared = Matrix(shared_now);
        self.drift_past(of_past.transpose());
        Ok(())
    }

    /// Multiplies the rows of the local parameters by φ.
    fn decay_local(&mut self, kept: &[f64]) {
        let frame = Arc::clone(&self.frame);
        let (m, memory) = (frame.layout.len(), &mut self.memory);
        for (i, &number) in frame.local.iter().enumerate().filter(|it| kept[*it.1] != 1.0) {
            let (variable, kept) = (m + i, kept[number]);
            memory.own.scale(&frame.blocks, variable, kept);
            (0..memory.sensitivity.ncols()).for_each(|j| memory.sensitivity[(variable, j)] *= kept);
            memory.factors.iter_mut().for_each(|factors| factors.scale_row(variable, kept));
        }
    }

    /// Adds a covariance to that of the parameters; one that adds nothing to a border without prior changes nothing.
    pub(super) fn widen(&mut self, widening: MatRef<'_, f64>) {
        self.add_calibration_errors(widening).expect("a positive definite covariance with more added is one");
    }

    /// Replaces the covariance of the calibration, and drops that with the state.
    ///
    /// # Errors
    /// If it is not positive definite.
    pub(super) fn replace(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let frame = Arc::clone(&self.frame);
        let Frame { local, shared, layout, blocks, supports, .. } = &*frame;
        let (m, p) = (layout.len(), shared.len());
        self.forget();
        // What the state's errors have through Γ stays in its blocks.
        let root = self.shared_root()?;
        let through = product(self.memory.sensitivity.as_ref(), root.as_ref());
        self.memory.own.add_columns(blocks, 1.0, through.as_ref());
        for (factors, support) in self.memory.factors.iter_mut().zip(supports) {
            let first = support.partition_point(|&variable| variable < m);
            (0..factors.columns()).for_each(|j| factors.edit_column(j, |column| column[first..].fill(0.0)));
        }
        (m..m + local.len()).for_each(|variable| self.memory.own.clear(blocks, variable));
        self.memory.sensitivity = Matrix(Mat::zeros(blocks.variables(), p));
        self.memory.shared = Matrix(Mat::zeros(p, p));
        self.add_calibration_errors(covariance)
    }
}
