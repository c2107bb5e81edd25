//! The blocks b_{t,k} of the state: cells, tiles or the whole domain, with the biases of the stations that stand there.

use isobar_model::{Bands, Grid, Layout};
use isobar_obs::SparseRows;
use std::ops::Range;

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

impl BlockShape {
    /// Columns and rows of cells in a block that is not cut off by the edge.
    pub fn cells(self, grid: &Grid) -> (usize, usize) {
        match self {
            BlockShape::Cell => (1, 1),
            BlockShape::Tile { nx, ny } => (nx.clamp(1, grid.nx), ny.clamp(1, grid.ny)),
            BlockShape::Domain => (grid.nx, grid.ny),
        }
    }
}

/// The partition of all block variables b: the state's values, then the local calibration parameters.
///
/// There may be millions of blocks of three variables: all lists are flat.
#[derive(Clone, Debug)]
pub(in crate::errors) struct Blocks {
    /// Where each block's variables begin in `members`, and where the last ones end.
    starts: Vec<usize>,
    /// The variables of each block, ascending.
    members: Vec<usize>,
    /// Where each block's square matrix begins if the matrices lie one after another, and where the last one ends.
    matrix_starts: Vec<usize>,
    /// Block of each variable, and position in it.
    place: Vec<(u32, u32)>,
}

impl Blocks {
    /// The blocks of a layout; `local_cells` are the cells in which the local parameters' stations stand.
    pub fn new(layout: &Layout, shape: BlockShape, local_cells: &[usize]) -> Self {
        let grid = &layout.grid;
        let (tile_nx, tile_ny) = shape.cells(grid);
        let (columns, rows) = (grid.nx.div_ceil(tile_nx), grid.ny.div_ceil(tile_ny));
        let cell_of = |variable: usize| {
            if variable < layout.len() { variable % grid.cells() } else { local_cells[variable - layout.len()] }
        };
        let block_of = |variable: usize| {
            let cell = cell_of(variable);
            (cell / grid.nx / tile_ny) * columns + cell % grid.nx / tile_nx
        };
        let (count, variables) = (columns * rows, layout.len() + local_cells.len());
        let mut sizes = vec![0_usize; count];
        (0..variables).for_each(|variable| sizes[block_of(variable)] += 1);
        let (mut starts, mut matrix_starts) = (vec![0; count + 1], vec![0; count + 1]);
        for (block, &size) in sizes.iter().enumerate() {
            starts[block + 1] = starts[block] + size;
            matrix_starts[block + 1] = matrix_starts[block] + size * size;
        }
        let mut members = vec![0; variables];
        let mut filled = vec![0_usize; count];
        let place = (0..variables)
            .map(|variable| {
                let block = block_of(variable);
                let position = filled[block];
                members[starts[block] + position] = variable;
                filled[block] += 1;
                (block as u32, position as u32)
            })
            .collect();
        Self { starts, members, matrix_starts, place }
    }

    /// Number of blocks.
    pub fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Which cells a block is, in words: `block 7 (row 1, column 3)`, counted from 0.
    pub fn describe(&self, block: usize, layout: &Layout) -> String {
        let grid = &layout.grid;
        let cells = || self.members(block).iter().filter(|&&it| it < layout.len()).map(|it| it % grid.cells());
        let (Some(first), Some(last)) = (cells().min(), cells().max()) else { return format!("block {block}") };
        let (row, column) = (first / grid.nx, first % grid.nx);
        let (last_row, last_column) = (last / grid.nx, last % grid.nx);
        if first == last {
            format!("block {block} (row {row}, column {column})")
        } else {
            format!("block {block} (rows {row} to {last_row}, columns {column} to {last_column})")
        }
    }

    /// Number of block variables.
    pub fn variables(&self) -> usize {
        self.place.len()
    }

    /// The variables of a block, ascending.
    pub fn members(&self, block: usize) -> &[usize] {
        &self.members[self.starts[block]..self.starts[block + 1]]
    }

    /// Number of variables of a block.
    pub fn size(&self, block: usize) -> usize {
        self.starts[block + 1] - self.starts[block]
    }

    /// The blocks of some rows of the bands' grid, which must cut none.
    pub fn in_rows(&self, bands: &Bands, rows: &Range<usize>) -> Range<usize> {
        let first = |row: usize| {
            let cell = row * bands.grid().nx;
            if cell < bands.grid().cells() { self.place(cell).0 } else { self.count() }
        };
        first(rows.start)..first(rows.end)
    }

    /// The blocks that each row touches, an entry for each of its variables.
    pub fn touched(&self, rows: &SparseRows) -> Vec<Vec<usize>> {
        let block_of = |&(variable, _): &(usize, f64)| self.place(variable).0;
        (0..rows.rows()).map(|row| rows.row(row).iter().map(block_of).collect()).collect()
    }

    /// Block of a variable, and position in it.
    pub fn place(&self, variable: usize) -> (usize, usize) {
        let (block, position) = self.place[variable];
        (block as usize, position as usize)
    }

    /// Where a variable is in the list of all blocks' variables one after another.
    pub fn position(&self, variable: usize) -> usize {
        let (block, position) = self.place(variable);
        self.starts[block] + position
    }

    /// Where a block's matrix lies if those of all blocks lie one after another, column-major.
    pub fn matrix(&self, block: usize) -> Range<usize> {
        self.matrix_starts[block]..self.matrix_starts[block + 1]
    }

    /// Where the matrices of some blocks lie, which follow each other.
    pub fn matrices_of(&self, blocks: &Range<usize>) -> Range<usize> {
        self.matrix_starts[blocks.start]..self.matrix_starts[blocks.end]
    }

    /// Values in the matrices of all blocks.
    pub fn matrices_len(&self) -> usize {
        self.matrix_starts[self.count()]
    }
}
