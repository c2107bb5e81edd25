//! Strips of the rows of a group of eight interleaved columns: so many places of each row that all that a sweep over a strip
//! works with stays in cache.
//!
//! A strip is advanced in place and needs some places on either side of it as they were before the step: those in the
//! west have been overwritten by the strip before, and those east of the last strip by the first, so each leaves copies
//! behind.

use crate::columns::LANES;
use std::ops::Range;

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

    /// Those of the places that are left without so many on either side.
    pub fn without(self, outermost: usize) -> Range<usize> {
        let outermost = outermost.min(self.reach);
        outermost..self.places() - outermost
    }

    /// The strip's own places of a row of the whole grid.
    pub fn of_grid(self, row: usize) -> Range<usize> {
        let start = row * self.nx + self.first;
        start..start + self.width
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

/// What a sweep over strips needs to know of a group of columns, `[level, y, x, variable, lane]`.
pub(crate) struct Group {
    variables: usize,
    nx: usize,
    /// Values of one level of the group.
    level: usize,
    /// Of each row of the present level, `reach` places west of the strip, and the first of the row.
    west: Vec<f64>,
    first: Vec<f64>,
}

impl Group {
    /// For columns with this number of variables, each of `ny` rows of `nx`.
    pub fn new(variables: usize, [nx, ny]: [usize; 2], reach: usize) -> Self {
        let edges = if nx <= MOST_PLACES { 0 } else { ny * reach * variables * LANES };
        let level = nx * ny * variables * LANES;
        Self { variables, nx, level, west: vec![0.0; edges], first: vec![0.0; edges] }
    }

    /// Reads the strip of a row of the present level; it is yet to be advanced, or will be read once more before it is.
    pub fn read(&mut self, columns: &[f64], row: usize, strip: Strip, to_be_advanced: bool, out: &mut [f64]) {
        let place = self.variables * LANES;
        let (own, reach) = (self.own(row, strip), strip.reach * place);
        let (west, rest) = out.split_at_mut(reach);
        let (middle, east) = rest.split_at_mut(own.len());
        middle.copy_from_slice(&columns[own.clone()]);
        if reach == 0 {
            return;
        }
        let edge = row * reach..(row + 1) * reach;
        let end_of_row = (row + 1) * self.nx * place;
        match strip.first {
            0 => west.copy_from_slice(&columns[end_of_row - reach..end_of_row]),
            _ => west.copy_from_slice(&self.west[edge.clone()]),
        }
        if own.end == end_of_row {
            east.copy_from_slice(&self.first[edge.clone()]);
        } else {
            east.copy_from_slice(&columns[own.end..own.end + reach]);
        }
        if to_be_advanced {
            self.west[edge.clone()].copy_from_slice(&middle[middle.len() - reach..]);
            if strip.first == 0 {
                self.first[edge].copy_from_slice(&middle[..reach]);
            }
        }
    }

    /// The strip of a row of the present level, and of that before (if there is one).
    pub fn row_mut<'a>(&self, columns: &'a mut [f64], row: usize, strip: Strip) -> (&'a mut [f64], &'a mut [f64]) {
        let own = self.own(row, strip);
        let (now, before) = columns.split_at_mut(self.level);
        (&mut now[own.clone()], before.get_mut(own).unwrap_or_default())
    }

    fn own(&self, row: usize, strip: Strip) -> Range<usize> {
        let (places, place) = (strip.of_grid(row), self.variables * LANES);
        places.start * place..places.end * place
    }
}
