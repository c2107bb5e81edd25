//! The choice of state-transition corrections, and the solution of the window for what is chosen.

use super::TimeVolume;
use super::window::{Information, Posterior};
use crate::ties::first_largest;

impl TimeVolume {
    /// All that is known of C, with the priors of tiles that are not chosen.
    pub(super) fn known(&self) -> Information {
        self.with_priors(&self.memory.window.total(), &self.memory.precisions)
    }

    /// The window's solution, relative to the reference: of the active unknowns, with the others at zero.
    pub(super) fn solve_window(&self) -> (Posterior, Vec<f64>) {
        self.solve_with(&self.known(), &self.memory.active)
    }

    pub(super) fn solve_with(&self, total: &Information, active: &[bool]) -> (Posterior, Vec<f64>) {
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

    /// The correlation of a candidate's column with the innovations, once the other active unknowns have explained what they
    /// can, in standard deviations of what it would be by chance; `None` if nothing of the column is left.
    ///
    /// The pair is the solution for the active unknowns, with priors of these precisions. Of one with such a prior, mean m and
    /// variance v, the observations alone say `m/v` with the information `1/v − σ^-2`.
    pub(super) fn score(
        &self,
        total: &Information,
        (posterior, shift): &(Posterior, Vec<f64>),
        precisions: &[f64],
        candidate: usize,
    ) -> Option<f64> {
        let q = self.unknowns();
        if precisions[candidate] > 0.0 {
            let variance = posterior.variance(candidate);
            let (mean, left) =
                (self.memory.reference[candidate] + shift[candidate], 1.0 / variance - precisions[candidate]);
            return (left > 1e-6 / variance).then(|| mean / variance / left.sqrt());
        }
        let row = |k: usize| total.matrix[(candidate, k)];
        // What is left of the column's square, and of its product with the innovations, for an amplitude of zero.
        let through = |column: usize| (0..q).map(|k| row(k) * posterior.root[(k, column)]).sum::<f64>();
        let explained: f64 = (0..posterior.root.ncols()).map(|column| through(column).powi(2)).sum();
        let left = row(candidate) - explained;
        let product = total.vector[candidate] - (0..q).map(|k| row(k) * shift[k]).sum::<f64>();
        (left > 1e-6 * row(candidate)).then(|| product / left.sqrt())
    }

    /// Forward selection: the candidate with the highest score joins while one is above the threshold; one that no longer
    /// stands out of its own uncertainty leaves. With a tile of a correction the others of it are estimated, too.
    pub(super) fn select(&mut self) {
        let (first, q) = (self.constant.len(), self.unknowns());
        if first == q {
            return;
        }
        let window = self.memory.window.total();
        let threshold = self.settings.selection_threshold;
        let mut chosen: Vec<bool> = (0..q).map(|k| self.is_chosen(k)).collect();
        let mut estimated = self.estimated(&window, &chosen);
        let (posterior, shift) = loop {
            let total = self.with_priors(&window, &estimated.precisions);
            let solved = self.solve_with(&total, &estimated.active);
            let others = (first..q).filter(|&k| !chosen[k]);
            let score = |k: usize| Some((k, self.score(&total, &solved, &estimated.precisions, k)?.abs()));
            let scores: Vec<(usize, f64)> = others.filter_map(score).collect();
            match first_largest(scores.iter().map(|it| it.1)).map(|best| scores[best]) {
                Some((best, score)) if score > threshold => chosen[best] = true,
                _ => break solved,
            }
            estimated = self.estimated(&window, &chosen);
        };
        let before = chosen.clone();
        for k in first..q {
            chosen[k] &= (self.memory.reference[k] + shift[k]).powi(2) > posterior.variance(k);
        }
        if chosen != before {
            estimated = self.estimated(&window, &chosen);
        }
        (self.memory.active, self.memory.precisions) = (estimated.active, estimated.precisions);
    }

    /// Whether an unknown is estimated because it stands out by itself, or always.
    pub(super) fn is_chosen(&self, k: usize) -> bool {
        self.memory.active[k] && self.memory.precisions[k] == 0.0
    }
}
