//! A start from which cycles are run again after a correction has moved: what was linearised about the old model is not
//! believed any more.
//!
//! The sensitivities U to a correction r hold for small changes of it. After a move δ of r̂ the state ŝ + U δ has an error of the
//! order of δ², which P does not contain, and what the cycles before the start say of r was said about another model. So
//! the correction begins anew:
//!
//! ```text
//! P ← P + U_r (δ δ' + S_rr) U_r',     U_r ← 0,     r ~ its prior
//! ```
//!
//! that is, what the state has in common with r becomes common factors of the state, as uncertain as the move was large,
//! and the cycles that follow say what r is. What earlier cycles say of the other unknowns stays, less what r could explain
//! of it.

use super::TimeVolume;
use super::window::Information;
use crate::linalg::semidefinite_root;
use crate::memory::Matrix;
use faer::Mat;

impl TimeVolume {
    /// Begins anew with the corrections, which have moved by `shift` to the reference.
    pub(super) fn begin_anew(&mut self, shift: &[f64]) {
        let (first, q) = (self.constant.len(), self.unknowns());
        let moved: Vec<usize> = (first..q).filter(|&k| self.memory.active[k] || shift[k] != 0.0).collect();
        let n = moved.len();
        let root = &self.memory.posterior.root;
        let spread = Mat::from_fn(n, n, |i, j| {
            let own: f64 = (0..root.ncols()).map(|l| root[(moved[i], l)] * root[(moved[j], l)]).sum();
            own + shift[moved[i]] * shift[moved[j]]
        });
        let spread = semidefinite_root(spread.as_ref());
        let factors = self.errors.factors_mut();
        let before = factors.columns();
        factors.append(n);
        for j in 0..n {
            for (i, &k) in moved.iter().enumerate() {
                factors.add_to_column(before + j, spread[(i, j)], &self.memory.sensitivity, k);
            }
        }
        self.errors.widen_past(before);
        let is_correction: Vec<bool> = (0..q).map(|k| k >= first).collect();
        let window = &mut self.memory.window;
        let all = std::iter::once(&mut window.before).chain(&mut window.cycles);
        all.for_each(|it| *it = it.without(&is_correction));
        for k in first..q {
            self.memory.sensitivity.clear_column(k);
        }
        let priors = self.corrections.iter().flat_map(|it| it.sigma_priors());
        for (k, sigma) in (first..q).zip(priors) {
            let Some(sigma) = sigma else { continue };
            window.before.matrix[(k, k)] = sigma.powi(-2);
            window.before.vector[k] = -self.memory.reference[k] * sigma.powi(-2);
        }
    }
}

impl Information {
    /// What it says when some unknowns may be whatever suits it best: `J_aa − J_ab J_bb^-1 J_ba`; nothing of those.
    pub fn without(&self, left_out: &[bool]) -> Information {
        let q = self.vector.len();
        let root = self.solve(left_out).root;
        // J_ab times the root of J_bb^-1.
        let through = |i: usize, l: usize| (0..q).map(|k| self.matrix[(i, k)] * root[(k, l)]).sum::<f64>();
        let through = Mat::from_fn(q, root.ncols(), through);
        let along: Vec<f64> = (0..root.ncols()).map(|l| (0..q).map(|k| root[(k, l)] * self.vector[k]).sum()).collect();
        let explained = |i: usize, j: usize| (0..root.ncols()).map(|l| through[(i, l)] * through[(j, l)]).sum::<f64>();
        let matrix =
            Mat::from_fn(
                q,
                q,
                |i, j| {
                    if left_out[i] || left_out[j] { 0.0 } else { self.matrix[(i, j)] - explained(i, j) }
                },
            );
        let value = |i: usize| self.vector[i] - (0..root.ncols()).map(|l| through[(i, l)] * along[l]).sum::<f64>();
        let vector = (0..q).map(|i| if left_out[i] { 0.0 } else { value(i) }).collect();
        Information { matrix: Matrix(matrix), vector }
    }
}
