//! What a step makes of the columns of all tiles' factors, for rows that follow them.

use super::local_factors::{LocalFactors, union};
use crate::linalg::product;
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// `F'_j = Σ_i F_i T_ij`: for each tile j, ascending, the tiles i that have a part in it, and T_ij,
/// `[factors of i before, factors of j after]`.
#[derive(Clone)]
pub(super) struct Recombination(Vec<Vec<(usize, Mat<f64>)>>);

impl Recombination {
    /// Of these parts.
    pub fn new(parts: Vec<Vec<(usize, Mat<f64>)>>) -> Self {
        Self(parts)
    }

    /// The one that puts each tile's factors first among others that join them: T_jj = \[I 0\].
    pub fn joined(before: &[usize], after: &[usize]) -> Self {
        let own = |tile: usize| vec![(tile, Mat::identity(before[tile], after[tile]))];
        Self((0..before.len()).map(own).collect())
    }

    /// What it is with `[F'_a F'_b] U` after it.
    pub fn rotate(&mut self, [a, b]: [usize; 2], rotation: MatRef<'_, f64>) {
        let columns = |tile: usize| self.0[tile].first().map_or(0, |(_, part)| part.ncols());
        let (of_a, of_b) = (columns(a), columns(b));
        let parts = [(a, 0), (b, of_a)].map(|(tile, first)| (std::mem::take(&mut self.0[tile]), first));
        let mut sources: Vec<usize> =
            parts.iter().flat_map(|(parts, _)| parts.iter().map(|(source, _)| *source)).collect();
        sources.sort_unstable();
        sources.dedup();
        for source in sources {
            let mut rotated: Option<Mat<f64>> = None;
            for (parts, first) in &parts {
                for (_, part) in parts.iter().filter(|(own, _)| *own == source) {
                    let own = product(part.as_ref(), rotation.get(*first..first + part.ncols(), ..));
                    rotated = Some(rotated.map_or_else(|| own.clone(), |other| other + &own));
                }
            }
            let rotated = rotated.expect("a source has a part");
            self.0[a].push((source, rotated.get(.., ..of_a).to_owned()));
            self.0[b].push((source, rotated.get(.., of_a..of_a + of_b).to_owned()));
        }
    }

    /// What it is with `F'_j T_j` after it.
    pub fn then(&self, of_tiles: &[Mat<f64>]) -> Self {
        let then = |(parts, t): (&Vec<(usize, Mat<f64>)>, &Mat<f64>)| {
            parts.iter().map(|(source, part)| (*source, product(part.as_ref(), t.as_ref()))).collect()
        };
        Self(self.0.iter().zip(of_tiles).map(then).collect())
    }

    /// `Σ_i F_i T_ij` of a tile, on all variables that the F_i have rows of.
    pub fn whole(&self, tile: usize, factors: &[LocalFactors]) -> LocalFactors {
        let variables = union(self.0[tile].iter().map(|(source, _)| factors[*source].variables.as_slice()));
        self.on(tile, factors, &variables)
    }

    /// `Σ_i F_i T_ij` of all tiles, each on its support.
    pub fn within(&self, factors: &[LocalFactors], supports: &[Vec<usize>]) -> Vec<LocalFactors> {
        supports.par_iter().enumerate().map(|(tile, support)| self.on(tile, factors, support)).collect()
    }

    fn on(&self, tile: usize, factors: &[LocalFactors], variables: &[usize]) -> LocalFactors {
        let columns = self.0[tile].first().map_or(0, |(_, part)| part.ncols());
        let mut values = Mat::zeros(variables.len(), columns);
        for (source, part) in &self.0[tile] {
            factors[*source].add_to(variables, values.as_mut(), Some(part.as_ref()));
        }
        LocalFactors::new(variables.to_vec(), values.as_ref(), factors[tile].precision())
    }
}
