//! The separators of a component that is too large to be merged, and the observed parts of their covariances.

use super::block_diagonal::BlockDiagonal;
use super::component::component_size;
use super::grid_blocks::Blocks;
use super::solution::SplitRows;
use crate::block_angular::{self, Component, Dissection, Graph, PartitionReport};
use faer::{Mat, MatRef};

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

/// The covariance of a block, split into the part that observations see and the rest.
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

/// Takes the observed part L Lᵀ out of the covariance of a block: the columns of L, each with the variables and their values.
pub(in crate::errors) fn take_observed_part(
    own: &mut BlockDiagonal,
    blocks: &Blocks,
    block: usize,
    seen: &[bool],
) -> Vec<Vec<(usize, f64)>> {
    let mut own = own.block_mut(blocks, block);
    let Seen { root, rest } = Seen::new(own.as_ref(), &seen_positions(blocks, block, seen));
    own.copy_from(rest);
    let members = blocks.members(block);
    let column = |j: usize| members.iter().enumerate().map(|(i, &member)| (member, root[(i, j)])).collect();
    (0..root.ncols()).map(column).collect()
}

/// Positions in a block of its variables that observations see.
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
