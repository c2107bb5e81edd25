//! The blocks b_{t,k} of the state: cells, tiles or the whole domain, with the biases of the stations that stand there.

use isobar_model::Layout;

/// Which grid points form a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockShape {
    /// The variables of one cell.
    Cell,
    /// The variables of a tile of cells; tiles at the northern and eastern edge are smaller if it does not divide the
    /// grid.
    Tile {
        /// Columns of cells.
        nx: usize,
        /// Rows of cells.
        ny: usize,
    },
    /// One block for everything: the full Kalman filter.
    Domain,
}

/// The partition of all block variables b: the state's values, then the local calibration parameters.
#[derive(Clone, Debug)]
pub(super) struct Blocks {
    /// The variables of each block, ascending.
    pub members: Vec<Vec<usize>>,
    /// Block of each variable, and position in it.
    pub place: Vec<(usize, usize)>,
}

impl Blocks {
    /// The blocks of a layout; `local_cells` are the cells in which the local parameters' stations stand.
    pub fn new(layout: &Layout, shape: BlockShape, local_cells: &[usize]) -> Self {
        let grid = &layout.grid;
        let (tile_nx, tile_ny) = match shape {
            BlockShape::Cell => (1, 1),
            BlockShape::Tile { nx, ny } => (nx.clamp(1, grid.nx), ny.clamp(1, grid.ny)),
            BlockShape::Domain => (grid.nx, grid.ny),
        };
        let (columns, rows) = (grid.nx.div_ceil(tile_nx), grid.ny.div_ceil(tile_ny));
        let block_of_cell = |cell: usize| (cell / grid.nx / tile_ny) * columns + cell % grid.nx / tile_nx;
        let mut members = vec![Vec::new(); columns * rows];
        for variable in 0..layout.len() {
            members[block_of_cell(variable % grid.cells())].push(variable);
        }
        for (number, &cell) in local_cells.iter().enumerate() {
            members[block_of_cell(cell)].push(layout.len() + number);
        }
        let mut place = vec![(0, 0); layout.len() + local_cells.len()];
        for (block, own) in members.iter().enumerate() {
            for (position, &variable) in own.iter().enumerate() {
                place[variable] = (block, position);
            }
        }
        Self { members, place }
    }

    /// Number of block variables.
    pub fn variables(&self) -> usize {
        self.place.len()
    }
}
