//! Time steps as one pass over memory: a sweep over the rows of the grid with what it needs of the rows around in cache.
//!
//! A [`RowStream`] evaluates a tendency row by row. All stages of a Runge–Kutta step follow each other at a distance of
//! one row (two, if its stencil reaches two), so that a step reads and writes each value of the state once, in place.
//! Bands of rows are swept in parallel, each from copies of the rows around it; as every row is the same function of the
//! same rows whatever the bands, the bits are the same on any number of threads. With a reach of one row:
//!
//! ```text
//! row  j + 4   x read                       stage 1 has its slope up to row j + 3
//!      j + 3   stage 2 state
//!      j + 2   stage 3 state
//!      j + 1   stage 4 state
//!      j       all slopes known: x written
//! ```

use crate::grid::{Boundary, Grid};

/// How many variables a tendency with a form by rows may have.
pub const MOST_VARIABLES: usize = 4;

/// One row of each variable.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row<'a>([&'a [f64]; MOST_VARIABLES]);

impl<'a> Row<'a> {
    /// A row of `nx` places stored as `[variable, x]`.
    ///
    /// # Panics
    /// If it has more than [`MOST_VARIABLES`] variables.
    pub fn of(mut values: &'a [f64], nx: usize) -> Self {
        let mut row = Self::default();
        let mut variable = 0;
        while values.len() >= nx {
            (row.0[variable], values) = values.split_at(nx);
            variable += 1;
        }
        row
    }

    /// Some of its places.
    pub(crate) fn part(mut self, places: std::ops::Range<usize>) -> Self {
        for row in self.0.iter_mut().filter(|row| !row.is_empty()) {
            *row = &row[places.clone()];
        }
        self
    }

    /// The rows of the first variables.
    #[inline(always)]
    pub fn variables<const N: usize>(&self) -> [&'a [f64]; N] {
        let mut rows = [&[][..]; N];
        rows.copy_from_slice(&self.0[..N]);
        rows
    }

    /// The row of one variable.
    #[inline(always)]
    pub fn variable(&self, variable: usize) -> &'a [f64] {
        self.0[variable]
    }
}

/// A tendency evaluated row by row from the south, for stencils that reach one or two rows and columns. Rows are periodic.
pub trait RowStream: Send {
    /// How many rows and columns the stencil reaches.
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with its first row.
    fn begin(&mut self, first: Row<'_>);

    /// The row beyond a wall, `[variable, x]`, given the row beside it.
    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]);

    /// Takes row `row` of the grid (that beyond the northern wall being row `ny`), and says the tendency,
    /// `[variable, x]`, of the row as far south of it as the stencil reaches, of which it was told before; the first
    /// tendencies of a sweep, for which rows in the south are missing, are not to be used. `south` is the row south of it.
    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]);

    /// With a reach of two rows: the tendency of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, _tendency: &mut [f64]) {}
}

/// Below this number of cells one thread is faster than the start of two.
const LEAST_CELLS_PER_BAND: usize = 1 << 15;

/// Some rows of the fields to be swept, and copies of the rows around them.
pub(crate) struct Band<'a> {
    /// Number of the first row.
    pub first: usize,
    /// Number of rows.
    pub rows: usize,
    /// The band of each variable.
    pub fields: Vec<&'a mut [f64]>,
    grid: &'a Grid,
    variables: usize,
    /// Rows of the first variables around the band, `[row, variable, x]`.
    south: Vec<f64>,
    north: Vec<f64>,
    reach: usize,
}

/// Cuts fields into as many bands as there are threads, if they are large enough; `reach` rows of the first `variables`
/// fields are copied on either side.
pub(crate) fn bands<'a>(grid: &'a Grid, x: &'a mut [f64], variables: usize, reach: usize) -> Vec<Band<'a>> {
    let (nx, ny, cells) = (grid.nx, grid.ny, grid.cells());
    let most = cells / LEAST_CELLS_PER_BAND;
    let count = if most < 2 { 1 } else { rayon::current_num_threads().min(most).min(ny / (2 * reach)).max(1) };
    let mut bands: Vec<Band<'a>> = (0..count)
        .map(|band| {
            let (first, end) = (band * ny / count, (band + 1) * ny / count);
            let around = |from: usize| -> Vec<f64> {
                let mut copy = Vec::with_capacity(reach * variables * nx);
                for row in from..from + reach {
                    for variable in 0..variables {
                        copy.extend_from_slice(&x[variable * cells + row % ny * nx..][..nx]);
                    }
                }
                copy
            };
            let (south, north) = (around(first + (reach / ny + 1) * ny - reach), around(end));
            let fields = Vec::with_capacity(x.len() / cells);
            Band { first, rows: end - first, fields, grid, variables, south, north, reach }
        })
        .collect();
    for mut field in x.chunks_exact_mut(cells) {
        for band in &mut bands {
            let (own, rest) = field.split_at_mut(band.rows * nx);
            band.fields.push(own);
            field = rest;
        }
    }
    bands
}

impl Band<'_> {
    /// Whether a wall is south and north of the band.
    pub fn walls(&self) -> (bool, bool) {
        let channel = self.grid.boundary == Boundary::Channel;
        (channel && self.first == 0, channel && self.first + self.rows == self.grid.ny)
    }

    /// The rows to push: the band's, and those within reach where there is no wall.
    pub fn reached(&self, reach: usize) -> std::ops::Range<isize> {
        let (south, north) = self.walls();
        let (first, end, reach) = (self.first as isize, (self.first + self.rows) as isize, reach as isize);
        (if south { first } else { first - reach })..(if north { end } else { end + reach })
    }

    /// The number of a row that may be beyond a periodic edge.
    pub fn grid_row(&self, row: isize) -> usize {
        let ny = self.grid.ny as isize;
        if (0..ny).contains(&row) { row as usize } else { row.rem_euclid(ny) as usize }
    }

    /// A row of the first variables.
    pub fn row(&self, row: isize) -> Row<'_> {
        let nx = self.grid.nx;
        let offset = row - self.first as isize;
        let len = self.variables * nx;
        if offset < 0 {
            return Row::of(&self.south[(offset + self.reach as isize) as usize * len..][..len], nx);
        }
        if offset >= self.rows as isize {
            return Row::of(&self.north[(offset - self.rows as isize) as usize * len..][..len], nx);
        }
        let mut out = Row::default();
        for (out, field) in out.0.iter_mut().zip(&self.fields[..self.variables]) {
            *out = &field[offset as usize * nx..][..nx];
        }
        out
    }
}

/// A ring of rows, as many as a power of two, so that finding one is no division.
pub(crate) struct Ring {
    values: Vec<f64>,
    row_len: usize,
    mask: usize,
}

impl Ring {
    /// Of at least `depth` rows.
    pub fn new(row_len: usize, depth: usize) -> Self {
        let depth = depth.next_power_of_two();
        Self { values: vec![0.0; row_len * depth], row_len, mask: depth - 1 }
    }

    fn start(&self, row: isize) -> usize {
        (row as usize & self.mask) * self.row_len
    }

    pub fn row(&self, row: isize) -> &[f64] {
        let start = self.start(row);
        &self.values[start..start + self.row_len]
    }

    pub fn row_mut(&mut self, row: isize) -> &mut [f64] {
        let start = self.start(row);
        &mut self.values[start..start + self.row_len]
    }
}
