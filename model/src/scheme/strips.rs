//! Strips of the rows of columns, narrow enough that the working set of a sweep over a strip stays in cache.
//!
//! A strip is advanced in place and needs some places on either side of it as they were before the step: those in the
//! west have been overwritten by the strip before, and those east of the last strip by the first, so each leaves copies
//! behind.
//!
//! A strip takes itself for periodic, so that its outermost places become wrong, by as many as the stencil reaches with
//! each stage; those on either side are as many as all stages take.

use crate::stored::Stored;
use std::ops::Range;

/// The most places of a row in a sweep over a strip.
pub const MOST_PLACES: usize = 288;

/// How many columns lie interleaved, and so how a row of them is `[variable, x, lane]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lanes {
    /// One column alone: vector operations take places beside each other.
    One,
    /// A group of columns, as many as the widest vectors have lanes: eight in double precision, sixteen in single. Vector
    /// operations take a place of all.
    Group,
}

impl Lanes {
    /// How many, of columns in this precision.
    pub fn count<N: Stored>(self) -> usize {
        match self {
            Lanes::One => 1,
            Lanes::Group => N::COLUMNS,
        }
    }

    /// Rows longer than the first are cut into strips no wider than the second, not counting the places on either side. A sweep of
    /// shallow water over a group works with 0.9 kB of each place if it has one stage, and with 6 kB if it has four.
    fn limits(self, stages: usize) -> [usize; 2] {
        const ALONE: [usize; 2] = [MOST_PLACES, 240];
        match self {
            Lanes::One => ALONE,
            Lanes::Group => [ALONE[0].min(320 / stages), ALONE[1].min(256 / stages)],
        }
    }

    /// The most places in a strip of rows of `nx`, for a sweep of this number of stages.
    pub(crate) fn most_places(self, nx: usize, stages: usize, reach: usize) -> usize {
        let [longest, width] = self.limits(stages);
        if nx <= longest { nx } else { width + 2 * reach }
    }
}

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
    /// The strips of a row, for a sweep of this number of stages that reaches `reach` places.
    pub fn of_row(nx: usize, lanes: Lanes, stages: usize, reach: usize) -> Vec<Strip> {
        let [longest, width] = lanes.limits(stages);
        if nx <= longest {
            return vec![Strip { first: 0, width: nx, reach: 0, nx }];
        }
        let count = nx.div_ceil(width);
        let strip = |number: usize| {
            let (first, end) = (number * nx / count, (number + 1) * nx / count);
            Strip { first, width: end - first, reach, nx }
        };
        (0..count).map(strip).collect()
    }

    /// The same with less on either side.
    pub fn reaching(self, reach: usize) -> Strip {
        Strip { reach: self.reach.min(reach), ..self }
    }

    /// Places with those on either side.
    pub fn places(self) -> usize {
        self.width + 2 * self.reach
    }

    /// Values of a variable's row of columns: of the strip, and of the place before the first and that after the last.
    pub fn stride(self, lanes: usize) -> usize {
        (self.places() + 2) * lanes
    }

    /// The places of a row that are advanced.
    pub fn own(self) -> Range<usize> {
        self.first..self.first + self.width
    }

    /// Copies the strip of a whole row.
    pub fn copy_row(self, row: &[f64], out: &mut [f64]) {
        let end = self.first + self.width;
        let (west, rest) = out.split_at_mut(self.reach);
        let (own, east) = rest.split_at_mut(self.width);
        own.copy_from_slice(&row[self.own()]);
        west.copy_from_slice(&row[if self.first == 0 { self.nx } else { self.first } - self.reach..][..self.reach]);
        east.copy_from_slice(&row[if end == self.nx { 0 } else { end }..][..self.reach]);
    }
}

/// Reads strips of the rows of one level of columns, `[variable, y, x, lane]`, that are advanced in place.
pub(crate) struct StripReader<N = f64> {
    variables: usize,
    ny: usize,
    /// Values of a row, and of the places on either side of a strip.
    row: usize,
    reach: usize,
    lanes: usize,
    /// Of each row, the places west of the strip, and the first of the row.
    west: Vec<N>,
    first: Vec<N>,
}

impl<N: Stored> StripReader<N> {
    /// For columns with this number of variables, each of `ny` rows of `nx`, and a sweep as in [`Strip::of_row`].
    pub fn new(variables: usize, [nx, ny]: [usize; 2], lanes: Lanes, stages: usize, reach: usize) -> Self {
        let (longest, lanes) = (lanes.limits(stages)[0], lanes.count::<N>());
        let reach = if nx <= longest { 0 } else { reach * lanes };
        let edges = variables * ny * reach;
        Self {
            variables,
            ny,
            row: nx * lanes,
            reach,
            lanes,
            west: vec![N::default(); edges],
            first: vec![N::default(); edges],
        }
    }

    /// Reads the strip of a row as [`periodic_row`] has it; it is yet to be advanced, or will be read once more before it is.
    pub fn read(&mut self, level: &[N], row: usize, strip: Strip, to_be_advanced: bool, out: &mut [N]) {
        let (reach, lanes) = (self.reach, self.lanes);
        let own = strip.first * lanes..(strip.first + strip.width) * lanes;
        let stride = strip.stride(lanes);
        for (variable, out) in out.chunks_exact_mut(stride).take(self.variables).enumerate() {
            let number = variable * self.ny + row;
            let (field, edge) = (&level[number * self.row..][..self.row], number * reach..(number + 1) * reach);
            let inner = stride - 2 * lanes;
            let (west, rest) = out[lanes..][..inner].split_at_mut(reach);
            let (middle, east) = rest.split_at_mut(own.len());
            middle.copy_from_slice(&field[own.clone()]);
            if reach > 0 {
                match strip.first {
                    0 => west.copy_from_slice(&field[self.row - reach..]),
                    _ => west.copy_from_slice(&self.west[edge.clone()]),
                }
                match &field[own.end..] {
                    [] => east.copy_from_slice(&self.first[edge.clone()]),
                    rest => east.copy_from_slice(&rest[..reach]),
                }
                if to_be_advanced {
                    self.west[edge.clone()].copy_from_slice(&middle[middle.len() - reach..]);
                    if strip.first == 0 {
                        self.first[edge].copy_from_slice(&middle[..reach]);
                    }
                }
            }
            periodic_row(out, lanes);
        }
    }

    /// Where the places of a variable's row that are advanced are in a level.
    pub fn own(&self, variable: usize, row: usize, strip: Strip) -> Range<usize> {
        let start = (variable * self.ny + row) * self.row;
        start + strip.first * self.lanes..start + (strip.first + strip.width) * self.lanes
    }

    /// Where they are in a row as it is read.
    pub fn inner(&self, variable: usize, strip: Strip) -> Range<usize> {
        let start = variable * strip.stride(self.lanes) + (1 + strip.reach) * self.lanes;
        start..start + strip.width * self.lanes
    }
}

/// Fills the place before the first and that after the last: the row of a variable has them, as it is periodic, so that a
/// stencil is one loop.
#[inline(always)]
pub(crate) fn periodic_row<N: Copy>(row: &mut [N], lanes: usize) {
    let end = row.len() - lanes;
    row.copy_within(end - lanes..end, 0);
    row.copy_within(lanes..2 * lanes, end);
}
