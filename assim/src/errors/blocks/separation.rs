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

use super::component::{check_component, component_size, partition};
use super::grid_blocks::Blocks;
use super::solution::{BlockAnalysis, Solved, SplitRows};
use super::{BlockErrors, Frame};
use crate::block_angular::{self, Component, Dissection, Graph, PartitionReport};
use crate::error::Error;
use crate::problem::Innovations;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// The blocks that leave too large components for the border.
#[derive(Clone, Debug, Default)]
pub(in crate::errors) struct Separation {
    /// Numbers of the blocks, ascending.
    pub blocks: Vec<usize>,
    /// Number of separators.
    pub separators: usize,
    /// Variables of these blocks that observations touch: as many factors join.
    pub unknowns: usize,
}

/// A block's covariance by what is seen of it.
pub(in crate::errors) struct Seen {
    /// L, `[variables, touched]`; its column j is zero above touched variable j.
    pub root: Mat<f64>,
    /// C − L L', without variance in the touched variables.
    pub rest: Mat<f64>,
}

impl Seen {
    /// Splits C, `[variables, variables]`, by an elimination of the variables at the `touched` positions.
    pub fn new(covariance: MatRef<'_, f64>, touched: &[usize]) -> Self {
        let size = covariance.nrows();
        let (mut root, mut rest) = (Mat::zeros(size, touched.len()), covariance.to_owned());
        let threshold = (0..size).map(|i| covariance[(i, i)]).fold(0.0, f64::max) * f64::EPSILON * size as f64;
        for (column, &pivot) in touched.iter().enumerate() {
            let variance = rest[(pivot, pivot)];
            if variance > threshold {
                for i in 0..size {
                    // A C that is next to nothing holds rounding errors: what they say must not exceed the variance.
                    let most = rest[(i, i)].max(0.0).sqrt();
                    root[(i, column)] = (rest[(i, pivot)] / variance.sqrt()).clamp(-most, most);
                }
                for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
                    rest[(i, j)] -= root[(i, column)] * root[(j, column)];
                }
            }
            for i in 0..size {
                (rest[(i, pivot)], rest[(pivot, i)]) = (0.0, 0.0);
            }
        }
        (0..size).for_each(|i| rest[(i, i)] = rest[(i, i)].max(0.0));
        Self { root, rest }
    }
}

impl Separation {
    /// Cuts the components that have more variables than `largest`, given the blocks that each row touches and which variables
    /// the rows see.
    pub fn new(
        blocks: &Blocks,
        largest: usize,
        components: &[Component],
        touched: &[Vec<usize>],
        seen: &[bool],
    ) -> Self {
        let mut separation = Self::default();
        for component in components.iter().filter(|it| component_size(blocks, it) > largest) {
            let number = |block: &usize| component.blocks.binary_search(block).expect("the component holds the block");
            let rows: Vec<Vec<usize>> =
                component.observations.iter().map(|&row| touched[row].iter().map(number).collect()).collect();
            let weights = component.blocks.iter().map(|&block| blocks.size(block)).collect();
            let graph = Graph::of_rows(weights, rows.iter().map(Vec::as_slice));
            let tree = Dissection::new(&graph, largest);
            separation.separators += tree.members.iter().filter(|member| member.separator).count();
            separation.blocks.extend(tree.border().into_iter().map(|number| component.blocks[number]));
        }
        separation.blocks.sort_unstable();
        separation.unknowns = separation.blocks.iter().map(|&block| seen_positions(blocks, block, seen).len()).sum();
        separation
    }

    /// The components that are left, given the blocks that each row touches.
    pub fn components(&self, blocks: &Blocks, mut touched: Vec<Vec<usize>>) -> Vec<Component> {
        touched.iter_mut().for_each(|row| row.retain(|block| self.blocks.binary_search(block).is_err()));
        block_angular::components(blocks.count(), &touched)
    }

    /// The partition that is left: what it was like without the separators, and with them.
    pub fn report(&self, whole: PartitionReport) -> PartitionReport {
        PartitionReport {
            unobserved_blocks: whole.unobserved_blocks - self.blocks.len(),
            separators: self.separators,
            separator_unknowns: self.unknowns,
            ..whole
        }
    }
}

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
        let Frame { blocks, settings, .. } = &*frame;
        let touched = blocks.touched(&rows.block);
        let components = block_angular::components(blocks.count(), &touched);
        if components.iter().all(|component| self.component_size(component) <= settings.largest_component) {
            let partition = self.report(&components, &Separation::default());
            return Ok(self.update_components(&components, rows, innovations, free)?.with(partition));
        }
        let seen = seen_variables(rows, blocks.variables());
        let separation = Separation::new(blocks, settings.largest_component, &components, &touched, &seen);
        if separation.unknowns > settings.separator_factors || !self.fits(separation.unknowns) {
            let mut partition = self.report(&components, &Separation::default());
            let (solved, sizes) = self.update_nested(&components, rows, innovations, &seen, free)?;
            (partition.nested, partition.separators) = (true, sizes.separators);
            partition.separator_unknowns = sizes.separator_unknowns;
            return Ok(solved.with(partition));
        }
        self.join_separators(&separation, &seen);
        let components = separation.components(blocks, touched);
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

    /// Positions in a block of its variables that observations see.
    pub(super) fn seen_positions(&self, block: usize, seen: &[bool]) -> Vec<usize> {
        seen_positions(&self.frame.blocks, block, seen)
    }

    /// The partition of an analysis.
    fn report(&self, components: &[Component], separation: &Separation) -> PartitionReport {
        let border = self.memory.covariance.factors.columns();
        separation.report(partition(&self.frame.blocks, components, border - separation.unknowns, border))
    }

    /// Moves what is seen of some blocks into the common factors.
    pub(super) fn join_separators(&mut self, separation: &Separation, seen: &[bool]) {
        let mut column = self.memory.covariance.factors.columns();
        self.memory.covariance.factors.append(separation.unknowns);
        for &block in &separation.blocks {
            let positions = self.seen_positions(block, seen);
            let mut own = self.memory.covariance.own.block_mut(&self.frame.blocks, block);
            let Seen { root, rest } = Seen::new(own.as_ref(), &positions);
            own.copy_from(rest);
            for j in 0..positions.len() {
                for (position, &variable) in self.frame.blocks.members(block).iter().enumerate() {
                    self.memory.covariance.factors.set(variable, column, root[(position, j)]);
                }
                column += 1;
            }
        }
    }
}

/// Positions in a block of its variables that are seen.
pub(in crate::errors) fn seen_positions(blocks: &Blocks, block: usize, seen: &[bool]) -> Vec<usize> {
    let members = blocks.members(block);
    (0..members.len()).filter(|&position| seen[members[position]]).collect()
}

/// The variables that the rows touch.
pub(in crate::errors) fn seen_variables(rows: &SplitRows, variables: usize) -> Vec<bool> {
    let mut seen = vec![false; variables];
    for row in 0..rows.block.rows() {
        rows.block.row(row).iter().for_each(|entry| seen[entry.0] = true);
    }
    seen
}
