//! Groups of eight columns, interleaved row by row and strip by strip: a strip of so many places of each row that all
//! that a sweep over it works with stays in cache.
//!
//! A strip is advanced in place and needs some places on either side of it as they were before the step: those in the
//! west have been overwritten by the strip before, and those east of the last strip by the first, so each leaves copies
//! behind.

use crate::stored::Stored;
use crate::update::Leap;
use pulp::{Arch, Simd, WithSimd};

/// Columns of a group.
pub const LANES: usize = 8;

/// The most places of a row in a sweep over a strip.
pub const MOST_PLACES: usize = 80;

/// Rows with more than [`MOST_PLACES`] are cut into strips of no more than this, to which come those on either side.
const STRIP: usize = 64;

/// Some places of each row.
#[derive(Clone, Copy)]
pub(crate) struct Strip {
    /// The first place that is advanced.
    pub first: usize,
    /// How many are.
    pub width: usize,
    /// How many more are needed on either side; none if the strip is all of a row, which is periodic.
    pub reach: usize,
    /// Length of a whole row.
    nx: usize,
}

impl Strip {
    /// The strips of a row, for a sweep that reaches so far.
    pub fn of_row(nx: usize, reach: usize) -> Vec<Strip> {
        if nx <= MOST_PLACES {
            return vec![Strip { first: 0, width: nx, reach: 0, nx }];
        }
        let count = nx.div_ceil(STRIP);
        let strip = |number: usize| {
            let (first, end) = (number * nx / count, (number + 1) * nx / count);
            Strip { first, width: end - first, reach, nx }
        };
        (0..count).map(strip).collect()
    }

    /// Places with those on either side.
    pub fn places(self) -> usize {
        self.width + 2 * self.reach
    }

    /// Copies the strip of a whole row.
    pub fn copy_row(self, row: &[f64], out: &mut [f64]) {
        let end = self.first + self.width;
        let (west, rest) = out.split_at_mut(self.reach);
        let (own, east) = rest.split_at_mut(self.width);
        own.copy_from_slice(&row[self.first..end]);
        west.copy_from_slice(&row[if self.first == 0 { self.nx } else { self.first } - self.reach..][..self.reach]);
        east.copy_from_slice(&row[if end == self.nx { 0 } else { end }..][..self.reach]);
    }
}

/// Reads and writes rows `[x, variable, lane]`, in double precision, of a group of columns `[variable, y, x]`.
pub(crate) struct Group<S> {
    arch: Arch,
    variables: usize,
    /// Values of one variable of a column, and of a whole column.
    cells: usize,
    column_len: usize,
    /// Of each row, `reach` places west of the strip, and the first of the row.
    west: Vec<f64>,
    first: Vec<f64>,
    /// What stands for the columns that are missing in a last group.
    zeros: Vec<S>,
    /// A row `[variable, lane, x]`.
    apart: Vec<f64>,
}

impl<S: Stored> Group<S> {
    /// For columns of `fields` fields of `ny` rows of `nx`, of which the first `variables` are read.
    pub fn new(variables: usize, fields: usize, nx: usize, ny: usize, reach: usize) -> Self {
        let edges = if nx <= MOST_PLACES { 0 } else { ny * reach * variables * LANES };
        Self {
            arch: Arch::new(),
            variables,
            cells: nx * ny,
            column_len: fields * nx * ny,
            west: vec![0.0; edges],
            first: vec![0.0; edges],
            zeros: vec![S::default(); nx.min(MOST_PLACES)],
            apart: vec![0.0; variables * LANES * MOST_PLACES],
        }
    }

    /// Reads the strip of a row; it is yet to be `advanced`, or will be read once more before it is.
    pub fn read(&mut self, columns: &[S], row: usize, strip: Strip, to_be_advanced: bool, out: &mut [f64]) {
        let (nx, reach, end) = (strip.nx, strip.reach, strip.first + strip.width);
        let place = self.variables * LANES;
        let edge = row * reach * place..(row + 1) * reach * place;
        let (west, rest) = out.split_at_mut(reach * place);
        let (own, east) = rest.split_at_mut(strip.width * place);
        let start = row * nx;
        self.interleave(columns, start + strip.first, own);
        if reach == 0 {
            return;
        }
        match strip.first {
            0 => self.interleave(columns, start + nx - reach, west),
            _ => west.copy_from_slice(&self.west[edge.clone()]),
        }
        if end == nx {
            east.copy_from_slice(&self.first[edge.clone()]);
        } else {
            self.interleave(columns, start + end, east);
        }
        if to_be_advanced {
            self.west[edge.clone()].copy_from_slice(&own[own.len() - reach * place..]);
            if strip.first == 0 {
                self.first[edge].copy_from_slice(&own[..reach * place]);
            }
        }
    }

    fn interleave(&self, columns: &[S], start: usize, out: &mut [f64]) {
        let n = out.len() / (self.variables * LANES);
        for variable in 0..self.variables {
            let sources: [&[S]; LANES] = std::array::from_fn(|lane| {
                let from = lane * self.column_len + variable * self.cells + start;
                columns.get(from..from + n).unwrap_or(&self.zeros[..n])
            });
            let out = &mut out.as_chunks_mut::<LANES>().0[variable..];
            self.arch.dispatch(Interleave { sources, out, variables: self.variables });
        }
    }

    /// Writes the strip of a row.
    pub fn write(&mut self, columns: &mut [S], row: usize, strip: Strip, values: &[f64]) {
        self.separate(strip, values);
        let arch = self.arch;
        self.for_each_row(columns, row, strip, |own, _, values| arch.dispatch(Narrow { values, own }));
    }

    /// Advances the strip of a row of two levels by its slopes.
    pub fn leap(&mut self, columns: &mut [S], row: usize, strip: Strip, leapfrog: Leap, slopes: &[f64]) {
        self.separate(strip, slopes);
        let arch = self.arch;
        self.for_each_row(columns, row, strip, |now, before, slope| {
            arch.dispatch(LeapLane { leapfrog, now, before, slope });
        });
    }

    /// The row `[variable, lane, x]`, without the places on either side.
    fn separate(&mut self, strip: Strip, values: &[f64]) {
        let (from, _) = values[strip.reach * self.variables * LANES..].as_chunks::<LANES>();
        for (variable, out) in self.apart.chunks_exact_mut(LANES * strip.width).take(self.variables).enumerate() {
            self.arch.dispatch(Separate { from: &from[variable..], variables: self.variables, out });
        }
    }

    /// Calls with the strip of a row in each column and variable, that in the second half of the fields (if there is
    /// one), and the row's separated values.
    fn for_each_row(
        &self,
        columns: &mut [S],
        row: usize,
        strip: Strip,
        mut process: impl FnMut(&mut [S], &mut [S], &[f64]),
    ) {
        let start = row * strip.nx + strip.first;
        let first_level = self.variables * self.cells;
        for (lane, column) in columns.chunks_exact_mut(self.column_len).enumerate() {
            let (now, before) = column.split_at_mut(first_level);
            for variable in 0..self.variables {
                let values = &self.apart[(variable * LANES + lane) * strip.width..][..strip.width];
                let start = variable * self.cells + start;
                let before = before.get_mut(start..start + strip.width).unwrap_or_default();
                process(&mut now[start..start + strip.width], before, values);
            }
        }
    }
}

struct Interleave<'a, S> {
    sources: [&'a [S]; LANES],
    out: &'a mut [[f64; LANES]],
    variables: usize,
}

impl<S: Stored> WithSimd for Interleave<'_, S> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) {
        let n = self.sources[0].len();
        let [a, b, c, d, e, f, g, h] = self.sources.map(|source| &source[..n]);
        let out = &mut self.out[..(n - 1) * self.variables + 1];
        for i in 0..n {
            out[i * self.variables] = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]].map(S::widen);
        }
    }
}

struct Separate<'a> {
    from: &'a [[f64; LANES]],
    variables: usize,
    out: &'a mut [f64],
}

impl WithSimd for Separate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.out.len() / LANES;
        for (lane, out) in self.out.chunks_exact_mut(n).enumerate() {
            for (out, from) in out.iter_mut().zip(self.from.iter().step_by(self.variables)) {
                *out = from[lane];
            }
        }
    }
}

struct Narrow<'a, S> {
    values: &'a [f64],
    own: &'a mut [S],
}

impl<S: Stored> WithSimd for Narrow<'_, S> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) {
        S::narrow_all(self.values, self.own);
    }
}

struct LeapLane<'a, S> {
    leapfrog: Leap,
    now: &'a mut [S],
    before: &'a mut [S],
    slope: &'a [f64],
}

impl<S: Stored> WithSimd for LeapLane<'_, S> {
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) {
        self.leapfrog.advance(self.now, self.before, self.slope);
    }
}
