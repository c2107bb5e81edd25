//! Gaussian-correlated errors of one variable.

use super::Covariance;
use super::gaussian_filter::GaussianFilter;
use isobar_model::{Boundary, Layout, Location};

/// σ² exp(−r²/2L²) on one variable, nothing on the others. The southern wall's v = 0 has no error.
pub struct Univariate {
    len: usize,
    offset: usize,
    cells: usize,
    wall_values: usize,
    sigma: f64,
    filter: GaussianFilter,
}

impl Univariate {
    /// Errors with standard deviation `sigma` (in the variable's unit) and correlation length `length_m`.
    pub fn new(layout: &Layout, variable: usize, sigma: f64, length_m: f64) -> Self {
        let (grid, cells) = (&layout.grid, layout.grid.cells());
        let on_wall = grid.boundary == Boundary::Channel && layout.variables[variable].location == Location::YFace;
        Self {
            len: layout.len(),
            offset: variable * cells,
            cells,
            wall_values: if on_wall { grid.nx } else { 0 },
            sigma,
            filter: GaussianFilter::new(grid, length_m),
        }
    }
}

impl Covariance for Univariate {
    fn len(&self) -> usize {
        self.len
    }

    fn control_len(&self) -> usize {
        self.filter.len()
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        let mut filtered = control.to_vec();
        self.filter.apply(&mut filtered);
        let field = &mut increment[self.offset..][..self.cells];
        for (value, filtered) in field.iter_mut().zip(&filtered).skip(self.wall_values) {
            *value += self.sigma * filtered;
        }
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        let mut padded = vec![0.0; self.filter.len()];
        let field = &increment[self.offset..][..self.cells];
        for (value, field) in padded.iter_mut().zip(field).skip(self.wall_values) {
            *value = self.sigma * field;
        }
        self.filter.apply(&mut padded);
        for (control, filtered) in control.iter_mut().zip(padded) {
            *control += filtered;
        }
    }

    fn multiply_add(&self, increment: &[f64], result: &mut [f64]) {
        let varies = self.offset + self.wall_values..self.offset + self.cells;
        let mut padded = vec![0.0; self.filter.len()];
        padded[self.wall_values..self.cells].copy_from_slice(&increment[varies.clone()]);
        self.filter.correlate(&mut padded);
        for (value, correlated) in result[varies].iter_mut().zip(&padded[self.wall_values..]) {
            *value += self.sigma * self.sigma * correlated;
        }
    }

    fn covariance(&self, first: usize, second: usize) -> f64 {
        let varies = self.offset + self.wall_values..self.offset + self.cells;
        if !varies.contains(&first) || !varies.contains(&second) {
            return 0.0;
        }
        self.sigma * self.sigma * self.filter.correlation(first - self.offset, second - self.offset)
    }
}
