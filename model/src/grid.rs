//! The Arakawa C grid on a plane, its boundaries, and bilinear interpolation to a point.

use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The edges of the domain in y. In x it is always periodic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Boundary {
    /// Doubly periodic.
    Periodic,
    /// Rigid walls at y = 0 and y = height: no normal flow, free slip.
    Channel,
}

/// Where in a cell a variable lives.
///
/// ```text
///      +----- v -----+      v: YFace   (j = 0 is the southern wall in a channel, where v = 0)
///      |             |      u: XFace   (the western face of cell (j, i))
///      u      h      |      h: Center
///      |             |      q: Corner  (the south-western corner)
///      q ---- v -----+
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Location {
    /// Cell centre, ((i + ½) dx, (j + ½) dy).
    Center,
    /// Western face, (i dx, (j + ½) dy).
    XFace,
    /// Southern face, ((i + ½) dx, j dy).
    YFace,
    /// South-western corner, (i dx, j dy).
    Corner,
}

/// A uniform grid of `ny` rows by `nx` columns of cells; the south-western corner of cell (0, 0) is the origin.
///
/// Every variable has `ny × nx` values, row by row from the south, whatever its [`Location`]. In a channel the row
/// j = 0 of a y-face variable is the southern wall; the northern wall is not stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Number of cells in x (columns).
    pub nx: usize,
    /// Number of cells in y (rows).
    pub ny: usize,
    /// Cell width \[m\].
    pub dx_m: f64,
    /// Cell height \[m\].
    pub dy_m: f64,
    /// The edges in y.
    pub boundary: Boundary,
}

/// The values that bilinear interpolation to one point reads: index within a variable's field, and weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stencil {
    /// (index into the `ny × nx` field, weight); at most four entries, no index twice.
    pub entries: Vec<(usize, f64)>,
}

impl Location {
    /// Offset from the cell's south-western corner, in cells (x, y).
    pub fn offset(self) -> (f64, f64) {
        match self {
            Location::Center => (0.5, 0.5),
            Location::XFace => (0.0, 0.5),
            Location::YFace => (0.5, 0.0),
            Location::Corner => (0.0, 0.0),
        }
    }
}

impl Grid {
    /// Some rows of the grid as a domain of its own, with walls at both ends.
    pub fn of_rows(&self, rows: &Range<isize>) -> Self {
        Self { ny: rows.len(), boundary: Boundary::Channel, ..self.clone() }
    }

    /// Those rows of fields `[field, y, x]`; rows beyond an edge are those at the other end of a periodic domain.
    pub fn take_rows(&self, rows: &Range<isize>, fields: &[f64]) -> Vec<f64> {
        let mut taken = Vec::with_capacity(fields.len() / self.ny * rows.len());
        for field in fields.chunks_exact(self.cells()) {
            for row in rows.clone() {
                taken.extend_from_slice(&field[wrap(row as i64, self.ny) * self.nx..][..self.nx]);
            }
        }
        taken
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.nx * self.ny
    }

    /// Extent in x \[m\].
    pub fn width_m(&self) -> f64 {
        self.nx as f64 * self.dx_m
    }

    /// Extent in y \[m\].
    pub fn height_m(&self) -> f64 {
        self.ny as f64 * self.dy_m
    }

    /// x of column `i` of a variable at `location` \[m\].
    pub fn x_m(&self, location: Location, i: usize) -> f64 {
        (i as f64 + location.offset().0) * self.dx_m
    }

    /// y of row `j` of a variable at `location` \[m\].
    pub fn y_m(&self, location: Location, j: usize) -> f64 {
        (j as f64 + location.offset().1) * self.dy_m
    }

    /// Whether the point lies in the domain (in a periodic direction: in its first image).
    pub fn contains(&self, x_m: f64, y_m: f64) -> bool {
        (0.0..self.width_m()).contains(&x_m) && (0.0..self.height_m()).contains(&y_m)
    }

    /// The same point in the first image of the domain: x modulo the width, and y modulo the height unless there are walls.
    pub fn first_image(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        let wrap = |position: f64, extent: f64| match position.rem_euclid(extent) {
            // The remainder of a tiny negative number rounds to the extent itself.
            rest if rest >= extent => 0.0,
            rest => rest,
        };
        let y_m = match self.boundary {
            Boundary::Periodic => wrap(y_m, self.height_m()),
            Boundary::Channel => y_m,
        };
        (wrap(x_m, self.width_m()), y_m)
    }

    /// Index of the cell in which a point of the domain lies.
    pub fn cell_at(&self, x_m: f64, y_m: f64) -> usize {
        let i = ((x_m / self.dx_m) as usize).min(self.nx - 1);
        let j = ((y_m / self.dy_m) as usize).min(self.ny - 1);
        j * self.nx + i
    }

    /// Index within its field of the grid point of a variable at `location` that is nearest to a point of the domain.
    pub fn nearest(&self, location: Location, x_m: f64, y_m: f64) -> usize {
        let (offset_x, offset_y) = location.offset();
        let column = wrap((x_m / self.dx_m - offset_x).round() as i64, self.nx);
        let row = (y_m / self.dy_m - offset_y).round() as i64;
        let row = match self.boundary {
            Boundary::Periodic => wrap(row, self.ny),
            Boundary::Channel => row.clamp(0, self.ny as i64 - 1) as usize,
        };
        row * self.nx + column
    }

    /// Bilinear interpolation of a variable at `location` to a point of the domain; `None` outside of it.
    ///
    /// In the half cell next to a wall, centre and x-face variables are continued constantly; a y-face variable is
    /// zero at the wall.
    pub fn stencil(&self, location: Location, x_m: f64, y_m: f64) -> Option<Stencil> {
        if !self.contains(x_m, y_m) {
            return None;
        }
        let (offset_x, offset_y) = location.offset();
        let (column, weight_x) = split(x_m / self.dx_m - offset_x);
        let (row, weight_y) = split(y_m / self.dy_m - offset_y);
        let columns = [(wrap(column, self.nx), 1.0 - weight_x), (wrap(column + 1, self.nx), weight_x)];
        let rows = [(row, 1.0 - weight_y), (row + 1, weight_y)].map(|(row, weight)| match self.boundary {
            Boundary::Periodic => (Some(wrap(row, self.ny)), weight),
            // The northern wall's v = 0 is not stored: it contributes nothing.
            Boundary::Channel if location.offset().1 == 0.0 && row >= self.ny as i64 => (None, weight),
            Boundary::Channel => (Some(row.clamp(0, self.ny as i64 - 1) as usize), weight),
        });
        let mut entries: Vec<(usize, f64)> = Vec::with_capacity(4);
        for (row, weight_row) in rows {
            for (column, weight_column) in columns {
                let (Some(row), weight) = (row, weight_row * weight_column) else { continue };
                if weight == 0.0 {
                    continue;
                }
                let index = row * self.nx + column;
                match entries.iter_mut().find(|entry| entry.0 == index) {
                    Some(entry) => entry.1 += weight,
                    None => entries.push((index, weight)),
                }
            }
        }
        Some(Stencil { entries })
    }
}

/// Whole part and fraction of a position in cells.
fn split(position: f64) -> (i64, f64) {
    let whole = position.floor();
    (whole as i64, position - whole)
}

fn wrap(index: i64, n: usize) -> usize {
    index.rem_euclid(n as i64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(boundary: Boundary) -> Grid {
        Grid { nx: 6, ny: 5, dx_m: 2.0, dy_m: 3.0, boundary }
    }

    #[test]
    fn interpolation_is_exact_for_linear_fields_and_at_the_points_themselves() {
        let grid = grid(Boundary::Channel);
        for location in [Location::Center, Location::XFace, Location::YFace, Location::Corner] {
            let field = |index: usize| {
                1.0 + 2.0 * grid.x_m(location, index % grid.nx) - 3.0 * grid.y_m(location, index / grid.nx)
            };
            let (x, y) = (5.3, 7.1);
            let stencil = grid.stencil(location, x, y).unwrap();
            let value: f64 = stencil.entries.iter().map(|&(index, weight)| weight * field(index)).sum();
            assert!((value - (1.0 + 2.0 * x - 3.0 * y)).abs() < 1e-12, "{location:?}: {value}");
            let at = grid.stencil(location, grid.x_m(location, 2), grid.y_m(location, 3)).unwrap();
            assert_eq!(at.entries, vec![(3 * grid.nx + 2, 1.0)]);
        }
    }

    #[test]
    fn the_nearest_grid_point_has_the_largest_weight() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let grid = grid(boundary);
            for location in [Location::Center, Location::XFace, Location::YFace, Location::Corner] {
                for (x, y) in [(0.1, 0.2), (5.3, 7.1), (11.9, 13.2), (11.2, 14.9), (0.3, 1.4)] {
                    let entries = grid.stencil(location, x, y).unwrap().entries;
                    let most = entries.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
                    let at_wall = boundary == Boundary::Channel && location.offset().1 == 0.0 && y > 12.0;
                    assert!(at_wall || grid.nearest(location, x, y) == most.0, "{boundary:?} {location:?} {x} {y}");
                }
            }
            assert_eq!(
                grid.nearest(Location::YFace, 1.0, 14.9) / grid.nx,
                if boundary == Boundary::Channel { 4 } else { 0 }
            );
        }
    }

    #[test]
    fn weights_sum_to_one_but_for_v_at_the_northern_wall() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let grid = grid(boundary);
            for location in [Location::Center, Location::XFace, Location::YFace] {
                for y in [0.1, 7.0, 14.9] {
                    let sum: f64 = grid.stencil(location, 11.9, y).unwrap().entries.iter().map(|entry| entry.1).sum();
                    let wall = boundary == Boundary::Channel && location == Location::YFace && y > 12.0;
                    let expected = if wall { (15.0 - y) / 3.0 } else { 1.0 };
                    assert!((sum - expected).abs() < 1e-12, "{boundary:?} {location:?} {y}: {sum}");
                }
            }
        }
    }

    #[test]
    fn points_beyond_a_periodic_edge_have_a_first_image() {
        assert_eq!(grid(Boundary::Periodic).first_image(12.0, -1.0), (0.0, 14.0));
        assert_eq!(grid(Boundary::Channel).first_image(-1.0, -1.0), (11.0, -1.0));
        assert_eq!(grid(Boundary::Periodic).first_image(-1e-30, 31.0), (0.0, 1.0));
    }

    #[test]
    fn points_outside_have_no_stencil() {
        assert!(grid(Boundary::Channel).stencil(Location::Center, 3.0, 15.0).is_none());
        assert!(grid(Boundary::Periodic).stencil(Location::Center, -0.1, 1.0).is_none());
        assert!(grid(Boundary::Periodic).stencil(Location::Center, f64::NAN, 1.0).is_none());
    }
}
