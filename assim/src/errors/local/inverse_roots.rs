//! The symmetric inverse root of the amplitudes' information near each tile.

use super::amplitudes::Amplitudes;
use crate::lanes::{Aligned, Fractions, Functions, lanes};
use crate::linalg::{eigen, product};
use faer::Mat;
use pulp::Arch;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The largest matrix whose root is a sum of fractions. Beyond it M is known only up to what its rounding makes of the smallest
/// eigenvalues, which are 1, and eigenvalues below 1 are seen for what they are.
const LARGEST: f64 = 1e9;

/// A matrix for each of some tiles, with the number of the tile.
type Columns = Vec<(usize, Mat<f64>)>;

/// For each tile its columns in the symmetric root M^-½, as the principal submatrix of the tiles near it has them: a matrix for
/// each of these, `[factors of it, factors of the tile]`. The tile is among those near it.
///
/// Matrices of one size share the lanes of the processor. A tile needs the product of M^-½ with some columns of I only,
/// and no eigenvectors: see [`Functions`] and [`Fractions`].
pub(super) fn inverse_roots(amplitudes: &Amplitudes, near: &[Vec<usize>]) -> Vec<Columns> {
    let largest = amplitudes.bound();
    if largest > LARGEST {
        return (0..near.len()).into_par_iter().map(|tile| of_eigenvectors(amplitudes, tile, &near[tile])).collect();
    }
    let (fractions, arch) = (Fractions::new(largest.max(4.0)), Arch::new());
    let mut of_size: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    for (tile, near) in near.iter().enumerate() {
        let size = near.iter().map(|&other| amplitudes.of(other).len()).sum();
        of_size.entry((size, amplitudes.of(tile).len())).or_default().push(tile);
    }
    let batches: Vec<((usize, usize), &[usize])> = of_size
        .iter()
        .flat_map(|(&sizes, tiles)| tiles.chunks(lanes(arch)).map(move |tiles| (sizes, tiles)))
        .filter(|((size, columns), _)| size * columns > 0)
        .collect();
    let mut roots = vec![Vec::new(); near.len()];
    let all = batches.par_iter().map(|&(sizes, tiles)| of_batch(amplitudes, near, (sizes, tiles), &fractions, arch));
    for ((_, tiles), columns) in batches.iter().zip(all.collect::<Vec<_>>()) {
        tiles.iter().zip(columns).for_each(|(&tile, columns)| roots[tile] = columns);
    }
    roots
}

/// The columns of some tiles, at most as many as there are lanes, whose matrices have a size and of which they have a number.
fn of_batch(
    amplitudes: &Amplitudes,
    near: &[Vec<usize>],
    ((size, columns), tiles): ((usize, usize), &[usize]),
    fractions: &Fractions,
    arch: Arch,
) -> Vec<Columns> {
    let lanes = lanes(arch);
    let [mut matrix, mut vectors, mut right, mut inner, mut work]: [Aligned; 5] = Default::default();
    let (of_matrix, of_vectors) = (matrix.reset(size * size * lanes), vectors.reset(columns * size * lanes));
    (0..size).for_each(|i| of_matrix[i * (size + 1) * lanes..][..lanes].fill(1.0));
    let own: Vec<usize> = tiles.iter().map(|&tile| first_of(amplitudes, tile, &near[tile])).collect();
    for (lane, (&tile, first)) in tiles.iter().zip(&own).enumerate() {
        amplitudes.for_each_entry(&near[tile], |row, column, value| {
            of_matrix[(column * size + row) * lanes + lane] += value;
        });
        (0..columns).for_each(|j| of_vectors[(j * size + first + j) * lanes + lane] = 1.0);
    }
    arch.dispatch(Functions {
        size,
        matrix: of_matrix,
        right: right.reset(size * lanes),
        vectors: of_vectors,
        inner: inner.reset(columns * lanes),
        shifts: &fractions.shifts,
        weights: &fractions.weights,
        work: &mut work,
    });
    let vectors = vectors.as_ref();
    let of_tile = |(lane, &tile): (usize, &usize)| {
        parts(amplitudes, &near[tile], columns, |i, j| vectors[(j * size + i) * lanes + lane])
    };
    tiles.iter().enumerate().map(of_tile).collect()
}

/// The same of one tile by the eigenvectors of its matrix.
fn of_eigenvectors(amplitudes: &Amplitudes, tile: usize, near: &[usize]) -> Columns {
    let size = near.iter().map(|&other| amplitudes.of(other).len()).sum();
    let mut matrix = Mat::<f64>::identity(size, size);
    // The lower triangle is read.
    amplitudes.for_each_entry(near, |row, column, value| matrix[(row, column)] += value);
    let (values, vectors) = eigen(matrix.as_ref());
    let (first, columns) = (first_of(amplitudes, tile, near), amplitudes.of(tile).len());
    let weighted = Mat::from_fn(size, columns, |k, j| vectors[(first + j, k)] / values[k].max(1.0).sqrt());
    let root = product(vectors.as_ref(), weighted.as_ref());
    parts(amplitudes, near, columns, |i, j| root[(i, j)])
}

/// The number of a tile's first amplitude among those of the tiles near it.
fn first_of(amplitudes: &Amplitudes, tile: usize, near: &[usize]) -> usize {
    assert!(near.contains(&tile), "a tile is near itself");
    near.iter().take_while(|&&other| other != tile).map(|&other| amplitudes.of(other).len()).sum()
}

/// The rows of each of some tiles in a matrix with these entries.
fn parts(amplitudes: &Amplitudes, near: &[usize], columns: usize, entry: impl Fn(usize, usize) -> f64) -> Columns {
    let mut first = 0;
    let of_tile = |&other: &usize| {
        let (rows, from) = (amplitudes.of(other).len(), first);
        first += rows;
        (other, Mat::from_fn(rows, columns, |i, j| entry(from + i, j)))
    };
    near.iter().map(of_tile).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    /// Tiles with different numbers of factors and neighbours; observations that say little and much.
    #[test]
    fn sums_of_fractions_are_the_roots_of_eigenvectors() {
        let counts = [3, 2, 3, 3, 2, 3, 3, 3, 3, 3, 3, 3];
        for size in [1e-3, 1.0, 1e3] {
            let mut amplitudes = Amplitudes::new(&counts, 0);
            for tile in 0..counts.len() {
                let tiles: Vec<usize> = (tile..counts.len().min(tile + 3)).collect();
                let columns = 1 + tiles.iter().map(|&tile| counts[tile]).sum::<usize>();
                let normals = standard_normals(&mut stream(tile as u64, "rows"), 5 * columns);
                let rows = Mat::from_fn(5, columns, |i, j| size * normals[5 * j + i]);
                amplitudes.add(&tiles, product(rows.transpose(), rows.as_ref()).as_ref());
            }
            let near: Vec<Vec<usize>> =
                (0..counts.len()).map(|tile| (tile.saturating_sub(1)..counts.len().min(tile + 2)).collect()).collect();
            let found = inverse_roots(&amplitudes, &near);
            let mut most: f64 = 0.0;
            for (tile, found) in found.iter().enumerate() {
                let expected = of_eigenvectors(&amplitudes, tile, &near[tile]);
                for ((other, found), (expected_other, expected)) in found.iter().zip(&expected) {
                    assert_eq!(other, expected_other);
                    most = most.max((found - expected).norm_max());
                }
                assert_eq!(found.len(), expected.len());
            }
            // The rounding of M's largest eigenvalues, seen in the smallest.
            let allowed = 1e-13 + 8.0 * f64::EPSILON * amplitudes.bound();
            assert!(most < allowed, "{size}: {most:e} of {allowed:e}");
        }
    }
}
