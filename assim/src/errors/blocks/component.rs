//! The components into which observations link blocks: their size, and their rows in covariance form.

use super::block_diagonal::BlockDiagonal;
use super::grid_blocks::Blocks;
use super::solution::SplitRows;
use crate::block_angular::{Block, Component, PartitionReport, UpdateRows};
use crate::error::Error;
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use isobar_model::vector::axpy;

/// The rows of a component in covariance form, and its variables; `g` holds its rows for the border.
pub(in crate::errors) fn update_rows(
    (blocks, own): (&Blocks, &BlockDiagonal),
    component: &Component,
    g: MatRef<'_, f64>,
    rows: &SplitRows,
    innovations: &Innovations,
) -> (Vec<usize>, Block) {
    let members = component.blocks.iter().flat_map(|&block| blocks.members(block));
    let mut variables: Vec<usize> = members.copied().collect();
    // Ascending: the state's values first, then the local parameters.
    variables.sort_unstable();
    let locate = |variable: usize| variables.binary_search(&variable).expect("the component holds the variable");
    let (size, n) = (variables.len(), component.observations.len());
    let mut prior = Mat::<f64>::zeros(size, size);
    for &block in &component.blocks {
        let own = own.block(blocks, block);
        let positions: Vec<usize> = blocks.members(block).iter().map(|&variable| locate(variable)).collect();
        for (j, &column) in positions.iter().enumerate() {
            for (i, &row) in positions.iter().enumerate() {
                prior[(row, column)] = own[(i, j)];
            }
        }
    }
    let mut cross = Mat::<f64>::zeros(size, n);
    // What a separator's blocks show is in the factors.
    let entries_of = |row: usize| {
        let entries = rows.block.row(row).iter();
        entries.filter(|entry| component.blocks.binary_search(&blocks.place(entry.0).0).is_ok())
    };
    for (column, &row) in component.observations.iter().enumerate() {
        for &(variable, weight) in entries_of(row) {
            let source = prior.col_as_slice(locate(variable));
            axpy(weight, source, cross.col_as_slice_mut(column));
        }
    }
    let innovation = Mat::from_fn(n, n, |i, j| {
        let row = component.observations[i];
        let covariance: f64 = entries_of(row).map(|&(variable, weight)| weight * cross[(locate(variable), j)]).sum();
        covariance + if i == j { innovations.variance[row] } else { 0.0 }
    });
    let d = component.observations.iter().map(|&row| innovations.departures[row]).collect();
    (variables, Block::Update(UpdateRows { prior, cross, innovation, g: g.to_owned(), d }))
}

/// Variables of a component.
pub(in crate::errors) fn component_size(blocks: &Blocks, component: &Component) -> usize {
    component.blocks.iter().map(|&block| blocks.size(block)).sum()
}

/// Fails if a component does not fit into the memory.
///
/// # Errors
/// [`Error::TooLarge`].
pub(in crate::errors) fn check_component(
    blocks: &Blocks,
    component: &Component,
    limit_bytes: u64,
) -> Result<(), Error> {
    let (size, n) = (component_size(blocks, component) as u64, component.observations.len() as u64);
    let needed_bytes = 8 * (2 * size * size + 3 * size * n + 2 * n * n);
    if needed_bytes > limit_bytes {
        let count = component.blocks.len();
        let what = format!("the component of {count} blocks ({size} variables) that {n} observations link");
        return Err(Error::TooLarge { what, needed_bytes, limit_bytes });
    }
    Ok(())
}

/// Takes from the covariance of a component's ascending variables what is within its blocks.
pub(in crate::errors) fn set_blocks(
    (blocks, own): (&Blocks, &mut BlockDiagonal),
    component: &Component,
    variables: &[usize],
    covariance: MatRef<'_, f64>,
) {
    for &block in &component.blocks {
        let locate = |variable| variables.binary_search(variable).expect("the component holds its blocks");
        let positions: Vec<usize> = blocks.members(block).iter().map(locate).collect();
        let mut own = own.block_mut(blocks, block);
        for (j, &column) in positions.iter().enumerate() {
            positions.iter().enumerate().for_each(|(i, &row)| own[(i, j)] = covariance[(row, column)]);
        }
    }
}

/// The partition into these components if no larger one was cut, with the numbers of factors and of border unknowns.
pub(in crate::errors) fn partition(
    blocks: &Blocks,
    components: &[Component],
    factors: usize,
    border: usize,
) -> PartitionReport {
    let largest = components.iter().max_by_key(|component| component_size(blocks, component));
    let observed: usize = components.iter().map(|component| component.blocks.len()).sum();
    PartitionReport {
        blocks: blocks.count(),
        components: components.iter().filter(|component| !component.blocks.is_empty()).count(),
        merged_components: components.iter().filter(|component| component.blocks.len() > 1).count(),
        largest_component_blocks: largest.map_or(0, |component| component.blocks.len()),
        largest_component_variables: largest.map_or(0, |component| component_size(blocks, component)),
        unobserved_blocks: blocks.count() - observed,
        fewest_factors: factors,
        most_factors: factors,
        border,
        ..PartitionReport::default()
    }
}
