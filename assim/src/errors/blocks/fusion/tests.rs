//! Fusions and divisions against dense matrices.

use super::super::BlockShape;
use super::super::division::Division;
use super::*;
use faer::Side;
use faer::linalg::solvers::DenseSolveCore;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Grid, Layout, Location, Variable};

/// 5 × 4 cells with two variables each.
fn layout() -> Layout {
    let variable =
        |name| Variable { name, long_name: name, standard_name: None, unit: "m", location: Location::Center };
    let grid = Grid { nx: 5, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
    Layout { grid, variables: vec![variable("h"), variable("w")] }
}

/// Tiles of 2 × 2 of the cells.
pub fn blocks() -> Blocks {
    Blocks::new(&layout(), BlockShape::Tile { nx: 2, ny: 2 }, &[])
}

pub fn normals(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
    let values = standard_normals(&mut stream(seed, "fusion"), rows * columns);
    Mat::from_fn(rows, columns, |i, j| values[j * rows + i])
}

/// Random positive definite blocks and r factors, which carry p biases.
pub fn covariance(blocks: &Blocks, p: usize, r: usize, seed: u64) -> FactoredCovariance {
    let m = blocks.variables();
    let mut own = BlockDiagonal::zeros(blocks);
    own.for_each_block(blocks, |block, mut matrix| {
        let size = matrix.nrows();
        let root = normals(size, size, 1000 * seed + block as u64);
        let mut square = product(root.as_ref(), root.transpose());
        (0..size).for_each(|i| square[(i, i)] += 0.1);
        matrix.copy_from(square);
    });
    let state = standard_normals(&mut stream(seed, "factors"), m * r);
    let shared = Matrix(normals(p, r, seed + 1));
    let precision = crate::tall_matrix::Precision::Double;
    let (state, local) = (TallMatrix::from_values(m, r, state), TallMatrix::zeros(0, r, precision));
    let factors = Factors { state, local, shared, past: VecDeque::new() };
    FactoredCovariance { own, linked: Vec::new(), factors }
}

fn inverse(matrix: &Mat<f64>) -> Mat<f64> {
    matrix.llt(Side::Lower).unwrap().inverse()
}

/// The inverse of the sum of dense inverses, each of the state and of the biases of its system.
#[test]
fn information_adds_up() {
    let blocks = blocks();
    let m = blocks.variables();
    let sizes = [(2, 3), (1, 4), (0, 0)];
    let p: usize = sizes.iter().map(|(p, _)| p).sum();
    let mut first = 0;
    let (mut information, mut weighted) = (Mat::<f64>::zeros(m + p, m + p), Mat::<f64>::zeros(m + p, 1));
    let mut fused: Option<Fused> = None;
    for (number, (own, r)) in sizes.into_iter().enumerate() {
        let seed = 10 * number as u64;
        let covariance = covariance(&blocks, own, r, seed);
        let estimate = normals(m + own, 1, seed + 5);
        let inverse = inverse(&covariance.dense(&blocks));
        let place = |i: usize| if i < m { i } else { m + first + i - m };
        let seen = &inverse * &estimate;
        for (i, j) in (0..m + own).flat_map(|i| (0..m + own).map(move |j| (i, j))) {
            information[(place(i), place(j))] += inverse[(i, j)];
        }
        (0..m + own).for_each(|i| weighted[(place(i), 0)] += seen[(i, 0)]);
        first += own;
        let (state, biases) = estimate.col_as_slice(0).split_at(m);
        let FactoredCovariance { own, factors, .. } = covariance;
        let other = Fused { state: state.to_vec(), biases: biases.to_vec(), own, factors };
        fused = Some(match fused {
            None => other,
            Some(fused) => fused.fuse(other, &blocks, |block| block.to_string()).unwrap(),
        });
    }
    let Fused { state, biases, own, factors } = fused.unwrap();
    let expected = inverse(&information);
    let found = FactoredCovariance { own, linked: Vec::new(), factors }.dense(&blocks);
    let error = (&found - &expected).norm_max() / expected.norm_max();
    assert!(error < 1e-9, "{error:e}");
    let expected = expected * weighted;
    for (i, value) in state.iter().chain(&biases).enumerate() {
        assert!((value - expected[(i, 0)]).abs() < 1e-9, "{i}: {value} and {}", expected[(i, 0)]);
    }
}

/// The shares of the information of three local filters.
const SHARES: [f64; 3] = [0.5, 0.2, 0.3];

/// A covariance that is divided among local filters with some of its parameters each, and fused again.
fn divided_and_fused(covariance: &FactoredCovariance, blocks: &Blocks, parameters: [&[usize]; 3]) -> Mat<f64> {
    let FactoredCovariance { own, factors, .. } = covariance;
    let division = Division::new(own, factors, blocks, |block| block.to_string()).unwrap();
    let local = parameters.iter().zip(SHARES).map(|(parameters, share)| {
        let (own, factors) = division.divide(blocks, share, parameters).unwrap();
        Fused { state: vec![0.0; blocks.variables()], biases: vec![0.0; parameters.len()], own, factors }
    });
    let fused = local.reduce(|fused, other| fused.fuse(other, blocks, |block| block.to_string()).unwrap());
    let Fused { own, factors, .. } = fused.unwrap();
    FactoredCovariance { own, linked: Vec::new(), factors }.dense(blocks)
}

/// Without biases Σ (P/β_i)⁻¹ = P⁻¹ with any blocks and factors. With them, what one block holds of the state, and of the biases
/// with it, is what was divided, and the biases of each filter have their covariance; those of two filters have in common what
/// the state explains of both, P_cx P_xx⁻¹ P_xc.
#[test]
fn a_division_fused_again_is_what_was_divided() {
    let tiles = blocks();
    let m = tiles.variables();
    let whole = covariance(&tiles, 0, 5, 7);
    let expected = whole.dense(&tiles);
    let found = divided_and_fused(&whole, &tiles, [&[]; 3]);
    let error = (&found - &expected).norm_max() / expected.norm_max();
    assert!(error < 1e-9, "{error:e}");

    let block = Blocks::new(&layout(), BlockShape::Domain, &[]);
    let parameters: [&[usize]; 3] = [&[0, 1], &[2], &[]];
    let whole = covariance(&block, 3, 5, 7);
    let expected = whole.dense(&block);
    let states = expected.get(..m, ..m).to_owned();
    let explained = product(expected.get(m.., ..m), (inverse(&states) * expected.get(..m, m..)).as_ref());
    let found = divided_and_fused(&whole, &block, parameters);
    let mut forgotten: f64 = 0.0;
    for (i, j) in (0..m + 3).flat_map(|i| (0..m + 3).map(move |j| (i, j))) {
        let is_of_two_filters = i.min(j) >= m && (i < m + 2) != (j < m + 2);
        let value = if is_of_two_filters { explained[(i - m, j - m)] } else { expected[(i, j)] };
        let error = (found[(i, j)] - value).abs() / expected.norm_max();
        assert!(error < 1e-9, "({i}, {j}): {error:e}");
        forgotten = forgotten.max((value - expected[(i, j)]).abs());
    }
    assert!(forgotten > 1e-3, "{forgotten:e}");
}
