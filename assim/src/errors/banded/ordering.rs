//! The order in which neighbours of the grid come to stand near each other.

use isobar_model::{Boundary, Layout};

/// The number of each value, `[variable, y, x]`, in the order of the band: line by line across the shorter side, with all
/// variables of a cell together. A periodic side is folded, 0, n − 1, 1, n − 2, …, so that its ends, which are neighbours, are
/// never more than two lines apart.
pub(super) fn ordering(layout: &Layout) -> Vec<usize> {
    let grid = &layout.grid;
    let along_x = grid.nx >= grid.ny;
    let (lines, width) = if along_x { (grid.nx, grid.ny) } else { (grid.ny, grid.nx) };
    let is_periodic = match grid.boundary {
        Boundary::Periodic => true,
        Boundary::Channel => along_x,
    };
    let line = |number: usize| match (is_periodic, number % 2) {
        (false, _) => number,
        (true, 0) => number / 2,
        (true, _) => lines - 1 - number / 2,
    };
    let mut order = Vec::with_capacity(layout.len());
    for line in (0..lines).map(line) {
        for place in 0..width {
            let (x, y) = if along_x { (line, place) } else { (place, line) };
            order.extend((0..layout.variables.len()).map(|variable| variable * grid.cells() + y * grid.nx + x));
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Grid;

    #[test]
    fn every_value_once_and_neighbours_within_two_lines() {
        for (nx, ny, boundary) in [(7, 4, Boundary::Periodic), (4, 9, Boundary::Periodic), (6, 5, Boundary::Channel)] {
            let layout = isobar_model::shallow_water::layout(Grid { nx, ny, dx_m: 1e5, dy_m: 1e5, boundary });
            let order = ordering(&layout);
            let mut position = vec![usize::MAX; layout.len()];
            order.iter().enumerate().for_each(|(place, &index)| position[index] = place);
            assert!(position.iter().all(|&place| place < layout.len()));
            let line = 3 * nx.min(ny);
            for y in 0..ny {
                for x in 0..nx {
                    let here = position[y * nx + x];
                    let east = position[y * nx + (x + 1) % nx];
                    // Across the shorter side a line goes round by itself.
                    assert!(here.abs_diff(east) < 3 * line, "{nx} × {ny}: ({x}, {y})");
                }
            }
        }
    }
}
