//! The choice of state-transition corrections, and the solution of the window for what is chosen.

use super::TimeVolume;
use super::window::{Information, Posterior};
use crate::ties::first_largest;

impl TimeVolume {
    /// The window's solution, relative to the reference: of the active unknowns, with the others at zero.
    pub(super) fn solve_window(&self) -> (Posterior, Vec<f64>) {
        self.solve_with(&self.memory.window.total(), &self.memory.active)
    }

    fn solve_with(&self, total: &Information, active: &[bool]) -> (Posterior, Vec<f64>) {
        let fixed: Vec<f64> =
            self.memory.reference.iter().zip(active).map(|(own, &active)| if active { 0.0 } else { -own }).collect();
        let mut total = total.clone();
        total.shift(&fixed);
        let posterior = total.solve(active);
        let shift = posterior.estimate.iter().zip(&fixed).map(|(estimate, fixed)| estimate + fixed).collect();
        (posterior, shift)
    }

    /// j' J^-1 j of the active unknowns: by how much Ĉ makes the squares less than C_0 does.
    pub(super) fn explained(&self, total: &Information) -> f64 {
        let posterior = total.solve(&self.memory.active);
        posterior.estimate.iter().zip(&total.vector).map(|(estimate, vector)| estimate * vector).sum()
    }

    /// The correlation of a candidate's column with the innovations, once the active unknowns have explained what they can,
    /// in standard deviations of what it would be by chance; `None` if nothing of the column is left.
    ///
    /// The pair is the solution for the active unknowns.
    pub(super) fn score(
        &self,
        total: &Information,
        (posterior, shift): &(Posterior, Vec<f64>),
        candidate: usize,
    ) -> Option<f64> {
        let q = self.unknowns();
        let row = |k: usize| total.matrix[(candidate, k)];
        // What is left of the column's square, and of its product with the innovations, for an amplitude of zero.
        let through = |column: usize| (0..q).map(|k| row(k) * posterior.root[(k, column)]).sum::<f64>();
        let explained: f64 = (0..posterior.root.ncols()).map(|column| through(column).powi(2)).sum();
        let left = row(candidate) - explained;
        let product = total.vector[candidate] - (0..q).map(|k| row(k) * shift[k]).sum::<f64>();
        (left > 1e-6 * row(candidate)).then(|| product / left.sqrt())
    }

    /// Forward selection: the candidate with the highest score joins while one is above the threshold; one that no longer
    /// stands out of its own uncertainty leaves.
    pub(super) fn select(&mut self) {
        let (first, q) = (self.constant.len(), self.unknowns());
        if first == q {
            return;
        }
        let total = self.memory.window.total();
        let threshold = self.settings.selection_threshold;
        let mut active = self.memory.active.clone();
        loop {
            let solved = self.solve_with(&total, &active);
            let scores = (first..q).filter(|&k| !active[k]);
            let scores: Vec<(usize, f64)> =
                scores.filter_map(|k| self.score(&total, &solved, k).map(|score| (k, score.abs()))).collect();
            match first_largest(scores.iter().map(|it| it.1)).map(|best| scores[best]) {
                Some((best, score)) if score > threshold => active[best] = true,
                _ => break,
            }
        }
        let (posterior, shift) = self.solve_with(&total, &active);
        for k in first..q {
            let unit: Vec<f64> = (0..q).map(|j| f64::from(u8::from(j == k))).collect();
            let value = self.memory.reference[k] + shift[k];
            active[k] &= value.abs() > posterior.sigma(&unit);
        }
        self.memory.active = active;
    }
}
