//! A field with a rim of ghost cells, so that every stencil is the same everywhere and vectorises.
//!
//! A padded field has `ny + 2 width` rows of `nx + 2 width` values (its *core*), and zeros before and after it. A
//! shift by rows and columns is a shift of the flat core, so a stencil is one long loop without branches; in the rim
//! it computes values that nobody reads. The boundary conditions are all in the linear map from field to padded
//! field ([`Halo::load`]), whose transpose is [`Halo::fold`].
//!
//! In a channel, centre and x-face fields are continued evenly beyond the walls (no flux, free slip: ζ = 0 there), and
//! y-face fields are zero at and beyond them.

use crate::error::{ModelError, require_positive};
use crate::grid::{Boundary, Grid, Location};

/// Shape of padded fields.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Halo {
    nx: usize,
    ny: usize,
    width: usize,
    boundary: Boundary,
}

impl Halo {
    /// A rim of `width` cells around the fields of `grid`.
    ///
    /// # Errors
    /// If the grid has fewer than four cells in a direction, or cells without extent.
    pub fn new(grid: &Grid, width: usize) -> Result<Self, ModelError> {
        let least = 4;
        if grid.nx < least || grid.ny < least {
            return Err(ModelError::GridTooSmall { nx: grid.nx, ny: grid.ny, least });
        }
        require_positive("dx_m", grid.dx_m)?;
        require_positive("dy_m", grid.dy_m)?;
        Ok(Self { nx: grid.nx, ny: grid.ny, width, boundary: grid.boundary })
    }

    /// Length of a row of the field proper.
    #[inline(always)]
    pub fn columns(&self) -> usize {
        self.nx
    }

    /// Length of a padded row.
    #[inline(always)]
    pub fn stride(&self) -> usize {
        self.nx + 2 * self.width
    }

    /// Number of values in the core.
    #[inline(always)]
    pub fn core_len(&self) -> usize {
        self.stride() * (self.ny + 2 * self.width)
    }

    /// Number of values of a padded field: core, and zeros before and after it.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.core_len() + 2 * self.slack()
    }

    /// A padded field of zeros.
    pub fn zeros(&self) -> Vec<f64> {
        vec![0.0; self.len()]
    }

    /// The core, shifted by rows and columns.
    #[inline(always)]
    pub fn shift<'a>(&self, padded: &'a [f64], rows: isize, columns: isize) -> &'a [f64] {
        let start = self.slack() as isize + rows * self.stride() as isize + columns;
        &padded[start as usize..][..self.core_len()]
    }

    /// The core.
    #[inline(always)]
    pub fn core<'a>(&self, padded: &'a [f64]) -> &'a [f64] {
        &padded[self.slack()..][..self.core_len()]
    }

    /// The core.
    #[inline(always)]
    pub fn core_mut<'a>(&self, padded: &'a mut [f64]) -> &'a mut [f64] {
        &mut padded[self.slack()..][..self.core_len()]
    }

    /// Row `j` of the field proper, shifted by rows and columns.
    #[inline(always)]
    pub fn row<'a>(&self, padded: &'a [f64], j: usize, rows: isize, columns: isize) -> &'a [f64] {
        let start = self.start(j) as isize + rows * self.stride() as isize + columns;
        &padded[start as usize..][..self.nx]
    }

    /// The first row on which a variable at `location` is free: 1 for v in a channel, whose row 0 is the wall.
    #[inline(always)]
    pub fn first_row(&self, location: Location) -> usize {
        (self.boundary == Boundary::Channel && location == Location::YFace) as usize
    }

    /// Pads a field: copies it and fills the rim.
    #[inline(always)]
    pub fn load(&self, location: Location, field: &[f64], padded: &mut [f64]) {
        for j in 0..self.ny {
            let start = self.start(j);
            padded[start..start + self.nx].copy_from_slice(&field[j * self.nx..(j + 1) * self.nx]);
        }
        self.fill(location, padded);
    }

    /// Pads a field with zeros instead of the boundary condition (walls included).
    #[inline(always)]
    pub fn load_without_rim(&self, location: Location, field: &[f64], padded: &mut [f64]) {
        let first = self.first_row(location);
        self.core_mut(padded).fill(0.0);
        for j in first..self.ny {
            let start = self.start(j);
            padded[start..start + self.nx].copy_from_slice(&field[j * self.nx..(j + 1) * self.nx]);
        }
    }

    /// Fills the rim from the field proper.
    #[inline(always)]
    pub fn fill(&self, location: Location, padded: &mut [f64]) {
        let (nx, stride, width) = (self.nx, self.stride(), self.width);
        self.for_each_ghost_row(location, |ghost, source| match source {
            Some(source) => padded.copy_within(source..source + nx, ghost),
            None => padded[ghost..ghost + nx].fill(0.0),
        });
        for row in 0..self.ny + 2 * width {
            let west = self.slack() + row * stride;
            for i in 0..width {
                padded[west + i] = padded[west + nx + i];
                padded[west + width + nx + i] = padded[west + width + i];
            }
        }
    }

    /// Transpose of [`Halo::load`]: adds the rim's values to the cells they came from, and the result to `field`.
    /// The padded field's rim is used up.
    #[inline(always)]
    pub fn fold(&self, location: Location, padded: &mut [f64], field: &mut [f64]) {
        let (nx, stride, width) = (self.nx, self.stride(), self.width);
        for row in 0..self.ny + 2 * width {
            let west = self.slack() + row * stride;
            for i in 0..width {
                padded[west + nx + i] += padded[west + i];
                padded[west + width + i] += padded[west + width + nx + i];
            }
        }
        self.for_each_ghost_row(location, |ghost, source| {
            if let Some(source) = source {
                for i in 0..nx {
                    padded[source + i] += padded[ghost + i];
                }
            }
        });
        for j in self.first_row(location)..self.ny {
            let source = &padded[self.start(j)..][..nx];
            for (value, add) in field[j * nx..(j + 1) * nx].iter_mut().zip(source) {
                *value += add;
            }
        }
    }

    /// Zeros before and after the core.
    #[inline(always)]
    fn slack(&self) -> usize {
        self.width * (self.stride() + 1)
    }

    /// Where row `j` of the field proper starts in a padded field.
    #[inline(always)]
    fn start(&self, j: usize) -> usize {
        self.slack() + (j + self.width) * self.stride() + self.width
    }

    /// Calls with the start of each ghost row (of a wall, the wall's own row too) and of the row it is a copy of;
    /// `None` means zero.
    #[inline(always)]
    fn for_each_ghost_row(&self, location: Location, mut visit: impl FnMut(usize, Option<usize>)) {
        let (ny, width, base) = (self.ny, self.width, self.slack() + self.width);
        let start = |padded_row: usize| base + padded_row * self.stride();
        for ghost in 1..=width {
            let (south, north) = (width - ghost, width + ny - 1 + ghost);
            match (self.boundary, location) {
                (Boundary::Periodic, _) => {
                    visit(start(south), Some(start(south + ny)));
                    visit(start(north), Some(start(north - ny)));
                }
                (Boundary::Channel, Location::Center | Location::XFace) => {
                    visit(start(south), Some(start(width + ghost - 1)));
                    visit(start(north), Some(start(width + ny - ghost)));
                }
                (Boundary::Channel, Location::YFace | Location::Corner) => {
                    visit(start(south), None);
                    visit(start(north), None);
                }
            }
        }
        if self.boundary == Boundary::Channel && location == Location::YFace {
            visit(start(width), None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fold_is_the_transpose_of_load() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            for width in [1, 2] {
                let grid = Grid { nx: 5, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary };
                let halo = Halo::new(&grid, width).unwrap();
                for location in [Location::Center, Location::XFace, Location::YFace] {
                    let n = grid.cells();
                    // Whole numbers: sums are exact.
                    let field: Vec<f64> = (0..n).map(|k| (k * k % 17) as f64 - 8.0).collect();
                    let mut padded = halo.zeros();
                    halo.load(location, &field, &mut padded);
                    let mut other = halo.zeros();
                    for (k, value) in halo.core_mut(&mut other).iter_mut().enumerate() {
                        *value = (k * k * k % 23) as f64 - 11.0;
                    }
                    let forward: f64 = padded.iter().zip(&other).map(|(a, b)| a * b).sum();
                    let mut back = vec![0.0; n];
                    halo.fold(location, &mut other, &mut back);
                    let backward: f64 = field.iter().zip(&back).map(|(a, b)| a * b).sum();
                    assert_eq!(forward, backward, "{boundary:?} {location:?} {width}");
                    assert_ne!(forward, 0.0);
                }
            }
        }
    }

    #[test]
    fn the_rim_continues_periodically_and_evenly() {
        let grid = Grid { nx: 4, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Channel };
        let halo = Halo::new(&grid, 2).unwrap();
        let field: Vec<f64> = (0..16).map(|k| k as f64 + 1.0).collect();
        let mut padded = halo.zeros();
        halo.load(Location::Center, &field, &mut padded);
        assert_eq!(halo.row(&padded, 0, -2, 0), &[5.0, 6.0, 7.0, 8.0]);
        assert_eq!(halo.row(&padded, 3, 1, -1), &[16.0, 13.0, 14.0, 15.0]);
        halo.load(Location::YFace, &field, &mut padded);
        assert_eq!(halo.row(&padded, 0, 0, 0), &[0.0; 4]);
        assert_eq!(halo.row(&padded, 3, 1, 0), &[0.0; 4]);
        assert_eq!(halo.row(&padded, 1, 0, 2), &[7.0, 8.0, 5.0, 6.0]);
    }
}
