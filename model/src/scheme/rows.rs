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

use crate::stored::Stored;

/// How many variables a tendency with a form by rows may have.
pub const MOST_VARIABLES: usize = 4;

/// One row of each variable.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row<'a, N = f64>(pub(super) [&'a [N]; MOST_VARIABLES]);

impl<'a, N: Stored> Row<'a, N> {
    /// A row of `nx` places stored as `[variable, x]`.
    ///
    /// # Panics
    /// If it has more than [`MOST_VARIABLES`] variables.
    #[inline]
    pub fn of(mut values: &'a [N], nx: usize) -> Self {
        let mut row = Self::default();
        let mut variable = 0;
        while values.len() >= nx {
            (row.0[variable], values) = values.split_at(nx);
            variable += 1;
        }
        row
    }

    /// A row given as one slice for each variable.
    ///
    /// # Panics
    /// If there are more than [`MOST_VARIABLES`].
    #[inline(always)]
    pub fn each<const COUNT: usize>(variables: [&'a [N]; COUNT]) -> Self {
        let mut row = Self::default();
        row.0[..COUNT].copy_from_slice(&variables);
        row
    }

    /// The rows of the first variables.
    #[inline(always)]
    pub fn variables<const COUNT: usize>(&self) -> [&'a [N]; COUNT] {
        let mut rows = [&[][..]; COUNT];
        rows.copy_from_slice(&self.0[..COUNT]);
        rows
    }

    /// The row of one variable.
    #[inline(always)]
    pub fn variable(&self, variable: usize) -> &'a [N] {
        self.0[variable]
    }
}

/// A tendency evaluated row by row from the south, for stencils that reach one or two rows and columns. Rows are periodic,
/// and may be those of several states, `[variable, x, lane]`: what they are of each of these it is of `nx` places of one.
pub trait RowStream: Send {
    /// How many rows and columns the stencil reaches.
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with its first row, numbered as in a [`TangentRowStream`].
    fn begin(&mut self, row: isize, first: Row<'_>);

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
pub struct Pushed<'a, N = f64> {
    /// The row south of the one that is pushed.
    pub south: Row<'a, N>,
    /// The row that is pushed.
    pub north: Row<'a, N>,
    /// The tendency, of the row that is [`TangentRowStream::reach`] rows south of it.
    pub tendency: &'a mut [N],
}

/// A tendency and its derivative, row by row from the south, for stencils that reach one or two rows and columns.
///
/// The tendency is computed in double precision and so are the coefficients of its derivative; these are rounded for increments
/// in single precision, whose derivative is computed in single.
///
/// Rows of the state are as in [`RowStream`], at most [`MOST_PLACES`](super::MOST_PLACES) long; rows of increments hold
/// `[variable, x, lane]`, each variable with the place before its first and the place after its last, as it is periodic.
///
/// Rows are numbered from the south; row −1 and row `ny` lie beyond a wall or are those at the other end of a periodic
/// domain, and so on.
pub trait TangentRowStream<N: Stored>: Send {
    /// As [`RowStream::reach`].
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with its first row.
    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>);

    /// The rows beyond a wall, of the state `[variable, x]` and the increments, given the rows beside it.
    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_, N>, ghost: &mut [f64], d_ghost: &mut [N]);

    /// As [`RowStream::push`], for state and increments.
    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_, N>);

    /// As [`RowStream::finish`], for state and increments.
    fn finish(&mut self, _tendency: &mut [f64], _d_tendency: &mut [N]) {}
}

/// A tendency f(x) and the transpose of its derivative, row by row from the south, for stencils that reach one or two rows
/// and columns.
///
/// Rows of the state are pushed first, as in [`RowStream`], and what f' needs to know of them is kept until the same rows of
/// the adjoint increments are pushed. These are arranged and numbered as those of a [`TangentRowStream`], and may be shorter, by
/// as many places in the west as in the east.
pub trait AdjointRowStream: Send {
    /// As [`RowStream::reach`].
    fn reach(&self) -> usize {
        1
    }

    /// Begins a sweep with the first row of the state.
    fn begin(&mut self, row: isize, x: Row<'_>);

    /// The row of the state beyond a wall, `[variable, x]`, given the row beside it.
    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]);

    /// As [`RowStream::push`]. What rows up to that south of `row` need for their adjoint is known from then on.
    fn push_state(&mut self, row: isize, x: Pushed<'_>);

    /// As [`RowStream::finish`].
    fn finish_state(&mut self, _tendency: &mut [f64]) {}

    /// Takes row `row` of y, `north`, and the row south of it; beyond a wall they may be anything. Writes f'ᵀ y of the row
    /// that is [`AdjointRowStream::reach`] rows south of `row`, in which places that must be zero are zero. The first rows of a
    /// sweep, for which rows in the south are missing, are not to be used.
    fn push(&mut self, row: isize, south: Row<'_>, north: Row<'_>, out: &mut [f64]);

    /// With a reach of two rows: f'ᵀ y of the row beside the northern wall, that beyond it having been pushed.
    fn finish(&mut self, _out: &mut [f64]) {}
}

/// A ring of rows, as many as a power of two, so that finding one is no division. They begin where lines of cache do if their
/// length is a whole number of lines.
pub(crate) struct Ring<N = f64> {
    values: Vec<N>,
    /// Values before the first row.
    before: usize,
    row_len: usize,
    mask: usize,
}

impl<N: Stored> Ring<N> {
    /// Of at least `depth` rows.
    pub fn new(row_len: usize, depth: usize) -> Self {
        const LINE_BYTES: usize = 64;
        let depth = depth.next_power_of_two();
        let values = vec![N::default(); row_len * depth + LINE_BYTES / size_of::<N>()];
        // Alignment changes no result, so that failing to find it does no harm.
        let before = values.as_ptr().align_offset(LINE_BYTES).min(LINE_BYTES / size_of::<N>());
        Self { values, before, row_len, mask: depth - 1 }
    }

    #[inline]
    fn start(&self, row: isize) -> usize {
        self.before + (row as usize & self.mask) * self.row_len
    }

    #[inline]
    pub fn row(&self, row: isize) -> &[N] {
        let start = self.start(row);
        &self.values[start..start + self.row_len]
    }

    #[inline]
    pub fn row_mut(&mut self, row: isize) -> &mut [N] {
        let start = self.start(row);
        &mut self.values[start..start + self.row_len]
    }
}
