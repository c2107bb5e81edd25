//! Report on how observations link blocks.

/// Number and size of the components into which observations merge the blocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartitionReport {
    /// Blocks before merging.
    pub blocks: usize,
    /// Components that hold more than one block.
    pub merged_components: usize,
    /// Blocks of the component with the most variables.
    pub largest_component_blocks: usize,
    /// Variables of that component.
    pub largest_component_variables: usize,
    /// Blocks that no observation touches.
    pub unobserved_blocks: usize,
    /// Shared unknowns that border all blocks.
    pub border: usize,
}
