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

/// How many variables a tendency with a form by rows may have.
pub const MOST_VARIABLES: usize = 4;

/// One row of each variable.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row<'a>(pub(super) [&'a [f64]; MOST_VARIABLES]);

impl<'a> Row<'a> {
    /// A row of `nx` places stored as `[variable, x]`.
    ///
    /// # Panics
    /// If it has more than [`MOST_VARIABLES`] variables.
    #[inline]
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

    /// Takes row `row` of the grid, `north` (row `ny` lies beyond the northern wall), and the row south of it. Writes the
    /// tendency, `[variable, x]`, of the row that is [`RowStream::reach`] rows south of `row`. The first tendencies of a
    /// sweep, for which rows in the south are missing, are not to be used.
    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]);

    /// With a reach of two rows: the tendency of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, _tendency: &mut [f64]) {}
}

/// What a [`TangentRowStream`] takes of the state, or of the increments, and what it writes.
pub struct Pushed<'a, R> {
    /// The row south of the one that is pushed.
    pub south: R,
    /// The row that is pushed.
    pub north: R,
    /// The tendency, of the row that is [`TangentRowStream::reach`] rows south of it.
    pub tendency: &'a mut [f64],
}

/// A tendency and its derivative, row by row from the south, for stencils that reach one or two rows and columns.
///
/// Rows of the state are as in [`RowStream`], at most [`MOST_PLACES`](super::MOST_PLACES) long; rows of increments hold
/// `[x, variable, lane]`.
pub trait TangentRowStream: Send {
    /// As [`RowStream::reach`].
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with its first row.
    fn begin(&mut self, x: Row<'_>, dx: &[f64]);

    /// The rows beyond a wall, of the state `[variable, x]` and the increments, given the rows beside it.
    fn beyond_wall(&self, x: Row<'_>, dx: &[f64], ghost: &mut [f64], d_ghost: &mut [f64]);

    /// As [`RowStream::push`], for state and increments.
    fn push(&mut self, row: usize, x: Pushed<'_, Row<'_>>, dx: Pushed<'_, &[f64]>);

    /// As [`RowStream::finish`], for state and increments.
    fn finish(&mut self, _tendency: &mut [f64], _d_tendency: &mut [f64]) {}
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

    #[inline]
    fn start(&self, row: isize) -> usize {
        (row as usize & self.mask) * self.row_len
    }

    #[inline]
    pub fn row(&self, row: isize) -> &[f64] {
        let start = self.start(row);
        &self.values[start..start + self.row_len]
    }

    #[inline]
    pub fn row_mut(&mut self, row: isize) -> &mut [f64] {
        let start = self.start(row);
        &mut self.values[start..start + self.row_len]
    }
}
