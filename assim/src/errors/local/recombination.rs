//! A step's recombination of the columns of all tiles' factors, for further rows of these to follow.

use super::local_factors::{LocalFactors, Run, runs};
use crate::linalg::product;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The place of a variable that has none.
const NONE: usize = usize::MAX;

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

    /// `Σ_i F_i T_ij` of all tiles, for which the F_i have rows of at most `variables` block variables: the rows in the support of
    /// each tile, and the others.
    pub fn parts(
        &self,
        factors: &[LocalFactors],
        supports: &[Vec<usize>],
        variables: usize,
    ) -> Vec<(LocalFactors, LocalFactors)> {
        let scratch = || (vec![NONE; variables], Vec::new(), Vec::new());
        let of_tile =
            |scratch: &mut _, (tile, support): (usize, &Vec<usize>)| self.parts_of(tile, factors, support, scratch);
        supports.par_iter().enumerate().map_init(scratch, of_tile).collect()
    }

    /// The same of one tile. The scratch has a place for every block variable, unset before and after the call, and two buffers.
    fn parts_of(
        &self,
        tile: usize,
        factors: &[LocalFactors],
        support: &[usize],
        (places, sums, products): &mut (Vec<usize>, Vec<f64>, Vec<f64>),
    ) -> (LocalFactors, LocalFactors) {
        let sources = || self.0[tile].iter().map(|(source, part)| (&factors[*source], part));
        let columns = sources().next().map_or(0, |(_, part)| part.ncols());
        support.iter().enumerate().for_each(|(place, &variable)| places[variable] = place);
        let mut others = Vec::new();
        for &variable in sources().flat_map(|(factors, _)| &factors.variables) {
            if places[variable] == NONE {
                places[variable] = support.len();
                others.push(variable);
            }
        }
        others.sort();
        others.iter().zip(support.len()..).for_each(|(&variable, place)| places[variable] = place);
        let count = support.len() + others.len();
        sums.clear();
        sums.resize(count * columns, 0.0);
        for (factors, part) in sources() {
            let rows = factors.variables.len();
            products.resize(rows * columns, 0.0);
            let product = MatMut::from_column_major_slice_mut(products, rows, columns);
            matmul(product, Accum::Replace, factors.rows(&mut Vec::new()), part.as_ref(), 1.0, Par::Seq);
            let runs = runs(factors.variables.iter().map(|&variable| places[variable]));
            for (j, product) in products.chunks_exact(rows.max(1)).enumerate() {
                for &Run { from, to, len } in &runs {
                    let sum = &mut sums[j * count + to..][..len];
                    sum.iter_mut().zip(&product[from..from + len]).for_each(|(sum, value)| *sum += value);
                }
            }
        }
        support.iter().chain(&others).for_each(|&variable| places[variable] = NONE);
        let of = |variables: Vec<usize>, first: usize| {
            LocalFactors::filled(variables, columns, factors[tile].precision(), |j, column| {
                column.copy_from_slice(&sums[j * count + first..][..column.len()]);
            })
        };
        (of(support.to_vec(), 0), of(others, support.len()))
    }

    /// `Σ_i F_i T_ij` of all tiles, each on its support.
    pub fn within(&self, factors: &[LocalFactors], supports: &[Vec<usize>]) -> Vec<LocalFactors> {
        supports.par_iter().enumerate().map(|(tile, support)| self.on(tile, factors, support)).collect()
    }

    fn on(&self, tile: usize, factors: &[LocalFactors], variables: &[usize]) -> LocalFactors {
        let columns = self.0[tile].first().map_or(0, |(_, part)| part.ncols());
        let mut values = Mat::zeros(variables.len(), columns);
        for (source, part) in &self.0[tile] {
            factors[*source].add_products(part.as_ref(), variables, &mut values);
        }
        LocalFactors::new(variables.to_vec(), values.as_ref(), factors[tile].precision())
    }
}
