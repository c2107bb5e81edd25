//! Correlated observation errors: the regression of each error on earlier ones.

use crate::sparse::SparseRows;
use serde::{Deserialize, Serialize};

/// The regression of each observation's error on those of the observations before it,
///
/// ```text
/// ε_i/σ_i = Σ_{j<i} b_ij ε_j/σ_j + √v_i ζ_i,    ζ ~ N(0, I),    so that    R = U diag(v_i σ_i²) Uᵀ,    U⁻¹ = T = I − (b_ij σ_i/σ_j)
/// ```
///
/// the factors of R with a unit triangle (Bierman 1977, Factorization Methods for Discrete Sequential Estimation). T ε are
/// independent errors with standard deviations √v_i σ_i. Observations of different reports have no b, so that T is
/// block-diagonal like R; where no errors are correlated it is I, and nothing changes to the bit.
///
/// The default stands for any number of independent errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorRegression {
    /// b, a row for each error.
    weights: SparseRows,
    /// v of each error.
    shares: Vec<f64>,
}

impl ErrorRegression {
    /// Appends an error: (number of an earlier observation, b), and v, the share of its variance that the earlier errors do
    /// not explain.
    ///
    /// # Panics
    /// If a number is not that of an earlier observation.
    pub fn push(&mut self, weights: impl IntoIterator<Item = (usize, f64)>, share: f64) {
        let row = self.shares.len();
        self.weights.push_row(weights.into_iter().inspect(|(before, _)| assert!(*before < row, "a later error")));
        self.shares.push(share);
    }

    /// The same with further errors that are independent of all others.
    pub fn with_independent(mut self, further: usize) -> Self {
        // The default stands for any number.
        if !self.shares.is_empty() {
            (0..further).for_each(|_| self.push([], 1.0));
        }
        self
    }

    /// Whether no error depends on another one.
    pub fn is_independent(&self) -> bool {
        (0..self.shares.len()).all(|row| self.weights.row(row).is_empty())
    }

    /// Whether it can be the regression of this many errors; one that has been read from a file may not.
    pub fn fits(&self, observations: usize) -> bool {
        let is_before = |row: usize| self.weights.row(row).iter().all(|(before, _)| *before < row);
        self.shares.is_empty() && self.weights.rows() == 0
            || self.shares.len() == observations
                && self.weights.has_shape(observations, observations)
                && (0..observations).all(is_before)
    }

    /// √v_i σ_i, the standard deviations of T ε.
    pub fn whitened_sigma(&self, sigma: &[f64]) -> Vec<f64> {
        if self.is_independent() {
            return sigma.to_vec();
        }
        sigma.iter().zip(&self.shares).map(|(sigma, share)| sigma * share.sqrt()).collect()
    }

    /// y ← T y.
    pub fn whiten(&self, sigma: &[f64], y: &mut [f64]) {
        for row in (0..self.shares.len()).rev() {
            y[row] -= self.known(sigma, row, y);
        }
    }

    /// y ← T⁻¹ y: turns independent errors with standard deviations [`ErrorRegression::whitened_sigma`] into errors with
    /// covariance R.
    pub fn correlate(&self, sigma: &[f64], y: &mut [f64]) {
        for row in 0..self.shares.len() {
            y[row] += self.known(sigma, row, y);
        }
    }

    /// T M, row by row: a row also reads what the rows read on whose errors its error depends.
    pub fn whiten_rows(&self, sigma: &[f64], rows: &SparseRows) -> SparseRows {
        let mut whitened = SparseRows::new();
        for row in 0..rows.rows() {
            let mut entries = rows.row(row).to_vec();
            if !self.weights_of(row).is_empty() {
                for (before, weight) in self.weights_in_units(sigma, row) {
                    entries.extend(rows.row(before).iter().map(|&(column, value)| (column, -weight * value)));
                }
                entries.sort_by_key(|entry| entry.0);
                entries.dedup_by(|next, kept| {
                    let is_same = next.0 == kept.0;
                    if is_same {
                        kept.1 += next.1;
                    }
                    is_same
                });
            }
            whitened.push_row(entries);
        }
        whitened
    }

    /// R, row by row, `[n, n]`: Cov(ε_i, ε_j) = Σ_k b_ik σ_i/σ_k Cov(ε_k, ε_j) for j < i, plus v_i σ_i² for j = i.
    pub fn covariance(&self, sigma: &[f64]) -> Vec<Vec<f64>> {
        let n = sigma.len();
        let own = self.whitened_sigma(sigma);
        let mut covariance = vec![vec![0.0; n]; n];
        for i in 0..n {
            let on: Vec<(usize, f64)> = self.weights_in_units(sigma, i).collect();
            for j in 0..i {
                let value = on.iter().map(|&(before, weight)| weight * covariance[before][j]).sum();
                covariance[i][j] = value;
                covariance[j][i] = value;
            }
            let known: f64 = on.iter().map(|&(before, weight)| weight * covariance[i][before]).sum();
            covariance[i][i] = known + own[i] * own[i];
        }
        covariance
    }

    /// (j, b_ij) of observation i.
    fn weights_of(&self, row: usize) -> &[(usize, f64)] {
        // The default has no rows for its independent errors.
        if row < self.shares.len() { self.weights.row(row) } else { &[] }
    }

    /// (j, b_ij σ_i/σ_j).
    fn weights_in_units(&self, sigma: &[f64], row: usize) -> impl Iterator<Item = (usize, f64)> {
        self.weights_of(row).iter().map(move |&(before, weight)| (before, weight * sigma[row] / sigma[before]))
    }

    /// Σ_j b_ij σ_i/σ_j y_j.
    fn known(&self, sigma: &[f64], row: usize, y: &[f64]) -> f64 {
        self.weights_in_units(sigma, row).map(|(before, weight)| weight * y[before]).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA: [f64; 4] = [2.0, 0.5, 3.0, 1.0];

    /// Error 1 is independent of the others, 0 and 2 have a correlation of 0.6, and 3 depends on both of these.
    fn regression() -> ErrorRegression {
        let mut regression = ErrorRegression::default();
        regression.push([], 1.0);
        regression.push([], 1.0);
        regression.push([(0, 0.6)], 1.0 - 0.36);
        regression.push([(0, 0.2), (2, -0.3)], 0.5);
        regression
    }

    /// By hand: Cov(ε_2, ε_0) = 0.6 σ_0 σ_2, and of ε_3 = 0.2/2 ε_0 − 0.3/3 ε_2 + √0.5 ζ.
    #[test]
    fn the_covariance_is_that_of_the_regression() {
        let r = regression().covariance(&SIGMA);
        let expected = [
            [4.0, 0.0, 3.6, 0.1 * 4.0 - 0.1 * 3.6],
            [0.0, 0.25, 0.0, 0.0],
            [3.6, 0.0, 9.0, 0.1 * 3.6 - 0.1 * 9.0],
            [0.04, 0.0, -0.54, 0.1 * 0.04 + 0.1 * 0.54 + 0.5],
        ];
        for (i, row) in r.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - expected[i][j]).abs() < 1e-14, "{i} {j}: {value}");
            }
        }
    }

    /// T R Tᵀ = D, T⁻¹ T = I, and rows of a matrix are whitened as vectors are.
    #[test]
    fn whitening_makes_errors_independent() {
        let (regression, r) = (regression(), regression().covariance(&SIGMA));
        let whiten = |mut y: Vec<f64>| {
            regression.whiten(&SIGMA, &mut y);
            y
        };
        let half: Vec<Vec<f64>> = r.into_iter().map(whiten).collect();
        let sigma = regression.whitened_sigma(&SIGMA);
        for j in 0..4 {
            let column = whiten(half.iter().map(|row| row[j]).collect());
            for (i, value) in column.iter().enumerate() {
                let expected = if i == j { sigma[i] * sigma[i] } else { 0.0 };
                assert!((value - expected).abs() < 1e-14, "{i} {j}: {value}");
            }
        }
        let y = vec![1.0, -2.0, 0.3, 7.0];
        let mut back = whiten(y.clone());
        regression.correlate(&SIGMA, &mut back);
        assert!(back.iter().zip(&y).all(|(a, b)| (a - b).abs() < 1e-14), "{back:?}");

        let mut rows = SparseRows::new();
        [&[(1, 2.0), (0, 1.0)][..], &[(3, 1.0)], &[(1, -1.0)], &[(2, 0.5), (1, 1.0)]]
            .iter()
            .for_each(|row| rows.push_row(row.iter().copied()));
        let x = [0.3, -0.7, 1.1, 0.2];
        let multiply = |rows: &SparseRows| (0..4).map(|row| rows.row_dot(row, &x)).collect::<Vec<f64>>();
        let whitened = regression.whiten_rows(&SIGMA, &rows);
        let expected = whiten(multiply(&rows));
        assert!(multiply(&whitened).iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-15));
        assert_eq!((whitened.row(0), whitened.row(2).len()), (rows.row(0), 2));
    }

    #[test]
    fn independent_errors_stay_as_they_are() {
        let mut regression = ErrorRegression::default();
        (0..4).for_each(|_| regression.push([], 1.0));
        for regression in [regression, ErrorRegression::default()] {
            let mut y = vec![0.1, 0.2, 0.3, 0.4];
            regression.whiten(&SIGMA, &mut y);
            regression.correlate(&SIGMA, &mut y);
            assert_eq!((y, regression.whitened_sigma(&SIGMA)), (vec![0.1, 0.2, 0.3, 0.4], SIGMA.to_vec()));
            assert!(regression.is_independent() && regression.fits(4));
            assert_eq!(regression.covariance(&SIGMA)[2], [0.0, 0.0, 9.0, 0.0]);
        }
        assert!(!super::tests::regression().is_independent() && !super::tests::regression().fits(3));
    }
}
