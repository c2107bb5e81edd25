//! A step's recombination of the columns of all tiles' factors, for further rows of these to follow.

use super::local_factors::{LocalFactors, union};
use crate::linalg::product;
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// `F'_j = Σ_i F_i T_ij`: for each tile j, ascending, the tiles i that have a part in it, and T_ij,
/// `[factors of i before, factors of j after]`.
pub(super) struct Recombination(Vec<Vec<(usize, Mat<f64>)>>);

impl Recombination {
    /// The recombination with these parts.
    pub fn new(parts: Vec<Vec<(usize, Mat<f64>)>>) -> Self {
        Self(parts)
    }

    /// The recombination in which other factors join each tile's, behind them: T_jj = \[I 0\].
    pub fn joined(before: &[usize], after: &[usize]) -> Self {
        let own = |tile: usize| vec![(tile, Mat::identity(before[tile], after[tile]))];
        Self((0..before.len()).map(own).collect())
    }

    /// Composes it with a rotation of two tiles' factors, `[F'_a F'_b] U`.
    pub fn rotate(&mut self, [a, b]: [usize; 2], rotation: MatRef<'_, f64>) {
        let columns = |tile: usize| self.0[tile].first().map_or(0, |(_, part)| part.ncols());
        let (of_a, of_b) = (columns(a), columns(b));
        let parts = [(a, 0), (b, of_a)].map(|(tile, first)| (std::mem::take(&mut self.0[tile]), first));
        let mut by_source: BTreeMap<usize, Mat<f64>> = BTreeMap::new();
        for (parts, first) in parts {
            for (source, part) in parts {
                let rotated = product(part.as_ref(), rotation.get(first..first + part.ncols(), ..));
                by_source.entry(source).and_modify(|sum| *sum += &rotated).or_insert(rotated);
            }
        }
        for (source, rotated) in by_source {
            self.0[a].push((source, rotated.get(.., ..of_a).to_owned()));
            self.0[b].push((source, rotated.get(.., of_a..of_a + of_b).to_owned()));
        }
    }

    /// Its composition with `F'_j T_j`.
    pub fn then(&self, of_tiles: &[Mat<f64>]) -> Self {
        let then = |(parts, t): (&Vec<(usize, Mat<f64>)>, &Mat<f64>)| {
            parts.iter().map(|(source, part)| (*source, product(part.as_ref(), t.as_ref()))).collect()
        };
        Self(self.0.iter().zip(of_tiles).map(then).collect())
    }

    /// `Σ_i F_i T_ij` of a tile, on all variables for which the F_i have rows.
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
