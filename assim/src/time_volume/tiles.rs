//! Patterns of tiles: smooth functions of place that sum to one.

use super::correction::CorrectionPattern;
use isobar_model::{Boundary, Grid};
use std::f64::consts::FRAC_PI_2;

/// A pattern for each of `tiles` = [in x, in y] tiles of equal size, row by row from the south: the product of a function
/// of x and one of y, each a raised cosine
///
/// ```text
/// w(d) = cos²(π d/2)  for |d| ≤ 1,  0 beyond,     d = distance from the middle of the tile in widths of a tile
/// ```
///
/// which with those of its neighbours sums to one everywhere: cos²(π d/2) + cos²(π (1 − d)/2) = 1. In a periodic direction
/// it is summed over all images of the domain, so that one tile alone is 1; beside a wall it stays what it is in the middle
/// of the outermost tile.
pub fn tile_patterns(grid: &Grid, tiles: [usize; 2]) -> Vec<CorrectionPattern> {
    let [nx, ny] = tiles;
    let of_columns: Vec<Vec<f64>> = (0..nx).map(|tile| raised_cosine(tile, nx, grid.nx, true)).collect();
    let is_periodic = grid.boundary == Boundary::Periodic;
    let of_rows: Vec<Vec<f64>> = (0..ny).map(|tile| raised_cosine(tile, ny, grid.ny, is_periodic)).collect();
    let mut patterns = Vec::with_capacity(nx * ny);
    for (j, rows) in of_rows.iter().enumerate() {
        for (i, columns) in of_columns.iter().enumerate() {
            let weights = rows.iter().flat_map(|row| columns.iter().map(move |column| row * column)).collect();
            patterns.push(CorrectionPattern { name: format!("tile x{} y{}", i + 1, j + 1), weights });
        }
    }
    patterns
}

/// The function of one of `tiles` tiles at the middles of `cells` cells.
fn raised_cosine(tile: usize, tiles: usize, cells: usize, is_periodic: bool) -> Vec<f64> {
    let middle = tile as f64 + 0.5;
    let value = |d: f64| if d.abs() < 1.0 { (FRAC_PI_2 * d).cos().powi(2) } else { 0.0 };
    let at = |cell: usize| {
        let position = (cell as f64 + 0.5) * tiles as f64 / cells as f64;
        if is_periodic {
            let d = position - middle;
            [-1.0, 0.0, 1.0].iter().map(|image| value(d + image * tiles as f64)).sum()
        } else {
            value(position.clamp(0.5, tiles as f64 - 0.5) - middle)
        }
    };
    (0..cells).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_sum_to_one_and_each_is_one_in_its_middle() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            for (nx, ny) in [(1, 1), (2, 1), (1, 2), (4, 3), (3, 2)] {
                let grid = Grid { nx: 12, ny: 6, dx_m: 1e5, dy_m: 2e5, boundary };
                let patterns = tile_patterns(&grid, [nx, ny]);
                assert_eq!(patterns.len(), nx * ny);
                for cell in 0..grid.cells() {
                    let sum: f64 = patterns.iter().map(|pattern| pattern.weights[cell]).sum();
                    assert!((sum - 1.0).abs() < 1e-14, "{boundary:?} {nx} × {ny}: {sum} at {cell}");
                }
            }
        }
        let grid = Grid { nx: 9, ny: 5, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Channel };
        let patterns = tile_patterns(&grid, [3, 1]);
        assert_eq!(patterns[1].name, "tile x2 y1");
        assert!((patterns[1].weights[2 * 9 + 4] - 1.0).abs() < 1e-14);
        assert!(patterns[1].weights[2 * 9 + 7] < 1e-14);
    }
}
