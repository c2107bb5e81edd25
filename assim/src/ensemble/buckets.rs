//! Places on a plane, found by where they are.

use isobar_model::{Boundary, Grid};

/// Numbers of places in a grid of buckets, so that those near a place are found without trying all.
pub(super) struct Buckets {
    x: Direction,
    y: Direction,
    radius_m: f64,
    /// Where a bucket begins among the numbers, row by row; with the end of the last.
    starts: Vec<usize>,
    /// Ascending in each bucket.
    numbers: Vec<usize>,
}

/// The buckets in one direction.
struct Direction {
    count: usize,
    width_m: f64,
    is_periodic: bool,
}

impl Direction {
    /// Buckets half a radius wide, if they are not smaller than cells.
    fn new(length_m: f64, cells: usize, radius_m: f64, is_periodic: bool) -> Self {
        let count = (2.0 * length_m / radius_m).clamp(1.0, cells as f64) as usize;
        Self { count, width_m: length_m / count as f64, is_periodic }
    }

    /// A position in widths of a bucket.
    fn widths(&self, position_m: f64) -> f64 {
        (position_m / self.width_m).floor()
    }

    fn bucket(&self, widths: f64) -> usize {
        let last = self.count as f64 - 1.0;
        (if self.is_periodic { widths.rem_euclid(self.count as f64) } else { widths.clamp(0.0, last) }) as usize
    }

    /// The buckets of an interval, each once.
    fn range(&self, low_m: f64, high_m: f64) -> impl Iterator<Item = usize> {
        let (low, high) = (self.widths(low_m), self.widths(high_m));
        let reach = high - low + 1.0;
        let (first, count) = if !self.is_periodic {
            (self.bucket(low), self.bucket(high) - self.bucket(low) + 1)
        } else if reach < self.count as f64 {
            (self.bucket(low), reach as usize)
        } else {
            (0, self.count)
        };
        (first..first + count).map(|bucket| bucket % self.count)
    }
}

impl Buckets {
    /// Places on a plane that are to be found within a radius \[m\], infinite for all.
    pub fn new(grid: &Grid, radius_m: f64, places: &[(f64, f64)]) -> Self {
        let x = Direction::new(grid.width_m(), grid.nx, radius_m, true);
        let y = Direction::new(grid.height_m(), grid.ny, radius_m, grid.boundary == Boundary::Periodic);
        let buckets: Vec<usize> =
            places.iter().map(|&(x_m, y_m)| y.bucket(y.widths(y_m)) * x.count + x.bucket(x.widths(x_m))).collect();
        let mut starts = vec![0; x.count * y.count + 1];
        buckets.iter().for_each(|bucket| starts[bucket + 1] += 1);
        (1..starts.len()).for_each(|bucket| starts[bucket] += starts[bucket - 1]);
        let (mut next, mut numbers) = (starts.clone(), vec![0; places.len()]);
        for (number, &bucket) in buckets.iter().enumerate() {
            numbers[next[bucket]] = number;
            next[bucket] += 1;
        }
        Self { x, y, radius_m, starts, numbers }
    }

    /// Puts the numbers of all places within the radius of a line along x, and of some others, in ascending order in
    /// `found`.
    pub fn near(&self, [west_m, east_m]: [f64; 2], y_m: f64, found: &mut Vec<usize>) {
        found.clear();
        // Rounding loses no place.
        let [in_x, in_y] = [&self.x, &self.y].map(|direction| self.radius_m + 1e-6 * direction.width_m);
        for row in self.y.range(y_m - in_y, y_m + in_y) {
            for column in self.x.range(west_m - in_x, east_m + in_x) {
                let bucket = row * self.x.count + column;
                found.extend_from_slice(&self.numbers[self.starts[bucket]..self.starts[bucket + 1]]);
            }
        }
        found.sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use super::super::localization::Taper;
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    /// Those with a weight are all found, ascending and once, around a periodic plane and along a wall, and of places far
    /// away few are.
    #[test]
    fn all_places_near_a_line_are_found() {
        let normals = standard_normals(&mut stream(5, "places"), 400);
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let grid = Grid { nx: 24, ny: 18, dx_m: 1.5, dy_m: 1.0, boundary };
            // Some of them out of the domain.
            let places: Vec<(f64, f64)> =
                normals.chunks_exact(2).map(|pair| (18.0 + 12.0 * pair[0], 9.0 + 6.0 * pair[1])).collect();
            for radius in [0.3, 2.0, 5.5, 9.0, 40.0, f64::INFINITY] {
                let (buckets, taper) = (Buckets::new(&grid, radius, &places), Taper::new(&grid, radius));
                let (mut found, mut total) = (Vec::new(), 0);
                for cell in 0..grid.cells() {
                    let (x, y) = ((cell % 24) as f64 * 1.5 + 0.75, (cell / 24) as f64 + 0.5);
                    buckets.near([x, x + 3.0], y, &mut found);
                    assert!(found.windows(2).all(|pair| pair[0] < pair[1]));
                    for (number, &place) in places.iter().enumerate() {
                        let is_near = taper.weight((x, y), place) > 0.0 || taper.weight((x + 3.0, y), place) > 0.0;
                        assert!(!is_near || found.binary_search(&number).is_ok(), "{radius} {cell} {number}");
                    }
                    total += found.len();
                }
                assert!(radius > 3.0 || total < 200 * grid.cells() / 4, "{total}");
            }
        }
    }
}
