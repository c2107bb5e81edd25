//! Symmetric matrices with a band, and their Cholesky factors.

use crate::error::Error;
use isobar_model::vector::axpy;
use serde::{Deserialize, Serialize};

/// The lower half of a symmetric matrix whose entries further than `half` from the diagonal are zero, or a lower triangle
/// with such a band; column by column (LAPACK's band storage).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Band {
    size: usize,
    half: usize,
    /// Entry (j + d, j) is at `j (half + 1) + d`; what is beyond the last row is zero.
    values: Vec<f64>,
}

/// The least pivot of a matrix of correlations that is positive definite beyond rounding.
const LEAST_PIVOT: f64 = 1e-10;

/// Shares of the variances taken as uncorrelated where a matrix of correlations is singular to rounding, the least first.
const NUGGETS: [f64; 3] = [1e-12, 1e-10, 1e-8];

impl Band {
    /// Zero, with the band no wider than the matrix.
    pub fn zeros(size: usize, half: usize) -> Self {
        let half = half.min(size.saturating_sub(1));
        Self { size, half, values: vec![0.0; size * (half + 1)] }
    }

    /// The identity.
    pub fn identity(size: usize) -> Self {
        Self { size, half: 0, values: vec![1.0; size] }
    }

    /// Its half-bandwidth if it is a whole band of `size` rows, whatever was stored.
    pub fn half_of(&self, size: usize) -> Option<usize> {
        let fits = self.size == size && self.half < size && Some(self.values.len()) == size.checked_mul(self.half + 1);
        fits.then_some(self.half)
    }

    pub fn size(&self) -> usize {
        self.size
    }

    /// The number of diagonals below the main one.
    pub fn half(&self) -> usize {
        self.half
    }

    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Column j from the diagonal down, as far as the matrix goes.
    pub fn column(&self, j: usize) -> &[f64] {
        let start = j * (self.half + 1);
        &self.values[start..start + (self.half + 1).min(self.size - j)]
    }

    fn column_mut(&mut self, j: usize) -> &mut [f64] {
        let start = j * (self.half + 1);
        let length = (self.half + 1).min(self.size - j);
        &mut self.values[start..start + length]
    }

    /// The first column that row i may have an entry in.
    pub fn first(&self, i: usize) -> usize {
        i.saturating_sub(self.half)
    }

    /// Entry (i, j) with j ≤ i within the band.
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        self.values[j * (self.half + 1) + i - j]
    }

    /// The matrix += x xᵀ for an x that is zero but for its part from row `first` on, which must fit into the band.
    pub fn add_square(&mut self, first: usize, x: &[f64]) {
        for (d, &value) in x.iter().enumerate() {
            if value != 0.0 {
                let column = self.column_mut(first + d);
                column.iter_mut().zip(&x[d..]).for_each(|(entry, other)| *entry += value * other);
            }
        }
    }

    /// Its Cholesky factor, in m (half + 1)² operations.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`].
    pub fn cholesky(mut self, name: &str) -> Result<Self, Error> {
        for j in 0..self.size {
            let pivot = self.column(j)[0];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return Err(Error::NotPositiveDefinite { matrix: name.into(), pivot: j, size: self.size });
            }
            self.eliminate(j, pivot.sqrt());
        }
        Ok(self)
    }

    /// The factor L of a covariance with these variances and with the nearest correlations of a family to those of the matrix,
    /// and where in the family it is. What is left of a covariance P within a band need not be one; what is left of it with a
    /// taper is, by Schur's product theorem, for 1 − d/(h + 1) is a correlation function of the distance d in the order of
    /// the band (Bartlett 1950). Between the two,
    ///
    /// ```text
    /// ρ_ij (1 − t |i − j|/(h + 1)),    0 ≤ t ≤ 1,
    /// ```
    ///
    /// t is the least of 16 steps with which there is a Cholesky factor: 0 where the band of P is a covariance as it is, be it
    /// singular.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] where even the taper leaves no covariance: the matrix was none.
    pub fn covariance_factor(mut self) -> Result<(Self, f64), Error> {
        let sigma: Vec<f64> = (0..self.size).map(|j| self.column(j)[0].max(0.0).sqrt()).collect();
        for j in 0..self.size {
            let own = sigma[j];
            for (d, entry) in self.column_mut(j).iter_mut().enumerate() {
                let scale = own * sigma[j + d];
                *entry = if d == 0 {
                    1.0
                } else if scale > 0.0 {
                    *entry / scale
                } else {
                    0.0
                };
            }
        }
        let tapered = |taper: f64| {
            let mut own = self.clone();
            for j in 0..own.size {
                let reach = (own.half + 1) as f64;
                let column = own.column_mut(j).iter_mut().enumerate();
                column.for_each(|(d, entry)| *entry *= 1.0 - taper * d as f64 / reach);
            }
            own.correlation_factor()
        };
        let (mut root, mut taper) = (tapered(0.0), 0.0);
        if root.is_none() {
            let mut least = 0.0;
            (root, taper) = (tapered(1.0), 1.0);
            for _ in 0..4 {
                let middle = 0.5 * (least + taper);
                match tapered(middle) {
                    None => least = middle,
                    found => (root, taper) = (found, middle),
                }
            }
        }
        let matrix = || "the tapered band of the covariance".into();
        let mut root =
            root.ok_or_else(|| Error::NotPositiveDefinite { matrix: matrix(), pivot: 0, size: self.size })?;
        for j in 0..root.size {
            root.column_mut(j).iter_mut().zip(&sigma[j..]).for_each(|(entry, sigma)| *entry *= sigma);
        }
        Ok((root, taper))
    }

    /// The Cholesky factor of a matrix of correlations, if it is positive semidefinite.
    ///
    /// The pivots of a smooth covariance fall to rounding long before the last column, and dividing by them, or raising one of
    /// them, multiplies rounding errors without bounds. With a share δ of each variance taken as uncorrelated, (C + δ I)/(1 + δ),
    /// no pivot is below δ, and the Cholesky factorisation succeeds if δ exceeds a few m ε |C| (Higham 2002, Accuracy and
    /// Stability of Numerical Algorithms, theorem 10.7); the correlations change by δ.
    fn correlation_factor(self) -> Option<Self> {
        let with = |nugget: f64, least_pivot: f64| {
            let mut own = self.clone();
            for j in 0..own.size {
                own.column_mut(j)[1..].iter_mut().for_each(|entry| *entry /= 1.0 + nugget);
            }
            own.factor_above(least_pivot)
        };
        with(0.0, LEAST_PIVOT).or_else(|| NUGGETS.into_iter().find_map(|nugget| with(nugget, 0.0)))
    }

    /// The Cholesky factor, if all pivots are above a limit.
    fn factor_above(mut self, least_pivot: f64) -> Option<Self> {
        for j in 0..self.size {
            let pivot = self.column(j)[0];
            if !(pivot > least_pivot && pivot.is_finite()) {
                return None;
            }
            self.eliminate(j, pivot.sqrt());
        }
        Some(self)
    }

    /// Makes column j that of the factor, and takes what it explains off the columns to come.
    fn eliminate(&mut self, j: usize, root: f64) {
        let length = self.column(j).len();
        let column = self.column_mut(j);
        column[0] = root;
        column[1..].iter_mut().for_each(|entry| *entry /= root);
        let (done, rest) = self.values.split_at_mut((j + 1) * (self.half + 1));
        let column = &done[j * (self.half + 1)..][..length];
        for d in 1..length {
            let factor = column[d];
            if factor != 0.0 {
                let target = &mut rest[(d - 1) * (self.half + 1)..][..length - d];
                axpy(-factor, &column[d..], target);
            }
        }
    }

    /// x ← L⁻¹ x, for an x that is zero before row `first`.
    pub fn solve_lower(&self, first: usize, x: &mut [f64]) {
        for j in first..self.size {
            let column = self.column(j);
            let value = x[j] / column[0];
            x[j] = value;
            axpy(-value, &column[1..], &mut x[j + 1..j + column.len()]);
        }
    }

    /// x ← L⁻ᵀ x.
    pub fn solve_lower_transposed(&self, x: &mut [f64]) {
        for j in (0..self.size).rev() {
            let column = self.column(j);
            let known: f64 = column[1..].iter().zip(&x[j + 1..]).map(|(entry, x)| entry * x).sum();
            x[j] = (x[j] - known) / column[0];
        }
    }

    /// L x.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; self.size];
        for (j, &x) in x.iter().enumerate() {
            let column = self.column(j);
            axpy(x, column, &mut y[j..j + column.len()]);
        }
        y
    }

    /// Lᵀ x.
    pub fn multiply_transposed(&self, x: &[f64]) -> Vec<f64> {
        (0..self.size).map(|j| self.column(j).iter().zip(&x[j..]).map(|(entry, x)| entry * x).sum()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    fn dense(band: &Band, symmetric: bool) -> Vec<Vec<f64>> {
        let n = band.size();
        let entry = |i: usize, j: usize| match (i >= j, i.abs_diff(j) <= band.half()) {
            (true, true) => band.entry(i, j),
            (false, true) if symmetric => band.entry(j, i),
            _ => 0.0,
        };
        (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect()
    }

    fn square(root: &Band) -> Vec<Vec<f64>> {
        let l = dense(root, false);
        let n = root.size();
        (0..n).map(|i| (0..n).map(|j| (0..n).map(|k| l[i][k] * l[j][k]).sum()).collect()).collect()
    }

    fn largest_difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Sums of squares of random vectors within the band: positive definite with the unit matrix.
    fn positive(size: usize, half: usize) -> Band {
        let mut band = Band::zeros(size, half);
        for first in 0..size {
            band.values[first * (band.half + 1)] += 0.1;
            let length = (band.half + 1).min(size - first);
            band.add_square(first, &standard_normals(&mut stream(first as u64, "band"), length));
        }
        band
    }

    #[test]
    fn factors_of_positive_matrices_are_exact_and_need_no_taper() {
        for half in [0, 1, 4, 11, 50] {
            let band = positive(12, half);
            assert_eq!(band.half(), half.min(11));
            let (expected, scale) = (dense(&band, true), 30.0);
            let plain = band.clone().cholesky("a matrix").unwrap();
            assert!(largest_difference(&square(&plain), &expected) < 1e-13 * scale);
            let (factor, taper) = band.covariance_factor().unwrap();
            assert!(largest_difference(&square(&factor), &expected) < 1e-13 * scale && taper == 0.0);
            let x = standard_normals(&mut stream(1, "x"), 12);
            let mut y = plain.multiply(&x);
            plain.solve_lower(0, &mut y);
            let mut z = plain.multiply_transposed(&x);
            plain.solve_lower_transposed(&mut z);
            for solved in [y, z] {
                assert!(solved.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-11), "{half}");
            }
        }
    }

    /// Of a matrix of ones a band is left: with correlations of 1 between neighbours and 0 beyond, which no values have.
    #[test]
    fn a_band_that_is_no_covariance_becomes_one_with_its_variances() {
        let mut band = Band::zeros(6, 1);
        band.values.fill(4.0);
        let error = band.clone().cholesky("ones").unwrap_err();
        assert!(matches!(error, Error::NotPositiveDefinite { pivot: 1, size: 6, .. }), "{error}");
        let (root, taper) = band.covariance_factor().unwrap();
        // Positive definite are correlations below 1/(2 cos π/7) = 0.555.
        assert_eq!(taper, 15.0 / 16.0);
        let after = square(&root);
        for i in 0..6usize {
            for j in 0..6 {
                let expected = [4.0, 4.0 * (1.0 - taper / 2.0)].get(i.abs_diff(j)).copied().unwrap_or(0.0);
                assert!((after[i][j] - expected).abs() < 1e-12, "({i}, {j}): {}", after[i][j]);
            }
        }
    }

    /// With two variables that are the same, and a smooth one: covariances without full rank.
    #[test]
    fn rank_deficient_covariances_need_no_taper() {
        for (half, correlation) in
            [(7, (|_, _| 1.0) as fn(usize, usize) -> f64), (7, |i, j| (-(i.abs_diff(j) as f64 / 8.0).powi(2)).exp())]
        {
            let mut band = Band::zeros(8, half);
            for j in 0..8 {
                band.column_mut(j).iter_mut().enumerate().for_each(|(d, entry)| *entry = 9.0 * correlation(j + d, j));
            }
            let expected = dense(&band, true);
            let (root, taper) = band.covariance_factor().unwrap();
            assert!(taper == 0.0 && largest_difference(&square(&root), &expected) < 1e-10);
        }
    }

    /// Values on a periodic plane in the order of the band, with a Gaussian correlation of three cells: of 320 eigenvalues 250
    /// are rounding.
    #[test]
    fn a_smooth_covariance_that_is_singular_to_rounding_needs_no_taper() {
        let (nx, ny, length) = (20, 16, 3.0);
        let around = |d: usize, n: usize| -> f64 {
            let images = (-8..=8).map(|image| d as f64 + f64::from(image * n as i32));
            images.map(|d| (-0.5 * (d / length).powi(2)).exp()).sum()
        };
        let place = |index: usize| {
            let (line, y) = (index / ny, index % ny);
            (if line % 2 == 0 { line / 2 } else { nx - 1 - line / 2 }, y)
        };
        let size = nx * ny;
        let mut band = Band::zeros(size, size - 1);
        for j in 0..size {
            let (x, y) = place(j);
            for (d, entry) in band.column_mut(j).iter_mut().enumerate() {
                let (other_x, other_y) = place(j + d);
                *entry = around(x.abs_diff(other_x), nx) * around(y.abs_diff(other_y), ny);
            }
        }
        let expected = dense(&band, true);
        let (root, taper) = band.covariance_factor().unwrap();
        let difference = largest_difference(&square(&root), &expected);
        assert!(taper == 0.0 && difference < 1e-8, "taper {taper}, {difference:e}");
    }

    #[test]
    fn a_value_without_variance_stays_without() {
        let mut band = positive(5, 2);
        for (i, j) in [(2, 0), (2, 1), (2, 2), (3, 2), (4, 2)] {
            band.values[j * 3 + i - j] = 0.0;
        }
        let expected = dense(&band, true);
        let (root, taper) = band.covariance_factor().unwrap();
        assert!(largest_difference(&square(&root), &expected) < 1e-12 && taper == 0.0);
    }
}
