//! Footprints: weighted means of a field about a point.

use isobar_model::{Boundary, Grid, Location};

/// Radius of a footprint, in units of its `sigma_m`.
pub const TRUNCATION: f64 = 3.0;

/// The (index, weight) entries of a Gaussian footprint of a variable at `location` about a point of the domain:
/// w ∝ exp(−r² / 2σ²) for the distance r ≤ 3σ of the variable's points, with Σ w = 1.
///
/// Periodic directions wrap; a wall cuts the footprint, and the rest is weighted up. A y-face variable is zero at a
/// channel's northern wall, which is not stored: its weight is counted, but has no entry (as in [`Grid::stencil`]).
/// `sigma_m = 0` is the bilinear interpolation to the point. Otherwise `sigma_m` must be at least half of a cell's
/// larger side, to have points inside, and 6σ less than the extent of each periodic direction; then the mean of r is
/// zero and its variance 0.949 σ² in each direction, but for the sampling by the grid.
///
/// # Panics
/// If the point is not in the domain.
pub fn footprint(grid: &Grid, location: Location, x_m: f64, y_m: f64, sigma_m: f64) -> Vec<(usize, f64)> {
    assert!(grid.contains(x_m, y_m), "a footprint's centre must lie in the domain");
    if sigma_m == 0.0 {
        return grid.stencil(location, x_m, y_m).map_or_else(Vec::new, |stencil| stencil.entries);
    }
    let radius = TRUNCATION * sigma_m;
    let (offset_x, offset_y) = location.offset();
    let range = |center: f64, step: f64, offset: f64| {
        let first = ((center - radius) / step - offset).ceil() as i64;
        let last = ((center + radius) / step - offset).floor() as i64;
        first..=last
    };
    let (nx, ny) = (grid.nx as i64, grid.ny as i64);
    let (mut entries, mut sum) = (Vec::new(), 0.0);
    for row in range(y_m, grid.dy_m, offset_y) {
        let stored_row = match grid.boundary {
            Boundary::Periodic => Some(row.rem_euclid(ny)),
            Boundary::Channel if offset_y == 0.0 && row == ny => None,
            Boundary::Channel if (0..ny).contains(&row) => Some(row),
            Boundary::Channel => continue,
        };
        let y = (row as f64 + offset_y) * grid.dy_m - y_m;
        for column in range(x_m, grid.dx_m, offset_x) {
            let x = (column as f64 + offset_x) * grid.dx_m - x_m;
            let square = x * x + y * y;
            if square > radius * radius {
                continue;
            }
            let weight = (-0.5 * square / (sigma_m * sigma_m)).exp();
            sum += weight;
            if let Some(row) = stored_row {
                entries.push(((row * nx + column.rem_euclid(nx)) as usize, weight));
            }
        }
    }
    for entry in &mut entries {
        entry.1 /= sum;
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(boundary: Boundary) -> Grid {
        Grid { nx: 40, ny: 30, dx_m: 1.0, dy_m: 1.5, boundary }
    }

    fn sum(entries: &[(usize, f64)]) -> f64 {
        entries.iter().map(|entry| entry.1).sum()
    }

    #[test]
    fn weights_sum_to_one_everywhere_and_no_value_occurs_twice() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let grid = grid(boundary);
            for location in [Location::Center, Location::XFace, Location::YFace] {
                for (x, y) in [(20.3, 20.1), (0.0, 0.0), (39.9, 1.0), (0.2, 26.0)] {
                    for sigma in [0.0, 0.75, 2.0, 6.0] {
                        let entries = footprint(&grid, location, x, y, sigma);
                        assert!((sum(&entries) - 1.0).abs() < 1e-13, "{boundary:?} {location:?} {x} {y} {sigma}");
                        let mut indices: Vec<usize> = entries.iter().map(|entry| entry.0).collect();
                        indices.sort_unstable();
                        indices.dedup();
                        assert_eq!(indices.len(), entries.len());
                    }
                }
            }
        }
    }

    #[test]
    fn moments_are_those_of_the_truncated_gaussian() {
        let grid = Grid { nx: 200, ny: 200, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let (x, y, sigma) = (100.3, 99.6, 10.0);
        let (mut mean_x, mut mean_y, mut square_x, mut square_y) = (0.0, 0.0, 0.0, 0.0);
        for (index, weight) in footprint(&grid, Location::Center, x, y, sigma) {
            let dx = grid.x_m(Location::Center, index % 200) - x;
            let dy = grid.y_m(Location::Center, index / 200) - y;
            mean_x += weight * dx;
            mean_y += weight * dy;
            square_x += weight * dx * dx;
            square_y += weight * dy * dy;
        }
        // Radial truncation at R = 3σ: variance σ² [1 − (R²/2σ²) e / (1 − e)], e = exp(−R²/2σ²), in each direction. The
        // jump of the weights at R (1 % of the largest) leaves a sampling error of about 1e-3.
        let e = (-4.5f64).exp();
        let variance = sigma * sigma * (1.0 - 4.5 * e / (1.0 - e));
        assert!((variance / (sigma * sigma) - 0.949).abs() < 1e-3);
        assert!(mean_x.abs() < 2e-3 * sigma && mean_y.abs() < 2e-3 * sigma, "{mean_x} {mean_y}");
        assert!((square_x / variance - 1.0).abs() < 5e-3, "{square_x}");
        assert!((square_y / variance - 1.0).abs() < 5e-3, "{square_y}");
    }

    #[test]
    fn footprints_wrap_in_periodic_directions() {
        let grid = grid(Boundary::Periodic);
        // The same footprint, moved by whole cells across both edges.
        let at_middle = footprint(&grid, Location::Center, 20.25, 15.3, 1.5);
        let at_corner = footprint(&grid, Location::Center, 0.25, 0.3, 1.5);
        let mut moved: Vec<(usize, f64)> = (at_middle.iter())
            .map(|&(index, weight)| {
                let (row, column) = (index / 40, index % 40);
                ((row + 30 - 10) % 30 * 40 + (column + 40 - 20) % 40, weight)
            })
            .collect();
        let mut at_corner = at_corner;
        moved.sort_by_key(|entry| entry.0);
        at_corner.sort_by_key(|entry| entry.0);
        assert_eq!(moved.len(), at_corner.len());
        for (a, b) in moved.iter().zip(&at_corner) {
            assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-13, "{a:?} {b:?}");
        }
        assert!(at_corner.iter().any(|entry| entry.0 % 40 > 30) && at_corner.iter().any(|entry| entry.0 / 40 > 20));
    }

    #[test]
    fn walls_cut_footprints_and_v_is_zero_at_the_northern_one() {
        let grid = grid(Boundary::Channel);
        let south = footprint(&grid, Location::Center, 20.0, 0.1, 2.0);
        assert!(south.iter().all(|&(index, _)| index / 40 <= 4), "nothing from the other wall");
        let v = footprint(&grid, Location::YFace, 20.0, 44.9, 2.0);
        // At the wall itself there is about half of the rest plus the wall's row: well below 1, well above 0.
        assert!((0.2..0.8).contains(&sum(&v)), "{}", sum(&v));
    }

    #[test]
    fn weights_decay_as_the_gaussian() {
        let grid = grid(Boundary::Channel);
        let entries = footprint(&grid, Location::Center, 20.5, 15.75, 2.0);
        let weight = |row: usize, column: usize| entries.iter().find(|entry| entry.0 == row * 40 + column).unwrap().1;
        assert!((weight(10, 22) / weight(10, 20) - (-0.5f64).exp()).abs() < 1e-14);
        assert!((weight(12, 20) / weight(10, 20) - (-0.5f64 * 9.0 / 4.0).exp()).abs() < 1e-14);
    }
}
