//! Homogeneous errors of one variable.

use super::homogeneous_filter::HomogeneousFilter;
use super::taper::MOST_HEIGHTS;
use super::{CorrelationFunction, Covariance, Spectrum};
use crate::error::Error;
use isobar_model::{Boundary, Layout, Location};

/// In a channel the field is continued over this many lengths beyond its walls.
const PADDING_LENGTHS: f64 = 8.0;

/// σ² ρ(r) on one variable, nothing on the others. The southern wall's v = 0 has no error.
pub struct Univariate {
    len: usize,
    offset: usize,
    cells: usize,
    ny: usize,
    wall_values: usize,
    sigma: f64,
    filter: HomogeneousFilter,
}

impl Univariate {
    /// Errors with standard deviation `sigma` (in the variable's unit) and ρ = exp(−r²/2L²), L = `length_m`, summed over the
    /// images of a periodic plane.
    ///
    /// # Errors
    /// [`Error::Setting`] for a length that needs too much padding in a channel.
    pub fn new(layout: &Layout, variable: usize, sigma: f64, length_m: f64) -> Result<Self, Error> {
        let across_m = length_m.min(MOST_HEIGHTS * layout.grid.height_m());
        let filter = HomogeneousFilter::gaussian(&layout.grid, [length_m, across_m])?;
        Ok(Self::with_filter(layout, variable, sigma, filter))
    }

    /// Errors with standard deviation `sigma` and ρ = f δ(r) + (1 − f) c(r/L): c a function of the shortest distance, to the
    /// letter, L = `length_m`, f the fraction of the variance that is not correlated from point to point (a nugget).
    ///
    /// # Errors
    /// [`Error::Setting`] if that is no covariance on this plane. On a periodic one the shortest distance has a kink half way
    /// round, which a small fraction mends where the correlation there is small. A length that needs too much padding in a
    /// channel.
    pub fn by_distance(
        layout: &Layout,
        variable: usize,
        sigma: f64,
        (correlation, length_m): (CorrelationFunction, f64),
        uncorrelated_fraction: f64,
    ) -> Result<Self, Error> {
        let value = |distance_m: f64| {
            let point = if distance_m == 0.0 { uncorrelated_fraction } else { 0.0 };
            point + (1.0 - uncorrelated_fraction) * correlation.at(distance_m / length_m)
        };
        let filter = HomogeneousFilter::by_distance(&layout.grid, (PADDING_LENGTHS, length_m), value)?;
        Ok(Self::with_filter(layout, variable, sigma, filter))
    }

    fn with_filter(layout: &Layout, variable: usize, sigma: f64, filter: HomogeneousFilter) -> Self {
        let (grid, cells) = (&layout.grid, layout.grid.cells());
        let on_wall = grid.boundary == Boundary::Channel && layout.variables[variable].location == Location::YFace;
        Self {
            len: layout.len(),
            offset: variable * cells,
            cells,
            ny: grid.ny,
            wall_values: if on_wall { grid.nx } else { 0 },
            sigma,
            filter,
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

    fn control_cells(&self) -> Option<Vec<usize>> {
        Some(self.filter.cells(self.ny))
    }

    fn spectrum(&self, scales: &[f64]) -> Option<Spectrum> {
        let variance = (self.sigma / scales[self.offset + self.cells - 1]).powi(2);
        let eigenvalues: Vec<f64> = self.filter.spectrum().map(|(_, value)| variance * value).collect();
        let share = (self.cells - self.wall_values) as f64 / self.filter.len() as f64;
        Some(Spectrum::above_white(&eigenvalues, share))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::dense;
    use crate::testing::check_covariance;
    use isobar_model::{Grid, shallow_water};

    const ALL: [CorrelationFunction; 5] = [
        CorrelationFunction::Gaussian,
        CorrelationFunction::Exponential,
        CorrelationFunction::SecondOrderAutoregressive,
        CorrelationFunction::ThirdOrderAutoregressive,
        CorrelationFunction::GaspariCohn,
    ];

    #[test]
    fn by_distance_is_the_function_of_the_shortest_distance() {
        for (boundary, function) in
            [Boundary::Periodic, Boundary::Channel].into_iter().flat_map(|b| ALL.map(|f| (b, f)))
        {
            let layout = shallow_water::layout(Grid { nx: 12, ny: 7, dx_m: 2.0, dy_m: 3.0, boundary });
            let (variable, sigma, length) = (2, 1.7, 1.5);
            let own = Univariate::by_distance(&layout, variable, sigma, (function, length), 0.1).unwrap();
            check_covariance(&own);
            let (matrix, cells) = (dense(&own), layout.grid.cells());
            let walls = boundary == Boundary::Channel;
            for (i, j) in (0..matrix.nrows()).flat_map(|i| (0..matrix.nrows()).map(move |j| (i, j))) {
                // The southern wall's v = 0 has no error.
                let least = variable * cells + if walls { 12 } else { 0 };
                let (a, b) = (i % cells, j % cells);
                let (dx, dy) = ((a % 12).abs_diff(b % 12), (a / 12).abs_diff(b / 12));
                let dy = if walls { dy } else { dy.min(7 - dy) };
                let distance = (2.0 * dx.min(12 - dx) as f64).hypot(3.0 * dy as f64);
                let nugget = if i == j { 0.1 } else { 0.0 };
                let expected = sigma * sigma * (nugget + 0.9 * function.at(distance / length));
                let expected = if i < least || j < least { 0.0 } else { expected };
                assert!((matrix[(i, j)] - expected).abs() < 1e-13, "{boundary:?} {function:?} {i} {j}");
            }
        }
    }

    #[test]
    fn what_is_no_covariance_is_refused_and_a_small_fraction_mends_it() {
        let grid = Grid { nx: 20, ny: 1, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let layout = isobar_model::advection::layout(grid);
        let of = |length, fraction| {
            Univariate::by_distance(&layout, 0, 1.0, (CorrelationFunction::Gaussian, length), fraction)
        };
        let Err(Error::Setting(message)) = of(4.0, 0.0) else { panic!("it has negative eigenvalues") };
        assert!(message.contains("no covariance on this domain"), "{message}");
        let named: f64 = message.split("length, or ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(of(4.0, 1.1 * named).is_ok());
        assert!(of(1.0, 0.0).is_ok());
    }
}
