//! The automatic partition: blocks that an observation links are merged (connected components).

use serde::{Deserialize, Serialize};

/// Blocks that observations link with each other, directly or through others, and those observations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Component {
    /// Numbers of the blocks, ascending.
    pub blocks: Vec<usize>,
    /// Numbers of the observations, ascending.
    pub observations: Vec<usize>,
}

/// Number and size of the components into which observations merge the blocks: those of one analysis or, by
/// [`PartitionReport::worse`], of several.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PartitionReport {
    /// Blocks before merging.
    pub blocks: usize,
    /// Components of blocks with observations, without the separators.
    pub components: usize,
    /// Components that hold more than one block.
    pub merged_components: usize,
    /// Blocks of the component with the most variables.
    pub largest_component_blocks: usize,
    /// Variables of that component.
    pub largest_component_variables: usize,
    /// Blocks that no observation touches.
    pub unobserved_blocks: usize,
    /// The fewest common factors before an analysis, with those that carry shared parameters, without those of
    /// separators.
    pub fewest_factors: usize,
    /// The most.
    pub most_factors: usize,
    /// Separators that cut components too large to be merged.
    pub separators: usize,
    /// Unknowns of all separators together.
    pub separator_unknowns: usize,
    /// Whether the separators were too many for the border, so that each borders the parts below it alone.
    pub nested: bool,
    /// Unknowns that border all blocks; those of the separators are among them if they joined it.
    pub border: usize,
}

impl PartitionReport {
    /// The one with more to cut or, if there is nothing, the larger component; the numbers of factors are those of both.
    pub fn worse(self, other: Self) -> Self {
        let fewest_factors = self.fewest_factors.min(other.fewest_factors);
        let most_factors = self.most_factors.max(other.most_factors);
        let size = |it: &Self| (it.separator_unknowns, it.largest_component_variables);
        let worse = if size(&self) >= size(&other) { self } else { other };
        Self { fewest_factors, most_factors, ..worse }
    }
}

/// The connected components of the graph that has the `blocks` as nodes and links those that one observation touches.
///
/// `touched[i]` are the blocks of observation i (in any order, repetitions allowed). Blocks without observations are in
/// no component; an observation that touches no block is a component of its own, without blocks. Components are in the
/// order of their first observation.
pub fn components(blocks: usize, touched: &[Vec<usize>]) -> Vec<Component> {
    let mut parent: Vec<usize> = (0..blocks).collect();
    for own in touched {
        for pair in own.windows(2) {
            let (a, b) = (root(&mut parent, pair[0]), root(&mut parent, pair[1]));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut number: Vec<Option<usize>> = vec![None; blocks];
    let mut result: Vec<Component> = Vec::new();
    for (observation, own) in touched.iter().enumerate() {
        let known = own.first().and_then(|&block| number[root(&mut parent, block)]);
        let component = known.unwrap_or_else(|| {
            result.push(Component { blocks: Vec::new(), observations: Vec::new() });
            result.len() - 1
        });
        if let Some(&block) = own.first() {
            number[root(&mut parent, block)] = Some(component);
        }
        result[component].observations.push(observation);
    }
    for block in 0..blocks {
        if let Some(component) = number[root(&mut parent, block)] {
            result[component].blocks.push(block);
        }
    }
    result
}

/// The representative of a block's tree, with path halving.
fn root(parent: &mut [usize], mut block: usize) -> usize {
    while parent[block] != block {
        parent[block] = parent[parent[block]];
        block = parent[block];
    }
    block
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observations_merge_the_blocks_they_link_directly_or_through_others() {
        let touched = vec![vec![5], vec![1, 2], vec![], vec![2, 3, 2], vec![5, 5], vec![3]];
        let found = components(7, &touched);
        let expected = [(vec![5], vec![0, 4]), (vec![1, 2, 3], vec![1, 3, 5]), (vec![], vec![2])];
        assert_eq!(found.len(), expected.len());
        for (found, (blocks, observations)) in found.iter().zip(expected) {
            assert_eq!((&found.blocks, &found.observations), (&blocks, &observations));
        }
    }
}
