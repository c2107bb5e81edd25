//! Patterns that move with the flow, as errors of a model do that belong to what it carries: waves, vortices, air masses.
//!
//! ```text
//! w_k(x, t) = w_k(x − s(t), 0),     ds/dt = the mean of the flow over the domain
//! ```
//!
//! All patterns move alike. So they keep their shapes, and their sum where it is one; moved by the flow of each place they would be
//! wound up within days by its shear. Between the middles of cells they are interpolated linearly, always from where they are at
//! the start, so that they are not smoothed the more the further they move. In a channel they move eastward only.

use super::correction::{Candidate, CorrectionPattern};
use isobar_model::{Boundary, Grid};

/// Candidates whose patterns have moved by some distance \[m\], eastward and northward, if they move.
pub(super) fn moved(candidates: &[Candidate], grid: &Grid, by_m: [f64; 2]) -> Vec<Candidate> {
    let [x_m, y_m] = by_m;
    let y_m = if grid.boundary == Boundary::Channel { 0.0 } else { y_m };
    let [columns, rows] = [(x_m / grid.dx_m, grid.nx), (y_m / grid.dy_m, grid.ny)].map(|(cells, n)| sources(cells, n));
    let moved = |pattern: &CorrectionPattern| {
        let at = |j: usize, i: usize| pattern.weights[j * grid.nx + i];
        let mut weights = Vec::with_capacity(grid.cells());
        for &[(j0, b0), (j1, b1)] in &rows {
            for &[(i0, a0), (i1, a1)] in &columns {
                weights.push(b0 * (a0 * at(j0, i0) + a1 * at(j0, i1)) + b1 * (a0 * at(j1, i0) + a1 * at(j1, i1)));
            }
        }
        CorrectionPattern { name: pattern.name.clone(), weights }
    };
    let of_candidate = |candidate: &Candidate| {
        if !candidate.moves_with_flow {
            return candidate.clone();
        }
        Candidate { patterns: candidate.patterns.iter().map(moved).collect(), ..candidate.clone() }
    };
    candidates.iter().map(of_candidate).collect()
}

/// For each of `n` cells of a periodic direction the two from which its value comes when all have moved by this number of cells,
/// with their shares.
fn sources(by_cells: f64, n: usize) -> Vec<[(usize, f64); 2]> {
    let source = |cell: usize| {
        let from = (cell as f64 - by_cells).rem_euclid(n as f64);
        let (first, share) = (from.floor(), from.fract());
        [(first as usize % n, 1.0 - share), ((first as usize + 1) % n, share)]
    };
    (0..n).map(source).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tiles::tile_patterns;
    use super::*;

    fn candidates(boundary: Boundary) -> (Grid, [Candidate; 2]) {
        let grid = Grid { nx: 12, ny: 8, dx_m: 1e5, dy_m: 2e5, boundary };
        let patterns = tile_patterns(&grid, [3, 2]);
        let moving = Candidate {
            name: "u".into(),
            unit: "m s-1".into(),
            step: 1.0,
            sigma_prior: None,
            patterns,
            moves_with_flow: true,
        };
        let still = Candidate { moves_with_flow: false, ..moving.clone() };
        (grid, [moving, still])
    }

    #[test]
    fn patterns_move_by_cells_and_parts_of_cells_and_keep_their_sum() {
        let (grid, candidates) = candidates(Boundary::Periodic);
        let weights = |moved: &[Candidate], own: usize, j: usize, i: usize| moved[own].patterns[1].weights[j * 12 + i];
        // Once round the domain and three cells more, and two rows back.
        let whole = moved(&candidates, &grid, [15e5, -4e5]);
        let part = moved(&candidates, &grid, [2.75e5, 0.0]);
        for (j, i) in (0..8).flat_map(|j| (0..12).map(move |i| (j, i))) {
            assert_eq!(weights(&whole, 0, j, (i + 3) % 12), weights(&candidates, 0, (j + 2) % 8, i));
            let expected =
                0.25 * weights(&candidates, 0, j, (i + 10) % 12) + 0.75 * weights(&candidates, 0, j, (i + 9) % 12);
            assert!((weights(&part, 0, j, i) - expected).abs() < 1e-14);
            let sum: f64 = part[0].patterns.iter().map(|it| it.weights[j * 12 + i]).sum();
            assert!((sum - 1.0).abs() < 1e-14);
        }
        assert_eq!(part[1], candidates[1]);
    }

    #[test]
    fn in_a_channel_they_do_not_move_through_the_walls() {
        let (grid, candidates) = candidates(Boundary::Channel);
        assert_eq!(moved(&candidates, &grid, [0.0, 3e5]), candidates);
        assert_eq!(moved(&candidates, &grid, [1e5, 3e5]), moved(&candidates, &grid, [1e5, 0.0]));
    }
}
