//! Localising rotations: each direction of the factors moves to the tile that it is nearest to.

use super::local_factors::{LocalFactors, multiplied, union};
use super::recombination::Recombination;
use super::tiles::Pair;
use super::{Frame, LocalErrors};
use crate::linalg::{add_symmetric_product, eigen, product};
use faer::Mat;
use rayon::prelude::*;
use std::sync::Arc;

impl LocalErrors {
    /// Rotates the factors of all pairs of neighbours, first along x, then along y; what they then have outside of their
    /// supports is cut off. The recombination, if there is one, records the rotations.
    pub(super) fn localize(&mut self, mut recombination: Option<&mut Recombination>, left: &mut [f64]) {
        let frame = Arc::clone(&self.frame);
        for group in frame.tiles.pairs() {
            let rotated: Vec<Rotated> = group
                .par_iter()
                .map(|pair| rotated(&frame, pair, pair.tiles.map(|tile| &self.memory.factors[tile])))
                .collect();
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
fn rotated(frame: &Frame, pair: &Pair, factors: [&LocalFactors; 2]) -> Rotated {
    let variables = union(factors.map(|factors| factors.variables.as_slice()));
    let [first, second] = factors.map(LocalFactors::columns);
    let precision = factors[0].precision();
    let mut y = Mat::zeros(variables.len(), first + second);
    for (factors, from) in factors.into_iter().zip([0, first]) {
        factors.add_to(&variables, y.as_mut().get_mut(.., from..from + factors.columns()), None);
    }
    let weights: Vec<f64> = variables
        .iter()
        .map(|&variable| frame.tiles.beyond(pair, frame.cells[variable]) / frame.scales[variable].powi(2))
        .collect();
    let weighted = multiplied(&y, &weights);
    let mut moments = Mat::zeros(y.ncols(), y.ncols());
    add_symmetric_product(moments.as_mut(), 1.0, y.transpose(), weighted.as_ref());
    let (_, rotation) = eigen(moments.as_ref());
    let y = product(y.as_ref(), rotation.as_ref());
    let part = |from: usize, count: usize, tile: usize| {
        LocalFactors::parts(&variables, &frame.supports[tile], count, precision, |j| y.col_as_slice(from + j).into())
    };
    let (a, outside_a) = part(0, first, pair.tiles[0]);
    let (b, outside_b) = part(first, second, pair.tiles[1]);
    Rotated { inside: [a, b], outside: [outside_a, outside_b], rotation }
}
