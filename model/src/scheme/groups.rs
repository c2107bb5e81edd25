//! Which columns are advanced together: eight at a time, interleaved, and a few that are left one after another.

use super::interleaving::Interleaving;
use super::strips::Lanes;
use super::tendency::Tendency;
use crate::columns::{Columns, LANES};
use crate::grid::Boundary;
use crate::stored::Stored;
use std::borrow::Cow;

/// Fewer columns than this are advanced one after another, which is then faster than a group filled up with zeros.
const LEAST_OF_A_GROUP: usize = 5;

/// Applies `advance` to the columns of each group in double precision, of `levels` levels each, constrained and, if they are
/// eight, interleaved, with a sweep for each worker. Which columns share a group has no influence on the result, if it is the
/// same for both numbers of lanes.
pub(super) fn for_each_group<T: Tendency, S: Stored, W: Send>(
    tendency: &T,
    levels: usize,
    columns: &mut [S],
    sweep: impl Fn(Lanes) -> Option<W> + Sync,
    advance: impl Fn(&mut [f64], &mut W) + Sync,
) {
    let level = tendency.layout().len();
    let len = levels * level;
    assert_eq!(columns.len() % len, 0, "columns must be whole increments of {len} values");
    let count = columns.len() / len;
    let grouped = if count % LANES < LEAST_OF_A_GROUP { count - count % LANES } else { count };
    let (grouped, alone) = columns.split_at_mut(grouped * len);
    let constrain = |columns: &mut [f64]| columns.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    let are_any = (!grouped.is_empty(), !alone.is_empty());
    let mut groups = || {
        let nx = tendency.layout().grid.nx;
        let work = || (sweep(Lanes::Eight), Interleaving::new(len / nx, nx), Vec::new(), Vec::new());
        Columns::new(grouped, len).for_each_group(LANES, work, |group, (sweep, interleaving, copy, filled)| {
            let Some(sweep) = sweep else { return };
            let mut advance_eight = |columns: &mut [f64]| {
                constrain(columns);
                interleaving.interleave(columns);
                advance(columns, sweep);
                interleaving.separate(columns);
            };
            S::in_double(group, copy, |columns| {
                if columns.len() == LANES * len {
                    return advance_eight(columns);
                }
                filled.clear();
                filled.extend_from_slice(columns);
                filled.resize(LANES * len, 0.0);
                advance_eight(filled);
                columns.copy_from_slice(&filled[..columns.len()]);
            });
        });
    };
    let mut singles = || {
        let work = || (sweep(Lanes::One), Vec::new());
        Columns::new(alone, len).for_each_group(1, work, |column, (sweep, copy)| {
            let Some(sweep) = sweep else { return };
            S::in_double(column, copy, |column| {
                constrain(column);
                advance(column, sweep);
            });
        });
    };
    match are_any {
        (true, true) => {
            rayon::join(groups, singles);
        }
        (true, false) => groups(),
        (false, true) => singles(),
        (false, false) => {}
    }
}

/// The constrained state at whose levels f' is taken; without walls nothing is constrained.
pub(super) fn linearised_at<'a, T: Tendency>(tendency: &'a T, at: &'a [f64]) -> Cow<'a, [f64]> {
    let level = tendency.layout().len();
    let is_itself = std::ptr::eq(tendency.linearised_at(&at[..level]), &at[..level]);
    if is_itself && tendency.layout().grid.boundary == Boundary::Periodic {
        return Cow::Borrowed(at);
    }
    let mut start = Vec::with_capacity(at.len());
    at.chunks_exact(level).for_each(|at| start.extend_from_slice(tendency.linearised_at(at)));
    start.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    Cow::Owned(start)
}
