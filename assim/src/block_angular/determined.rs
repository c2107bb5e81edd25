//! The border without any prior, as far as the rows determine it: Lange's High-pass Filter.
//!
//! ```text
//! ĉ = (Σ_k G_k' R_k G_k)^-1 Σ_k G_k' R_k y_k
//! ```
//!
//! on the part of the border where the inverse exists. The rest is named: combinations of border unknowns that can change
//! without any change of what the rows say, once the blocks' own unknowns are free to follow.

use super::block::{Block, Eliminated};
use crate::error::Error;
use crate::linalg::{product, qr, singular_values, squared_norm};
use crate::ties::first_largest;
use faer::{Mat, MatRef};
use isobar_model::vector::{axpy, dot};
use rayon::prelude::*;

/// Blocks that one thread reduces at a time.
const BLOCKS: usize = 64;

/// A singular value below so much of the largest one is zero: rounding errors of a few thousand rows are far below it, and
/// a direction that is truly determined so badly would have to be known ten million times worse than another.
const RANK_TOLERANCE: f64 = 1e-7;

/// What rows say about the border alone: a triangle T with E'E = T'T for the rows E that the blocks leave.
#[derive(Clone, Debug)]
pub struct BorderRows {
    /// \[T d\], `[at most p + 1, p + 1]`.
    triangle: Mat<f64>,
}

/// The border as far as it is determined.
#[derive(Clone, Debug)]
pub struct DeterminedBorder {
    /// ĉ, `[p]`; zero in what is not determined.
    pub estimate: Vec<f64>,
    /// Its covariance, `[p, p]`; in what is not determined that of the scales.
    pub covariance: Mat<f64>,
    /// A basis of what is not determined, each combination `[p]` with a largest coefficient of 1 and as few others as
    /// can be.
    pub undetermined: Vec<Vec<f64>>,
    /// Sum of squares of the whitened residuals.
    pub residual_chi2: f64,
}

impl BorderRows {
    /// None yet, for `p` border unknowns.
    pub fn new(p: usize) -> Self {
        Self { triangle: Mat::zeros(0, p + 1) }
    }

    /// Those of a triangle `[rows, p + 1]` that an earlier batch came to.
    pub(crate) fn from_triangle(triangle: Mat<f64>) -> Self {
        Self { triangle }
    }

    /// \[T d\].
    pub(crate) fn triangle(&self) -> &Mat<f64> {
        &self.triangle
    }

    /// Eliminates the blocks' own unknowns, and adds what they leave for the border, in their order.
    ///
    /// # Errors
    /// Those of [`super::solve`], but for a border that the rows do not determine.
    pub fn add(&mut self, blocks: &[Block]) -> Result<(), Error> {
        let p = self.triangle.ncols() - 1;
        let triangles: Vec<Mat<f64>> = blocks
            .par_chunks(BLOCKS)
            .enumerate()
            .map(|(chunk, blocks)| {
                let eliminated: Vec<Eliminated> = (blocks.iter().enumerate())
                    .map(|(number, block)| block.eliminate(chunk * BLOCKS + number, p))
                    .collect::<Result<_, _>>()?;
                let rows: Vec<MatRef<'_, f64>> = eliminated.iter().map(|it| it.border_rows.as_ref()).collect();
                Ok(triangle_of(&rows, p + 1))
            })
            .collect::<Result<_, Error>>()?;
        let mut rows = vec![self.triangle.as_ref()];
        rows.extend(triangles.iter().map(Mat::as_ref));
        self.triangle = triangle_of(&rows, p + 1);
        Ok(())
    }

    /// ĉ where the rows determine it. `scales` says what counts as a change of the same size in each unknown, and is the
    /// standard deviation of what is not determined.
    pub fn solve(&self, scales: &[f64]) -> DeterminedBorder {
        let p = scales.len();
        assert_eq!(self.triangle.ncols(), p + 1);
        // Rows below are zero: SVD needs as many rows as columns.
        let entry = |i: usize, j: usize| if i < self.triangle.nrows() { self.triangle[(i, j)] } else { 0.0 };
        let scaled = Mat::from_fn(p + 1, p, |i, j| entry(i, j) * scales[j]);
        let d = Mat::from_fn(p + 1, 1, |i, _| entry(i, p));
        let (u, values, v) = singular_values(scaled.as_ref());
        let largest = values.iter().copied().fold(0.0, f64::max);
        let determined = |k: usize| values[k] > RANK_TOLERANCE * largest;
        let projected = product(u.transpose(), d.as_ref());
        let (mut estimate, mut roots) = (vec![0.0; p], Mat::zeros(p, p));
        let mut explained = 0.0;
        for k in 0..p {
            let inverse = if determined(k) { 1.0 / values[k] } else { 0.0 };
            explained += if determined(k) { projected[(k, 0)].powi(2) } else { 0.0 };
            for i in 0..p {
                estimate[i] += scales[i] * v[(i, k)] * inverse * projected[(k, 0)];
                roots[(i, k)] = scales[i] * v[(i, k)] * if determined(k) { inverse } else { 1.0 };
            }
        }
        let free: Vec<usize> = (0..p).filter(|&k| !determined(k)).collect();
        let basis = Mat::from_fn(p, free.len(), |i, k| scales[i] * v[(i, free[k])]);
        let total: f64 = (0..p + 1).map(|i| d[(i, 0)].powi(2)).sum();
        DeterminedBorder {
            estimate,
            covariance: product(roots.as_ref(), roots.transpose()),
            undetermined: reduced_basis(basis, scales),
            residual_chi2: (total - explained).max(0.0),
        }
    }
}

/// The triangle of rows one upon another.
fn triangle_of(rows: &[MatRef<'_, f64>], columns: usize) -> Mat<f64> {
    let mut stacked = Mat::zeros(rows.iter().map(|it| it.nrows()).sum(), columns);
    let mut first = 0;
    for rows in rows {
        stacked.as_mut().get_mut(first..first + rows.nrows(), ..).copy_from(rows);
        first += rows.nrows();
    }
    qr(stacked.as_ref()).thin_R().to_owned()
}

/// Another basis of the same space: each vector has an unknown that the others lack, and is scaled to a largest coefficient
/// of 1.
///
/// The unknowns are those that pivoted QR of the transposed basis, in units of the scales, comes upon (Businger and Golub
/// 1965, Numerische Mathematik 7): the next one is that whose row is the longest once those of the others are taken out of
/// it. Lengths are the same for every orthonormal basis of the space, and rounding decides which basis is given.
pub(crate) fn reduced_basis(mut basis: Mat<f64>, scales: &[f64]) -> Vec<Vec<f64>> {
    let (p, count) = (basis.nrows(), basis.ncols());
    let mut rows: Vec<Vec<f64>> = (0..p).map(|i| (0..count).map(|k| basis[(i, k)] / scales[i]).collect()).collect();
    let mut pivots: Vec<usize> = Vec::new();
    for _ in 0..count {
        let free: Vec<usize> = (0..p).filter(|i| !pivots.contains(i)).collect();
        let lengths = free.iter().map(|&i| squared_norm(&rows[i]));
        let Some(pivot) = first_largest(lengths).map(|longest| free[longest]) else { break };
        pivots.push(pivot);
        let along = rows[pivot].clone();
        let length = squared_norm(&along);
        if length > 0.0 {
            rows.iter_mut().for_each(|row| axpy(-dot(row, &along) / length, &along, row));
        }
    }
    // Gauss–Jordan elimination of the pivots' rows.
    for (k, &row) in pivots.iter().enumerate() {
        let size = |j: usize| basis[(row, j)].abs();
        let column = (k..count).max_by(|&a, &b| size(a).total_cmp(&size(b))).expect("there is column k");
        for i in 0..p {
            (basis[(i, k)], basis[(i, column)]) = (basis[(i, column)], basis[(i, k)]);
        }
        let pivot = basis[(row, k)];
        (0..p).for_each(|i| basis[(i, k)] /= pivot);
        for j in (0..count).filter(|&j| j != k) {
            let factor = basis[(row, j)];
            (0..p).for_each(|i| basis[(i, j)] -= factor * basis[(i, k)]);
        }
    }
    let vector = |k: usize| {
        let column = basis.col_as_slice(k);
        let largest = first_largest(column.iter().map(|value| value.abs())).map_or(1.0, |i| column[i]);
        // What elimination leaves of an exact zero.
        let clean = |value: &f64| if (value / largest).abs() < 1e-9 { 0.0 } else { value / largest };
        column.iter().map(clean).collect()
    };
    (0..count).map(vector).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two combinations that are as little determined as each other may come in any mixture of them.
    #[test]
    fn the_reduced_basis_of_a_space_is_the_same_for_all_of_its_bases() {
        let (a, b) = ([1.0, 1.0, 0.0, 0.5, 0.0], [0.0, 0.0, -3.0, 1.0, 3.0]);
        let norm = |v: &[f64; 5]| squared_norm(v).sqrt();
        let along = dot(&b, &a) / squared_norm(&a);
        let c: [f64; 5] = std::array::from_fn(|i| b[i] - along * a[i]);
        let reduced = |angle: f64| {
            let (sine, cosine) = angle.sin_cos();
            let basis = Mat::from_fn(5, 2, |i, j| {
                let (x, y) = (a[i] / norm(&a), c[i] / norm(&c));
                if j == 0 { cosine * x + sine * y } else { cosine * y - sine * x }
            });
            reduced_basis(basis, &[1.0; 5])
        };
        let expected = reduced(0.0);
        for angle in [1e-16, 0.3, 0.8, 2.0, 3.1, 5.5] {
            let found = reduced(angle);
            for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
                assert!((found - expected).abs() < 1e-9, "{angle}: {found} and {expected}");
            }
        }
        assert!(expected.iter().all(|it| it.contains(&1.0) && it.iter().all(|value| value.abs() < 1.0 + 1e-9)));
    }
}
