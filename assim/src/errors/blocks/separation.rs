//! What is done with blocks that observations link into a component too large to be merged.
//!
//! A separator of the blocks is moved into the border: what the observations see of its blocks becomes common factors,
//! which are estimated with the others, and the component falls apart. For touched variables t of a block it is
//!
//! ```text
//! C = L L' + C_rest,     L = C_{.,t} (C_tt)^{-1/2},     C_rest without variance in t,
//! ```
//!
//! so that L joins Φ in the rows of the block. The analysis stays exact, as does the covariance after it, between blocks
//! too: it has the form blkdiag + Φ Φᵀ again.

use super::component::{check_component, partition};
use super::separators::{Separation, seen_variables, take_observed_part};
use super::solution::{BlockAnalysis, Solved, SplitRows};
use super::{BlockErrors, Frame};
use crate::block_angular::{self, Component, PartitionReport};
use crate::error::Error;
use crate::problem::Innovations;
use std::sync::Arc;

impl BlockErrors {
    /// Merges the blocks that observations link, separates or nests components that are too large for it, and analyses.
    /// The first `free` columns of Φ are no factors but sensitivities to unknowns without a prior.
    pub(crate) fn analyse_rows(
        &mut self,
        rows: &SplitRows,
        innovations: &Innovations,
        free: usize,
    ) -> Result<BlockAnalysis, Error> {
        let frame = Arc::clone(&self.frame);
        let blocks = &frame.blocks;
        let touched = blocks.touched(&rows.block);
        let mut wanted = touched.concat();
        wanted.sort_unstable();
        wanted.dedup();
        self.memory.covariance.own.lend(blocks, &wanted, &frame.bands);
        let analysis = self.analyse_touched(&touched, rows, innovations, free);
        self.memory.covariance.own.give_back();
        analysis
    }

    /// [`BlockErrors::analyse_rows`] where all blocks are there that each row touches.
    fn analyse_touched(
        &mut self,
        touched: &[Vec<usize>],
        rows: &SplitRows,
        innovations: &Innovations,
        free: usize,
    ) -> Result<BlockAnalysis, Error> {
        let frame = Arc::clone(&self.frame);
        let Frame { blocks, settings, .. } = &*frame;
        let components = block_angular::components(blocks.count(), touched);
        if components.iter().all(|component| self.component_size(component) <= settings.largest_component) {
            let partition = self.report(&components, &Separation::default());
            return Ok(self.update_components(&components, rows, innovations, free)?.with(partition));
        }
        let seen = seen_variables(rows, blocks.variables());
        let separation = Separation::new(blocks, settings.largest_component, &components, touched, &seen);
        if separation.unknowns > settings.separator_factors || !self.fits(separation.unknowns) {
            let mut partition = self.report(&components, &Separation::default());
            let (solved, sizes) = self.update_nested(&components, rows, innovations, &seen, free)?;
            (partition.nested, partition.separators) = (true, sizes.separators);
            partition.separator_unknowns = sizes.separator_unknowns;
            return Ok(solved.with(partition));
        }
        self.join_separators(&separation, &seen);
        let components = separation.components(blocks, touched.to_vec());
        let partition = self.report(&components, &separation);
        Ok(self.update_components(&components, rows, innovations, free)?.with(partition))
    }

    /// Whether there is memory for `more_factors`, beside the blocks, those of Q, and the factors of both.
    fn fits(&self, more_factors: usize) -> bool {
        let Frame { blocks, settings, memory_limit_bytes, .. } = &*self.frame;
        let (b, r) = (blocks.variables() as u64, self.factors().columns() as u64);
        let factor_bytes = settings.factor_precision.bytes();
        let needed_bytes = 8 * 3 * blocks.matrices_len() as u64 + factor_bytes * b * (2 * r + more_factors as u64);
        needed_bytes <= *memory_limit_bytes
    }

    fn update_components(
        &mut self,
        components: &[Component],
        rows: &SplitRows,
        innovations: &Innovations,
        free: usize,
    ) -> Result<Solved, Error> {
        for component in components {
            check_component(&self.frame.blocks, component, self.frame.memory_limit_bytes)?;
        }
        self.update(components, rows, innovations, free)
    }

    /// The partition of an analysis.
    fn report(&self, components: &[Component], separation: &Separation) -> PartitionReport {
        let border = self.memory.covariance.factors.columns();
        separation.report(partition(&self.frame.blocks, components, border - separation.unknowns, border))
    }

    /// Moves what is seen of some blocks into the common factors.
    pub(super) fn join_separators(&mut self, separation: &Separation, seen: &[bool]) {
        let covariance = &mut self.memory.covariance;
        let first = covariance.factors.columns();
        covariance.factors.append(separation.unknowns);
        let mut columns = Vec::with_capacity(separation.unknowns);
        for &block in &separation.blocks {
            columns.extend(take_observed_part(&mut covariance.own, &self.frame.blocks, block, seen));
        }
        for (j, entries) in columns.into_iter().enumerate() {
            entries.into_iter().for_each(|(variable, value)| covariance.factors.set(variable, first + j, value));
        }
    }
}
