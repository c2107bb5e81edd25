//! Weights of local analyses on a coarser grid, interpolated to every cell.

use crate::linalg::product;
use faer::{Mat, MatRef};
use isobar_model::{Boundary, Layout};
use rayon::prelude::*;
use std::borrow::Cow;

/// Where in one direction analyses are made.
struct Axis {
    /// The cells with an analysis, ascending.
    points: Vec<usize>,
    cells: usize,
}

/// Between which points of an axis a cell lies: weight 1 − `fraction` of the first, `fraction` of the second.
#[derive(Clone, Copy)]
struct Bracket {
    first: usize,
    second: usize,
    fraction: f64,
}

/// The cells at which analyses are made, and the way from there to all cells: bilinear interpolation of the weights, which
/// vary more slowly than the fields (Yang, Kalnay, Hunt and Bowler 2009).
pub(super) struct WeightGrid {
    columns: Axis,
    rows: Axis,
    variables: usize,
    points: Vec<usize>,
}

impl Axis {
    fn new(cells: usize, spacing: usize, periodic: bool) -> Self {
        let mut points: Vec<usize> = (0..cells).step_by(spacing.max(1)).collect();
        if !periodic && points.last() != Some(&(cells - 1)) {
            points.push(cells - 1);
        }
        Self { points, cells }
    }

    fn bracket(&self, cell: usize) -> Bracket {
        let first = self.points.partition_point(|&point| point <= cell) - 1;
        let start = self.points[first];
        // Beyond the last point comes the first again: in a periodic direction only, as walls have a point of their own.
        let (second, end) = match self.points.get(first + 1) {
            Some(&end) => (first + 1, end),
            None => (0, self.cells),
        };
        Bracket { first, second, fraction: (cell - start) as f64 / (end - start) as f64 }
    }
}

impl WeightGrid {
    pub fn new(layout: &Layout, spacing: usize) -> Self {
        let grid = &layout.grid;
        let columns = Axis::new(grid.nx, spacing, true);
        let rows = Axis::new(grid.ny, spacing, grid.boundary == Boundary::Periodic);
        let points = rows.points.iter().flat_map(|row| columns.points.iter().map(move |i| row * grid.nx + i)).collect();
        Self { columns, rows, variables: layout.variables.len(), points }
    }

    /// The cells at which analyses are made.
    pub fn points(&self) -> &[usize] {
        &self.points
    }

    /// How many matrices of weights the interpolation along a row of cells holds.
    pub fn weights_in_row(&self) -> usize {
        if self.rows.points.len() < self.rows.cells { self.columns.points.len() } else { 0 }
    }

    /// The weights of a point of the coarse grid's column in row `j` of the full grid.
    fn in_row<'a>(&self, weights: &'a [Mat<f64>], column: usize, row: Bracket) -> Cow<'a, Mat<f64>> {
        let at = |point: usize| &weights[point * self.columns.points.len() + column];
        if row.fraction == 0.0 {
            return Cow::Borrowed(at(row.first));
        }
        Cow::Owned(blend(at(row.first), at(row.second), row.fraction))
    }

    /// The weights at any cell.
    pub fn weights_at(&self, weights: &[Mat<f64>], cell: usize) -> Mat<f64> {
        let row = self.rows.bracket(cell / self.columns.cells);
        let column = self.columns.bracket(cell % self.columns.cells);
        let (first, second) = (self.in_row(weights, column.first, row), self.in_row(weights, column.second, row));
        blend(&first, &second, column.fraction)
    }

    /// The mean of the weights at some cells, each with a weight of its own; `None` if these sum up to zero.
    pub fn mean(&self, weights: &[Mat<f64>], cells: impl Iterator<Item = (usize, f64)>) -> Option<Mat<f64>> {
        let mut shares = vec![0.0; weights.len()];
        for (cell, share) in cells {
            let row = self.rows.bracket(cell / self.columns.cells);
            let column = self.columns.bracket(cell % self.columns.cells);
            for (j, in_y) in [(row.first, 1.0 - row.fraction), (row.second, row.fraction)] {
                for (i, in_x) in [(column.first, 1.0 - column.fraction), (column.second, column.fraction)] {
                    shares[j * self.columns.points.len() + i] += share * in_y * in_x;
                }
            }
        }
        let total: f64 = shares.iter().sum();
        (total > 0.0).then(|| {
            let mut mean = Mat::zeros(weights[0].nrows(), weights[0].ncols());
            for (own, share) in weights.iter().zip(&shares).filter(|(_, share)| **share > 0.0) {
                mean += own * faer::Scale(share / total);
            }
            mean
        })
    }

    /// X T for perturbations X `[m + p, N]`, with the weights T `[N, N + 1]` of each cell; the last p rows are left as they
    /// are, with zeros in the last column.
    pub fn apply(&self, weights: &[Mat<f64>], perturbations: MatRef<'_, f64>) -> Mat<f64> {
        let columns = perturbations.ncols();
        let mut result = Mat::from_fn(perturbations.nrows(), weights[0].ncols(), |i, j| {
            if j < columns { perturbations[(i, j)] } else { 0.0 }
        });
        let rows: Vec<Vec<(usize, Mat<f64>)>> =
            (0..self.rows.cells).into_par_iter().map(|j| self.apply_to_row(weights, perturbations, j)).collect();
        for (first, block) in rows.iter().flatten() {
            let run = block.nrows() / self.variables;
            for column in 0..block.ncols() {
                let (source, target) = (block.col_as_slice(column), result.col_as_slice_mut(column));
                for variable in 0..self.variables {
                    let start = variable * self.cells() + first;
                    target[start..][..run].copy_from_slice(&source[variable * run..][..run]);
                }
            }
        }
        result
    }

    fn cells(&self) -> usize {
        self.rows.cells * self.columns.cells
    }

    /// The cells of row `j`, run by run between two points: the first cell, and the analysed values `[variable × run, N]`.
    fn apply_to_row(&self, weights: &[Mat<f64>], perturbations: MatRef<'_, f64>, j: usize) -> Vec<(usize, Mat<f64>)> {
        let row = self.rows.bracket(j);
        let points = &self.columns.points;
        let in_row: Vec<_> = (0..points.len()).map(|column| self.in_row(weights, column, row)).collect();
        let runs = points.iter().enumerate().map(|(column, &start)| {
            let end = points.get(column + 1).copied().unwrap_or(self.columns.cells);
            let (run, first) = (end - start, j * self.columns.cells + start);
            let values = Mat::from_fn(run * self.variables, perturbations.ncols(), |i, member| {
                perturbations[(i / run * self.cells() + first + i % run, member)]
            });
            let mut analysed = product(values.as_ref(), in_row[column].as_ref().as_ref());
            if run > 1 {
                let next = product(values.as_ref(), in_row[(column + 1) % points.len()].as_ref().as_ref());
                for member in 0..analysed.ncols() {
                    let (own, next) = (analysed.col_as_slice_mut(member), next.col_as_slice(member));
                    for (i, (own, next)) in own.iter_mut().zip(next).enumerate() {
                        *own += (i % run) as f64 / run as f64 * (next - *own);
                    }
                }
            }
            (first, analysed)
        });
        runs.collect()
    }
}

/// (1 − f) A + f B.
fn blend(a: &Mat<f64>, b: &Mat<f64>, fraction: f64) -> Mat<f64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] + fraction * (b[(i, j)] - a[(i, j)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Grid;

    /// Weights that are linear in the distance from a point are met exactly at every cell; around a periodic direction and
    /// up to a wall.
    #[test]
    fn weights_are_interpolated_between_points() {
        for (boundary, spacing) in [(Boundary::Periodic, 3), (Boundary::Channel, 3), (Boundary::Periodic, 1)] {
            let grid = Grid { nx: 7, ny: 8, dx_m: 1.0, dy_m: 1.0, boundary };
            let layout = isobar_model::shallow_water::layout(grid);
            let weight_grid = WeightGrid::new(&layout, spacing);
            let value = |point: usize| (point % 7) as f64 + 10.0 * (point / 7) as f64;
            let weights: Vec<Mat<f64>> = weight_grid
                .points()
                .iter()
                .map(|&point| Mat::from_fn(2, 2, |i, j| value(point) + (i + 2 * j) as f64))
                .collect();
            let perturbations =
                Mat::from_fn(layout.len() + 2, 2, |i, j| if i >= layout.len() { 7.0 } else { 1.0 + j as f64 });
            let result = weight_grid.apply(&weights, perturbations.as_ref());
            for cell in 0..56 {
                let at = weight_grid.weights_at(&weights, cell);
                for variable in 0..3 {
                    for j in 0..2 {
                        let expected = at[(0, j)] + 2.0 * at[(1, j)];
                        assert!((result[(variable * 56 + cell, j)] - expected).abs() < 1e-12);
                    }
                }
                let (i, j) = (cell % 7, cell / 7);
                // The last points of a row and of a periodic column look back to the first ones.
                if i <= 6 && (spacing == 1 || i < 6) && (boundary == Boundary::Channel || j <= 6) {
                    assert!((at[(0, 0)] - value(cell)).abs() < 1e-12, "{boundary:?} {cell}: {}", at[(0, 0)]);
                }
            }
            assert_eq!(result[(layout.len() + 1, 1)], 7.0);
            // A mean of two cells is that of their weights.
            let mean = weight_grid.mean(&weights, [(11, 1.0), (30, 3.0)].into_iter()).unwrap();
            let expected = 0.25 * weight_grid.weights_at(&weights, 11)[(1, 0)]
                + 0.75 * weight_grid.weights_at(&weights, 30)[(1, 0)];
            assert!((mean[(1, 0)] - expected).abs() < 1e-12);
            assert!(weight_grid.mean(&weights, std::iter::empty()).is_none());
        }
    }
}
