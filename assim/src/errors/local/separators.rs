//! Cells that are cut out of a component that observations link across the domain.
//!
//! Observations that see a common cell belong to one component, and chains of them can link cells across the whole domain. The factors of
//! every tile that such a component touches have rows for all of it, so that time and memory would grow faster than the area. Where
//! it has more than `largest_component` variables, some cells are cut out: what the observations see of the errors of such a cell
//! becomes further factors of its tile for this analysis, C = L Lᵀ + C_rest as for [factors of the whole domain](crate::errors::blocks).
//! The analysis stays exact. After it these columns leave the factors, and the block diagonal of their squares goes back into the
//! blocks: each block keeps its covariance, and what it has in common with others through these columns is dropped, as it is within a
//! component.

use super::local_factors::{LocalFactors, add_to_blocks};
use super::{Frame, LocalErrors};
use crate::block_angular::{self, Component};
use crate::errors::blocks::{Separation, SplitRows, component_size, seen_variables, take_observed_part};
use std::sync::Arc;

impl LocalErrors {
    /// The components of an analysis, with the cells cut out of too large ones moved into the factors.
    ///
    /// With a smoother no cell is cut out: earlier analyses have no part in those factors.
    pub(super) fn separated(&mut self, rows: &SplitRows) -> (Vec<Component>, Separation) {
        let frame = Arc::clone(&self.frame);
        let Frame { blocks, settings, tiles, cells, .. } = &*frame;
        let touched = blocks.touched(&rows.block);
        let components = block_angular::components(blocks.count(), &touched);
        let largest = settings.largest_component;
        let fit = components.iter().all(|component| component_size(blocks, component) <= largest);
        if fit || self.memory.past.is_some() {
            return (components, Separation::default());
        }
        let seen = seen_variables(rows, blocks.variables());
        let separation = Separation::new(blocks, largest, &components, &touched, &seen);
        let mut of_tile = vec![Vec::new(); tiles.count()];
        for &block in &separation.blocks {
            let tile = tiles.tile_of(cells[blocks.members(block)[0]]);
            of_tile[tile].extend(take_observed_part(&mut self.memory.own, blocks, block, &seen));
        }
        for (factors, columns) in self.memory.factors.iter_mut().zip(of_tile).filter(|(_, columns)| !columns.is_empty())
        {
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
