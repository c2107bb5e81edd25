//! Which columns are advanced together: as many as the widest vectors have lanes at a time, interleaved, and a few that are
//! left one after another.

use super::interleaving::Interleaving;
use super::strips::Lanes;
use super::tendency::Tendency;
use crate::columns::Columns;
use crate::grid::Boundary;
use crate::stored::Stored;
use std::borrow::Cow;

/// Fewer columns than this, of `len` values, are advanced one after another, which is then faster than a group filled up with
/// zeros.
///
/// A group takes as long as this number of columns alone, in double and in single precision, on a processor with vectors of 32 bytes: on
/// 20² cells 1.6 and 1.7 to 1.9, on 64² 2.5 to 3.0 and 2.5 to 3.6, on 256² 4.9 and 7.0, with leapfrog there 7 and 9. It has as many
/// bytes in either precision, and they are what matters: what of it stays in cache.
pub(super) fn least_of_a_group<N: Stored>(len: usize) -> usize {
    let bytes = N::COLUMNS * len * size_of::<N>();
    if bytes <= 1 << 18 {
        2
    } else if bytes <= 1 << 21 {
        4
    } else {
        6
    }
}

/// Applies `advance` to the columns of each group, of `levels` levels each, constrained and, if they are many, interleaved,
/// with a sweep for each worker. Which columns share a group has no influence on the result, if it is the same for both
/// numbers of lanes.
pub(super) fn for_each_group<T: Tendency, N: Stored, W: Send>(
    tendency: &T,
    levels: usize,
    columns: &mut [N],
    sweep: impl Fn(Lanes) -> Option<W> + Sync,
    advance: impl Fn(&mut [N], &mut W) + Sync,
) {
    let level = tendency.layout().len();
    let len = levels * level;
    assert_eq!(columns.len() % len, 0, "columns must be whole increments of {len} values");
    let count = columns.len() / len;
    let left = count % N::COLUMNS;
    let (grouped, alone) =
        columns.split_at_mut(if left < least_of_a_group::<N>(len) { count - left } else { count } * len);
    let constrain = |columns: &mut [N]| columns.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    let are_any = (!grouped.is_empty(), !alone.is_empty());
    let mut groups = || {
        let nx = tendency.layout().grid.nx;
        let work = || (sweep(Lanes::Group), Interleaving::new(len / nx, nx), Vec::new());
        Columns::new(grouped, len).for_each_group(N::COLUMNS, work, |group, (sweep, interleaving, filled)| {
            let Some(sweep) = sweep else { return };
            let mut advance_all = |columns: &mut [N]| {
                constrain(columns);
                interleaving.interleave(columns);
                advance(columns, sweep);
                interleaving.separate(columns);
            };
            if group.len() == N::COLUMNS * len {
                return advance_all(group);
            }
            filled.clear();
            filled.extend_from_slice(group);
            filled.resize(N::COLUMNS * len, N::default());
            advance_all(filled);
            group.copy_from_slice(&filled[..group.len()]);
        });
    };
    let mut singles = || {
        Columns::new(alone, len).for_each_group(
            1,
            || sweep(Lanes::One),
            |column, sweep| {
                let Some(sweep) = sweep else { return };
                constrain(column);
                advance(column, sweep);
            },
        );
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

/// Whether f' is taken at the model's own state: if not, f is itself linearised about one that stays as it is.
pub(super) fn follows_state<T: Tendency>(tendency: &T, at: &[f64]) -> bool {
    let level = &at[..tendency.layout().len()];
    std::ptr::eq(tendency.linearised_at(level), level)
}

/// The constrained state at whose levels f' is taken; without walls nothing is constrained.
pub(super) fn linearised_at<'a, T: Tendency>(tendency: &'a T, at: &'a [f64]) -> Cow<'a, [f64]> {
    let level = tendency.layout().len();
    if follows_state(tendency, at) && tendency.layout().grid.boundary == Boundary::Periodic {
        return Cow::Borrowed(at);
    }
    let mut start = Vec::with_capacity(at.len());
    at.chunks_exact(level).for_each(|at| start.extend_from_slice(tendency.linearised_at(at)));
    start.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
    Cow::Owned(start)
}
