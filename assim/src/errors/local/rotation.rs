//! Localising rotations: each direction of the factors moves to the tile that it is nearest to.

use super::LocalErrors;
use super::local_factors::{LocalFactors, Run, places, runs, union};
use super::recombination::Recombination;
use super::tiles::{Pair, Tiles};
use crate::linalg::{eigen, entries};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::sync::Arc;

impl LocalErrors {
    /// Rotates the factors of all pairs of neighbours, first along x, then along y; what they then have outside of their
    /// supports is cut off. The recombination, if there is one, records the rotations.
    pub(super) fn localize(&mut self, mut recombination: Option<&mut Recombination>, left: &mut [f64]) {
        let frame = Arc::clone(&self.frame);
        for group in &frame.pairs {
            let rotate = |scratch: &mut Scratch, pair: &PairRows| {
                rotated(pair, pair.tiles.map(|tile| &self.memory.factors[tile]), &frame.supports, scratch)
            };
            let rotated: Vec<Rotated> = group.par_iter().map_init(Scratch::default, rotate).collect();
            for (pair, Rotated { inside, outside, rotation }) in group.iter().zip(rotated) {
                for (&tile, factors) in pair.tiles.iter().zip(inside) {
                    self.memory.factors[tile] = factors;
                }
                self.leave_over(&outside, left);
                if let Some(recombination) = recombination.as_mut() {
                    recombination.rotate(pair.tiles, rotation.as_ref());
                }
            }
        }
    }
}

/// The rows of a pair of neighbours' factors, which are the same in all rotations.
pub(super) struct PairRows {
    tiles: [usize; 2],
    /// The block variables of both supports, ascending.
    variables: Vec<usize>,
    /// Where the rows of each support are among these, and the others: rows of theirs alone.
    inside: [Vec<Run>; 2],
    outside: [Vec<Run>; 2],
    /// N s of each variable.
    weights: Vec<f64>,
}

impl PairRows {
    /// All pairs, in the groups in which they are rotated, given the supports of the tiles and the cell and the scale of each
    /// block variable.
    pub fn all(tiles: &Tiles, supports: &[Vec<usize>], cells: &[usize], scales: &[f64]) -> Vec<Vec<Self>> {
        let of_pair = |pair: &Pair| {
            let supports = pair.tiles.map(|tile| supports[tile].as_slice());
            let variables = union(supports);
            let weight = |&variable: &usize| tiles.beyond(pair, cells[variable]) / scales[variable].powi(2);
            let weights = variables.iter().map(weight).collect();
            let of = |is_inside: bool| {
                supports.map(|support| {
                    let places = places(&variables, support).enumerate();
                    runs(places.filter(|(_, place)| place.is_some() == is_inside).map(|(row, _)| row))
                })
            };
            let (inside, outside) = (of(true), of(false));
            Self { tiles: pair.tiles, variables, inside, outside, weights }
        };
        tiles.pairs().iter().map(|group| group.par_iter().map(of_pair).collect()).collect()
    }
}

/// Rows whose moments are summed at a time: they stay in the cache.
const ROWS: usize = 256;

/// Room for Y, some rows of N diag(s) Y and Y U, one column after another.
#[derive(Default)]
struct Scratch([Vec<f64>; 3]);

/// The outcome of a rotation of a pair.
struct Rotated {
    /// The factors of both tiles on their supports.
    inside: [LocalFactors; 2],
    /// Their values elsewhere.
    outside: [LocalFactors; 2],
    rotation: Mat<f64>,
}

/// Rotates the factors of a pair: with `Y = [F_1 F_2]` and s(x) the place across their common edge,
///
/// ```text
/// U = eigenvectors of Yᵀ N diag(s) Y, ascending      F_1 ← Y U(:, 1 … r_1)      F_2 ← Y U(:, r_1 + 1 …)
/// ```
///
/// U is orthogonal, so that Σ F Fᵀ stays what it is. Of all rotations it makes tr F_1ᵀ N diag(s) F_1 least: since the
/// squares of the distances from the middles of the two tiles differ by a linear function of s, that makes the sum of
/// squared distances, weighted with the variance, as small as it can be.
fn rotated(pair: &PairRows, factors: [&LocalFactors; 2], supports: &[Vec<usize>], scratch: &mut Scratch) -> Rotated {
    let [first, second] = factors.map(LocalFactors::columns);
    let (rows, columns, precision) = (pair.variables.len(), first + second, factors[0].precision());
    let [y, weighted, rotated] = &mut scratch.0;
    y.resize(rows * columns, 0.0);
    rotated.resize(rows * columns, 0.0);
    weighted.resize(ROWS * columns, 0.0);
    for (i, factors) in factors.into_iter().enumerate() {
        for j in 0..factors.columns() {
            let (to, from) = (&mut y[(i * first + j) * rows..][..rows], factors.column(j));
            pair.inside[i].iter().for_each(|run| to[run.to..][..run.len].copy_from_slice(&from[run.from..][..run.len]));
            pair.outside[i].iter().for_each(|run| to[run.to..][..run.len].fill(0.0));
        }
    }
    let y = MatRef::from_column_major_slice(y, rows, columns);
    let mut moments = Mat::zeros(columns, columns);
    for (chunk, weights) in pair.weights.chunks(ROWS).enumerate() {
        let part = y.get(chunk * ROWS..chunk * ROWS + weights.len(), ..);
        let weighted = &mut weighted[..weights.len() * columns];
        for (to, from) in weighted.chunks_exact_mut(weights.len()).zip(part.col_iter()) {
            to.iter_mut().zip(entries(from)).zip(weights).for_each(|((to, from), weight)| *to = from * weight);
        }
        let weighted = MatRef::from_column_major_slice(weighted, weights.len(), columns);
        matmul(moments.as_mut(), Accum::Add, part.transpose(), weighted, 1.0, Par::Seq);
    }
    let (_, rotation) = eigen(moments.as_ref());
    let product = MatMut::from_column_major_slice_mut(rotated, rows, columns);
    matmul(product, Accum::Replace, y, rotation.as_ref(), 1.0, Par::Seq);
    let part = |i: usize, variables: Vec<usize>, runs: &[Run]| {
        LocalFactors::filled(variables, factors[i].columns(), precision, |j, column| {
            let from = &rotated[(i * first + j) * rows..][..rows];
            runs.iter().for_each(|run| column[run.from..][..run.len].copy_from_slice(&from[run.to..][..run.len]));
        })
    };
    let inside = [0, 1].map(|i| part(i, supports[pair.tiles[i]].clone(), &pair.inside[i]));
    let outside = [0, 1].map(|i| {
        let of_run = |run: &Run| pair.variables[run.to..][..run.len].iter().copied();
        part(i, pair.outside[i].iter().flat_map(of_run).collect(), &pair.outside[i])
    });
    Rotated { inside, outside, rotation }
}
