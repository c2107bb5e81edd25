//! Where local analyses are made, and how they are interpolated between.

use isobar_model::{Boundary, Grid};
use std::ops::Range;

/// The points of one direction at which analyses are made.
pub(super) struct Axis {
    /// The cells with an analysis, ascending; the first is cell 0.
    points: Vec<usize>,
    cells: usize,
}

/// The cells at which analyses are made. Between them their weights are interpolated bilinearly, since these vary more
/// slowly than the fields (Yang, Kalnay, Hunt and Bowler 2009). What weights make of perturbations is linear in the weights, so
/// that each analysis may as well be applied to all cells up to the next ones, and what they become be interpolated.
pub(super) struct WeightGrid {
    pub columns: Axis,
    pub rows: Axis,
}

impl Axis {
    fn new(cells: usize, spacing: usize, periodic: bool) -> Self {
        let mut points: Vec<usize> = (0..cells).step_by(spacing.max(1)).collect();
        if !periodic && points.last() != Some(&(cells - 1)) {
            points.push(cells - 1);
        }
        Self { points, cells }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// The cell of a point.
    pub fn cell(&self, point: usize) -> usize {
        self.points[point]
    }

    /// The cells from some points on, up to the next one. Beyond the last point comes the first again, in a periodic
    /// direction; walls have a point of their own.
    pub fn cells(&self, points: Range<usize>) -> Range<usize> {
        self.points[points.start]..self.points.get(points.end).copied().unwrap_or(self.cells)
    }

    /// The cells from a point on, each with the weight that the point has there: 1 at the point, and less up to the next.
    pub fn after(&self, point: usize) -> impl Iterator<Item = (usize, f64)> {
        let cells = self.cells(point..point + 1);
        let (start, count) = (cells.start, cells.len() as f64);
        cells.map(move |cell| (cell, 1.0 - (cell - start) as f64 / count))
    }

    /// The cells between the point before and a point, each with the weight that the latter has there.
    pub fn before(&self, point: usize) -> impl Iterator<Item = (usize, f64)> {
        let previous = if point == 0 { self.len() - 1 } else { point - 1 };
        self.after(previous).skip(1).map(|(cell, weight)| (cell, 1.0 - weight))
    }

    /// The points around a cell with their weights there.
    pub fn around(&self, cell: usize) -> [(usize, f64); 2] {
        let point = self.points.partition_point(|&point| point <= cell) - 1;
        let cells = self.cells(point..point + 1);
        let fraction = (cell - cells.start) as f64 / cells.len() as f64;
        [(point, 1.0 - fraction), ((point + 1) % self.len(), fraction)]
    }
}

impl WeightGrid {
    /// Analyses `spacing` cells apart in x and in y.
    pub fn new(grid: &Grid, spacing: usize) -> Self {
        let columns = Axis::new(grid.nx, spacing, true);
        let rows = Axis::new(grid.ny, spacing, grid.boundary == Boundary::Periodic);
        Self { columns, rows }
    }

    /// Number of analyses.
    pub fn len(&self) -> usize {
        self.rows.len() * self.columns.len()
    }

    /// The share that each analysis has in the mean over some cells, each with a weight of its own; `None` if these sum up
    /// to zero.
    pub fn shares(&self, cells: impl Iterator<Item = (usize, f64)>) -> Option<Vec<f64>> {
        let mut shares = vec![0.0; self.len()];
        for (cell, share) in cells {
            for (j, in_y) in self.rows.around(cell / self.columns.cells) {
                for (i, in_x) in self.columns.around(cell % self.columns.cells) {
                    shares[j * self.columns.len() + i] += share * in_y * in_x;
                }
            }
        }
        let total: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= total);
        (total > 0.0).then_some(shares)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The weights of all points in a cell sum up to one, whichever way they are listed, and what is linear in the distance
    /// is met exactly; around a periodic direction and up to a wall.
    #[test]
    fn weights_are_interpolated_between_points() {
        for (cells, spacing, periodic) in [(7, 3, true), (8, 3, false), (8, 1, true), (6, 2, true), (5, 9, true)] {
            let axis = Axis::new(cells, spacing, periodic);
            let mut weights = vec![vec![0.0; axis.len()]; cells];
            for point in 0..axis.len() {
                for (cell, weight) in axis.after(point).chain(axis.before(point)) {
                    assert!(weight > 0.0);
                    weights[cell][point] += weight;
                }
            }
            for (cell, weights) in weights.iter().enumerate() {
                let mut around = vec![0.0; axis.len()];
                axis.around(cell).iter().for_each(|&(point, weight)| around[point] += weight);
                assert!(around.iter().zip(weights).all(|(a, b)| (a - b).abs() < 1e-15));
                assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
                // The last cells look back to the first point.
                if cell <= axis.cell(axis.len() - 1) {
                    let met: f64 = (0..axis.len()).map(|point| weights[point] * axis.cell(point) as f64).sum();
                    assert!((met - cell as f64).abs() < 1e-12, "{cell}: {met}");
                }
            }
            assert_eq!(axis.cells(0..axis.len()), 0..cells);
        }
    }

    #[test]
    fn shares_are_those_of_the_cells() {
        let grid = Grid { nx: 7, ny: 8, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Channel };
        let weights = WeightGrid::new(&grid, 3);
        let shares = weights.shares([(3, 1.0), (21, 3.0)].into_iter()).unwrap();
        let expected = [(1, 0.25), (weights.columns.len(), 0.75)];
        for (point, share) in shares.iter().enumerate() {
            let expected = expected.iter().find(|it| it.0 == point).map_or(0.0, |it| it.1);
            assert!((share - expected).abs() < 1e-15);
        }
        assert!(weights.shares(std::iter::empty()).is_none());
    }
}
