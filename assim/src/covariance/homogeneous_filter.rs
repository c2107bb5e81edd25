//! The symmetric square root of a homogeneous correlation, applied by FFT.

use crate::error::Error;
use isobar_model::{Boundary, Grid};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Beyond a wall the field is continued over this many correlation lengths before it wraps around, so that the two
/// walls are correlated by less than exp(−8) of the variance.
const PADDING_LENGTHS: f64 = 4.0;

/// The most values of a filtered array: twice those of the largest grid of a scenario, and about 2 GB at work.
const MOST_VALUES: usize = 1 << 25;

/// A correlation longer than this many periods of the domain is 1 everywhere, to the last bit.
const FLAT_PERIODS: f64 = 4.0;

/// An eigenvalue below minus this share of the largest is no rounding error.
const ROUNDING: f64 = 1e-13;

/// F⁻¹ Λ^½ F on an `nx × rows` array, Λ the eigenvalues of the circulant matrix of a correlation. The root is symmetric: it
/// is its own transpose.
pub(super) struct HomogeneousFilter {
    nx: usize,
    /// Rows of the filtered array: those of the grid, the northern wall's corners and padding in a channel.
    rows: usize,
    /// Λ^½ / (nx · rows), transposed `[column, row]`.
    root_eigenvalues: Vec<f64>,
    correlation: Correlation,
    forward: [Arc<dyn Fft<f64>>; 2],
    backward: [Arc<dyn Fft<f64>>; 2],
}

/// The correlation at a lag of columns and rows.
enum Correlation {
    /// The product of those along x and along y.
    Product([Vec<f64>; 2]),
    /// `[row, column]`.
    Table(Vec<f64>),
}

impl HomogeneousFilter {
    /// exp(−x²/2L_x² − y²/2L_y²), summed over the periodic images, so that Λ is positive for any length.
    ///
    /// # Errors
    /// [`Error::Setting`] for a length that needs too much padding in a channel.
    pub fn gaussian(grid: &Grid, [length_x_m, length_y_m]: [f64; 2]) -> Result<Self, Error> {
        let (nx, rows) = (grid.nx, Self::gaussian_rows(grid, length_y_m)?);
        let [forward, backward] = plans(nx, rows);
        let eigenvalues_x = correlation_eigenvalues(nx, grid.dx_m, length_x_m, forward[0].as_ref());
        let eigenvalues_y = correlation_eigenvalues(rows, grid.dy_m, length_y_m, forward[1].as_ref());
        let correlation = Correlation::Product([
            correlation_of(&eigenvalues_x, backward[0].as_ref()),
            correlation_of(&eigenvalues_y, backward[1].as_ref()),
        ]);
        let scale = 1.0 / (nx * rows) as f64;
        let root_eigenvalues =
            eigenvalues_x.iter().flat_map(|&x| eigenvalues_y.iter().map(move |&y| (x * y).sqrt() * scale)).collect();
        Ok(Self { nx, rows, root_eigenvalues, correlation, forward, backward })
    }

    /// The rows of the array of [`HomogeneousFilter::gaussian`].
    ///
    /// # Errors
    /// As there.
    pub fn gaussian_rows(grid: &Grid, length_y_m: f64) -> Result<usize, Error> {
        match grid.boundary {
            Boundary::Periodic => Ok(grid.ny),
            Boundary::Channel => padded_rows(grid, grid.ny + 1, (PADDING_LENGTHS, length_y_m)),
        }
    }

    /// A function of the distance \[m\], the shortest one where the plane is periodic, to which nothing is added. In a channel
    /// the array has twice the grid's rows at least, and `padding_lengths` times `length_m` beyond the wall, so that no
    /// distance goes round.
    ///
    /// # Errors
    /// [`Error::Setting`] if there is an eigenvalue below 0: it is then no correlation on this plane; for a length that needs
    /// too much padding in a channel.
    pub fn by_distance(
        grid: &Grid,
        (padding_lengths, length_m): (f64, f64),
        correlation: impl Fn(f64) -> f64,
    ) -> Result<Self, Error> {
        let nx = grid.nx;
        let rows = match grid.boundary {
            Boundary::Periodic => grid.ny,
            Boundary::Channel => padded_rows(grid, 2 * grid.ny, (padding_lengths, length_m))?,
        };
        let around = |index: usize, n: usize, spacing_m: f64| index.min(n - index) as f64 * spacing_m;
        let table: Vec<f64> = (0..rows)
            .flat_map(|j| (0..nx).map(move |i| (i, j)))
            .map(|(i, j)| correlation(around(i, nx, grid.dx_m).hypot(around(j, rows, grid.dy_m))))
            .collect();
        let [forward, backward] = plans(nx, rows);
        let mut array: Vec<Complex<f64>> = table.iter().map(|&value| Complex::new(value, 0.0)).collect();
        let mut eigenvalues = vec![Complex::default(); nx * rows];
        forward[0].process(&mut array);
        transpose(&array, &mut eigenvalues, rows, nx);
        forward[1].process(&mut eigenvalues);
        let limits = |(low, high): (f64, f64), value: &Complex<f64>| (low.min(value.re), high.max(value.re));
        let (least, largest) = eigenvalues.iter().fold((f64::INFINITY, 0.0), limits);
        if least < -ROUNDING * largest {
            return Err(Error::Setting(format!(
                "this function of distance is no covariance on this domain: its spectrum falls to {:.1e} of its largest value; \
                 a shorter length, or {:.1e} more of the variance uncorrelated, makes it one",
                least / largest,
                least / (least - 1.0)
            )));
        }
        let scale = 1.0 / (nx * rows) as f64;
        let root_eigenvalues = eigenvalues.iter().map(|value| value.re.max(0.0).sqrt() * scale).collect();
        Ok(Self { nx, rows, root_eigenvalues, correlation: Correlation::Table(table), forward, backward })
    }

    /// Values of the filtered array.
    pub fn len(&self) -> usize {
        self.nx * self.rows
    }

    /// The cell of a grid of `ny` rows that each value of the filtered array is in, or is nearest to beyond a wall.
    pub fn cells(&self, ny: usize) -> Vec<usize> {
        let row_of = |row: usize| match row {
            row if row < ny => row,
            // Padding belongs to the nearer wall.
            row if row - (ny - 1) <= self.rows - row => ny - 1,
            _ => 0,
        };
        (0..self.len()).map(|index| row_of(index / self.nx) * self.nx + index % self.nx).collect()
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The correlation of two values of the filtered array, by their indices.
    pub fn correlation(&self, first: usize, second: usize) -> f64 {
        let (row, column) = (first / self.nx, first % self.nx);
        let (other_row, other_column) = (second / self.nx, second % self.nx);
        let (rows, columns) = (row.abs_diff(other_row), column.abs_diff(other_column));
        match &self.correlation {
            Correlation::Product([x, y]) => x[columns] * y[rows],
            Correlation::Table(table) => table[rows * self.nx + columns],
        }
    }

    /// The mean over all wave numbers of Λ times a transfer function of the phases (k dx, l dy): the variance of a
    /// field with this correlation after an operator with that squared transfer function.
    pub fn variance_after(&self, squared_transfer: impl Fn(f64, f64) -> f64) -> f64 {
        self.spectrum().map(|([k, l], value)| value * squared_transfer(k, l)).sum::<f64>() / self.len() as f64
    }

    /// The phases (k dx, l dy) of each wave number, and its eigenvalue in Λ.
    pub fn spectrum(&self) -> impl Iterator<Item = ([f64; 2], f64)> + '_ {
        let phase = |index: usize, n: usize| std::f64::consts::TAU * index as f64 / n as f64;
        let n = self.len() as f64;
        self.root_eigenvalues.iter().enumerate().map(move |(index, root)| {
            let (i, j) = (index / self.rows, index % self.rows);
            ([phase(i, self.nx), phase(j, self.rows)], (root * n).powi(2))
        })
    }

    /// Multiplies the array by the root of the correlation matrix.
    pub fn apply(&self, field: &mut [f64]) {
        self.transfer(field, |root| root);
    }

    /// Multiplies the array by the correlation matrix.
    pub fn correlate(&self, field: &mut [f64]) {
        let n = self.len() as f64;
        self.transfer(field, |root| root * root * n);
    }

    /// Filters with a function of Λ^½ / (nx · rows), divided by nx · rows.
    fn transfer(&self, field: &mut [f64], transfer: impl Fn(f64) -> f64) {
        assert_eq!(field.len(), self.len());
        let mut array: Vec<Complex<f64>> = field.iter().map(|&value| Complex::new(value, 0.0)).collect();
        let mut transposed = vec![Complex::default(); self.len()];
        self.forward[0].process(&mut array);
        transpose(&array, &mut transposed, self.rows, self.nx);
        self.forward[1].process(&mut transposed);
        for (value, &root) in transposed.iter_mut().zip(&self.root_eigenvalues) {
            *value *= transfer(root);
        }
        self.backward[1].process(&mut transposed);
        transpose(&transposed, &mut array, self.nx, self.rows);
        self.backward[0].process(&mut array);
        field.iter_mut().zip(&array).for_each(|(value, filtered)| *value = filtered.re);
    }
}

/// A number of rows that is quick to transform, and no smaller than the rows of a channel, its northern wall and the padding.
///
/// # Errors
/// [`Error::Setting`] if the array would be too large, with the longest correlation that fits.
fn padded_rows(grid: &Grid, least: usize, (padding_lengths, length_m): (f64, f64)) -> Result<usize, Error> {
    let own = grid.ny + 1;
    let rows = f64::max(least as f64, own as f64 + (padding_lengths * length_m / grid.dy_m).ceil());
    let most = MOST_VALUES / grid.nx;
    if rows > most as f64 {
        let longest_km = most.saturating_sub(own) as f64 * grid.dy_m / padding_lengths / 1e3;
        return Err(Error::Setting(format!(
            "a correlation of {} km in this channel would need {} rows of {} values, its own and those of {padding_lengths} \
             lengths beyond the wall, more than {MOST_VALUES} values in all: at most {longest_km:.4} km fit",
            length_m / 1e3,
            rows,
            grid.nx
        )));
    }
    Ok(good_fft_size(rows as usize))
}

/// Transforms along x and along y, forward and backward.
fn plans(nx: usize, rows: usize) -> [[Arc<dyn Fft<f64>>; 2]; 2] {
    let mut planner = FftPlanner::new();
    [
        [planner.plan_fft_forward(nx), planner.plan_fft_forward(rows)],
        [planner.plan_fft_inverse(nx), planner.plan_fft_inverse(rows)],
    ]
}

/// `to[j, i] = from[i, j]`, where `from` has `rows` rows of `columns`; tile by tile, so that both stay in the cache.
fn transpose(from: &[Complex<f64>], to: &mut [Complex<f64>], rows: usize, columns: usize) {
    const TILE: usize = 16;
    for first_row in (0..rows).step_by(TILE) {
        for first_column in (0..columns).step_by(TILE) {
            for j in first_column..(first_column + TILE).min(columns) {
                for i in first_row..(first_row + TILE).min(rows) {
                    to[j * rows + i] = from[i * columns + j];
                }
            }
        }
    }
}

/// Eigenvalues of the circulant matrix of exp(−r²/2L²), normalised to a unit diagonal.
fn correlation_eigenvalues(n: usize, spacing_m: f64, length_m: f64, fft: &dyn Fft<f64>) -> Vec<f64> {
    let period = n as f64 * spacing_m;
    let length_m = length_m.min(FLAT_PERIODS * period);
    let images = (8.0 * length_m / period).ceil() as i64 + 1;
    let kernel = |index: usize| -> f64 {
        (-images..=images)
            .map(|image| ((index as f64 * spacing_m + image as f64 * period) / length_m).powi(2))
            .map(|squared| (-0.5 * squared).exp())
            .sum()
    };
    let variance = kernel(0);
    let mut values: Vec<Complex<f64>> = (0..n).map(|index| Complex::new(kernel(index) / variance, 0.0)).collect();
    fft.process(&mut values);
    // Rounding leaves tiny negative eigenvalues where the spectrum has died out.
    values.iter().map(|value| value.re.max(0.0)).collect()
}

/// The first column of the symmetric circulant matrix with these eigenvalues.
fn correlation_of(eigenvalues: &[f64], backward: &dyn Fft<f64>) -> Vec<f64> {
    let mut values: Vec<Complex<f64>> = eigenvalues.iter().map(|&value| Complex::new(value, 0.0)).collect();
    backward.process(&mut values);
    values.iter().map(|value| value.re / eigenvalues.len() as f64).collect()
}

/// The next size with factors 2, 3 and 5 only.
fn good_fft_size(at_least: usize) -> usize {
    (at_least..)
        .find(|&n| {
            let mut rest = n;
            for factor in [2, 3, 5] {
                while rest % factor == 0 {
                    rest /= factor;
                }
            }
            rest == 1
        })
        .expect("there is always a larger power of two")
}
