//! The ends of a sweep over rows.

use super::tendency::Tendency;
use crate::grid::Boundary;
use std::ops::Range;

/// What is beyond the southern or the northern row of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// The rows at the other end.
    Periodic,
    /// A wall.
    Wall,
    /// Rows of a larger domain, which are not there: what depends on them is not advanced.
    Open,
}

/// The southern and the northern end of a tendency's grid.
pub(super) fn ends<T: Tendency>(tendency: &T) -> [End; 2] {
    tendency.open_ends().map(|is_open| match tendency.layout().grid.boundary {
        Boundary::Periodic => End::Periodic,
        Boundary::Channel if is_open => End::Open,
        Boundary::Channel => End::Wall,
    })
}

/// The rows that a sweep needs to advance `rows` of a grid of `ny`, or as many of them as can be, given how many rows on either
/// side a step depends on. The row beside an open end is left out: the flow through its outer face is set to zero, as at a wall.
pub(super) fn needed(rows: &Range<usize>, ny: usize, [south, north]: [End; 2], reach: usize) -> Range<isize> {
    let (first, end, ny, reach) = (rows.start as isize, rows.end as isize, ny as isize, reach as isize);
    let first = match south {
        End::Periodic => first - reach,
        End::Wall => (first - reach).max(0),
        End::Open => (first - reach).max(1),
    };
    let end = match north {
        End::Periodic => end + reach,
        End::Wall => (end + reach).min(ny),
        End::Open => (end + reach).min(ny - 1),
    };
    first..end
}
