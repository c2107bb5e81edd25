//! Uncorrelated errors of one variable.

use super::{Covariance, Spectrum};
use isobar_model::{Boundary, Layout, Location};

/// σ² I on one variable, nothing on the others. The southern wall's v = 0 has no error.
pub struct White {
    len: usize,
    /// First index that varies, and number of values.
    start: usize,
    count: usize,
    cells: usize,
    sigma: f64,
}

impl White {
    /// White errors with standard deviation `sigma` of variable number `variable`, in its unit.
    pub fn new(layout: &Layout, variable: usize, sigma: f64) -> Self {
        let (grid, cells) = (&layout.grid, layout.grid.cells());
        let on_wall = grid.boundary == Boundary::Channel && layout.variables[variable].location == Location::YFace;
        let wall = if on_wall { grid.nx } else { 0 };
        Self { len: layout.len(), start: variable * cells + wall, count: cells - wall, cells, sigma }
    }
}

impl Covariance for White {
    fn len(&self) -> usize {
        self.len
    }

    fn control_len(&self) -> usize {
        self.count
    }

    fn control_cells(&self) -> Option<Vec<usize>> {
        Some((self.start..self.start + self.count).map(|value| value % self.cells).collect())
    }

    fn spectrum(&self, _: &[f64]) -> Option<Spectrum> {
        Some(Spectrum::default())
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        for (value, control) in increment[self.start..][..self.count].iter_mut().zip(control) {
            *value += self.sigma * control;
        }
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        for (control, value) in control.iter_mut().zip(&increment[self.start..][..self.count]) {
            *control += self.sigma * value;
        }
    }

    fn multiply_add(&self, increment: &[f64], result: &mut [f64]) {
        let varies = self.start..self.start + self.count;
        for (result, value) in result[varies.clone()].iter_mut().zip(&increment[varies]) {
            *result += self.sigma * self.sigma * value;
        }
    }

    fn covariance(&self, first: usize, second: usize) -> f64 {
        let varies = (self.start..self.start + self.count).contains(&first);
        if first == second && varies { self.sigma * self.sigma } else { 0.0 }
    }
}
