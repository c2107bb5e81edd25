//! Cells that leave a component of observed cells, so that it falls apart.
//!
//! Observations that see a common cell belong to one component, and chains of them can link cells across the whole domain. The factors of
//! every tile that such a component touches have rows for all of it, so that time and memory would grow faster than the area. Where
//! it has more than `largest_component` variables, some cells are cut out: what the observations see of the errors of such a cell
//! becomes further factors of its tile for this analysis, C = L Lᵀ + C_rest as for [factors of the whole domain](crate::errors::blocks).
//! The analysis stays exact. After it these columns leave the factors, and the block diagonal of their squares goes back into the
//! blocks: each block keeps its covariance, and what it has in common with others through these columns is dropped, as it is within a
//! component.

use super::local_factors::{LocalFactors, add_to_blocks, union};
use super::{Frame, LocalErrors};
use crate::block_angular::{self, Component};
use crate::errors::blocks::{Seen, Separation, SplitRows, seen_positions, seen_variables};
use std::sync::Arc;

impl LocalErrors {
    /// The components of an analysis, with the cells cut out of too large ones moved into the factors.
    ///
    /// None is cut where there is a smoother: earlier analyses have no part in those factors.
    pub(super) fn separated(&mut self, rows: &SplitRows) -> (Vec<Component>, Separation) {
        let frame = Arc::clone(&self.frame);
        let Frame { blocks, settings, tiles, cells, .. } = &*frame;
        let touched = blocks.touched(&rows.block);
        let components = block_angular::components(blocks.count(), &touched);
        if self.memory.past.is_some() {
            return (components, Separation::default());
        }
        let seen = seen_variables(rows, blocks.variables());
        let separation = Separation::new(blocks, settings.largest_component, &components, &touched, &seen);
        if separation.blocks.is_empty() {
            return (components, separation);
        }
        let mut of_tile = vec![Vec::new(); tiles.count()];
        for &block in &separation.blocks {
            of_tile[tiles.tile_of(cells[blocks.members(block)[0]])].push(block);
        }
        for (tile, separated) in of_tile.iter().enumerate().filter(|(_, separated)| !separated.is_empty()) {
            let mut columns: Vec<Vec<(usize, f64)>> = Vec::new();
            for &block in separated {
                let positions = seen_positions(blocks, block, &seen);
                let mut own = self.memory.own.block_mut(blocks, block);
                let Seen { root, rest } = Seen::new(own.as_ref(), &positions);
                own.copy_from(rest);
                let members = blocks.members(block);
                let column = |j: usize| (0..members.len()).map(|i| (members[i], root[(i, j)])).collect();
                columns.extend((0..positions.len()).map(column));
            }
            let factors = &mut self.memory.factors[tile];
            let mut members: Vec<usize> = columns.iter().flatten().map(|entry| entry.0).collect();
            members.sort_unstable();
            *factors = factors.extended(&union([factors.variables.as_slice(), &members]), factors.precision());
            *factors = factors.with_columns(&columns);
        }
        (separation.components(blocks, touched), separation)
    }

    /// Takes the columns after the first `kept` of each tile out of the factors.
    pub(super) fn drop_separators(&mut self, kept: &[usize]) {
        let frame = Arc::clone(&self.frame);
        let factors = self.memory.factors.iter_mut().zip(kept);
        let dropped: Vec<LocalFactors> = factors
            .filter(|(factors, kept)| factors.columns() > **kept)
            .map(|(factors, &kept)| {
                let (first, rest) = factors.split(kept);
                *factors = first;
                rest
            })
            .collect();
        add_to_blocks(&mut self.memory.own, &frame.blocks, 1.0, &dropped);
    }
}
