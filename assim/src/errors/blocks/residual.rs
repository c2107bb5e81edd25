//! Forecast of the residual blocks without the propagator: they persist, as far as random probes say.

use super::block_diagonal::BlockDiagonal;
use super::grid_blocks::Blocks;
use crate::error::Error;
use crate::linalg::semidefinite_root;
use crate::tall_matrix::TallMatrix;
use isobar_model::Layout;
use isobar_model::random::standard_normals;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::ops::Range;

/// Advances columns, and with them the blocks: C_k ← ρ_i ρ_j C_k, where ρ is what probes keep of their size.
/// `advance` finds them behind the columns. Without probes the blocks persist.
///
/// # Errors
/// Those of `advance`; the blocks are then as they were.
pub(in crate::errors) fn forecast(
    (covariance, columns): (&mut BlockDiagonal, &mut TallMatrix),
    (blocks, layout): (&Blocks, &Layout),
    probes: usize,
    random: &mut ChaCha8Rng,
    advance: impl FnOnce(&mut TallMatrix) -> Result<(), Error>,
) -> Result<(), Error> {
    let first = columns.columns();
    columns.append(probes);
    draw_probes(covariance, blocks, columns, first, random);
    let before = energy(layout, columns, first);
    let outcome = advance(columns);
    let after = energy(layout, columns, first);
    columns.truncate(first);
    outcome?;
    if probes > 0 {
        scale(covariance, blocks, layout, &persistence(&before, &after));
    }
    Ok(())
}

/// Draws of the state's part of N(0, blkdiag(C_k)), one in each column from the first probe on.
fn draw_probes(
    covariance: &BlockDiagonal,
    blocks: &Blocks,
    columns: &mut TallMatrix,
    first_probe: usize,
    random: &mut ChaCha8Rng,
) {
    if first_probe == columns.columns() {
        return;
    }
    let mut roots = covariance.clone();
    roots.for_each_block(blocks, |_, mut matrix| {
        let root = semidefinite_root(matrix.as_ref());
        matrix.copy_from(root);
    });
    for number in first_probe..columns.columns() {
        let normals = standard_normals(random, blocks.variables());
        let draw = |variable: usize| -> f64 {
            let (block, row) = blocks.place(variable);
            let (root, first) = (roots.block(blocks, block), blocks.position(variable) - row);
            (0..=row).map(|j| root[(row, j)] * normals[first + j]).sum()
        };
        let own: Vec<f64> = columns.own_ranges().into_par_iter().flat_map(Range::into_par_iter).map(draw).collect();
        columns.edit_own_column(number, |column| column.copy_from_slice(&own));
    }
}

/// Sum of the squares of each variable over all probes.
fn energy(layout: &Layout, columns: &TallMatrix, first_probe: usize) -> Vec<f64> {
    let mut sums = vec![0.0; layout.variables.len()];
    let cells = columns.own_rows() / sums.len();
    for number in first_probe..columns.columns() {
        for (sum, field) in sums.iter_mut().zip(columns.own_column(number).chunks_exact(cells)) {
            field.iter().for_each(|value| *sum += value * value);
        }
    }
    if let Some(bands) = columns.bands() {
        bands.communicator().sum(&mut sums);
    }
    sums
}

/// How much of its standard deviation each variable of the state keeps: ρ_v² = Σ (probes out)_v² / Σ (probes in)_v².
fn persistence(before: &[f64], after: &[f64]) -> Vec<f64> {
    let ratio = |(after, before): (&f64, &f64)| if *before > 0.0 { (after / before).sqrt() } else { 1.0 };
    after.iter().zip(before).map(ratio).collect()
}

/// C_k ← ρ_i ρ_j C_k; local parameters persist.
fn scale(covariance: &mut BlockDiagonal, blocks: &Blocks, layout: &Layout, persistence: &[f64]) {
    let (m, cells) = (layout.len(), layout.grid.cells());
    let factor = |variable: usize| if variable < m { persistence[variable / cells] } else { 1.0 };
    covariance.for_each_block(blocks, |block, mut matrix| {
        let members = blocks.members(block);
        for (j, &column) in members.iter().enumerate() {
            for (i, &row) in members.iter().enumerate() {
                matrix[(i, j)] *= factor(row) * factor(column);
            }
        }
    });
}
