//! What the ranks that compute a run together agree on.
//!
//! All of them do the same, from the same scenario, in the same order. What could differ between them goes through one of these
//! functions, each of which all ranks call: what depends on the clock, on signals, or on files that one rank alone reads or writes.

use isobar_model::communicator::{Communicator, RankFailure, all_succeed};
use std::fmt::Display;

/// A result that every rank must have: an error of one is an error of all.
///
/// # Errors
/// Rank 0 has its own error, if it has one; else all have that of the first rank that has one, in words.
pub fn agreed<T, E: Display + From<RankFailure>>(communicator: &dyn Communicator, own: Result<T, E>) -> Result<T, E> {
    if communicator.ranks() == 1 {
        return own;
    }
    let in_words = own.as_ref().map(|_| ()).map_err(ToString::to_string);
    match (all_succeed(communicator, in_words), own) {
        (Ok(()), own) => own,
        // A scenario's error can show its place.
        (Err(RankFailure { rank: 0, .. }), Err(error)) if communicator.rank() == 0 => Err(error),
        (Err(failure), _) => Err(failure.into()),
    }
}

/// A decision of rank 0.
pub(super) fn of_first(communicator: &dyn Communicator, own: bool) -> bool {
    communicator.of_first(vec![f64::from(u8::from(own))]) != [0.0]
}

/// Fails on all ranks, with the reason, if one of them has another number than rank 0.
///
/// # Errors
/// With the first rank that has another one.
pub(super) fn same(communicator: &dyn Communicator, own: f64, else_reason: &str) -> Result<(), RankFailure> {
    let is_same = communicator.of_first(vec![own]) == [own];
    all_succeed(communicator, if is_same { Ok(()) } else { Err(else_reason) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::testing::on_ranks;

    #[test]
    fn an_error_of_one_rank_is_one_of_all() {
        #[derive(Debug, PartialEq, thiserror::Error)]
        enum Fault {
            #[error("own {0}")]
            Own(usize),
            #[error("of rank {}: {}", .0.rank, .0.reason)]
            Other(#[from] RankFailure),
        }
        let with_faults = |faulty: &[usize]| {
            on_ranks(3, |communicator| {
                let rank = communicator.rank();
                agreed(&communicator, if faulty.contains(&rank) { Err(Fault::Own(rank)) } else { Ok(rank) })
            })
        };
        assert_eq!(with_faults(&[]), [Ok(0), Ok(1), Ok(2)]);
        let of = |rank: usize| Err(Fault::Other(RankFailure { rank, reason: format!("own {rank}") }));
        assert_eq!(with_faults(&[1, 2]), [of(1), of(1), of(1)]);
        assert_eq!(with_faults(&[0, 2]), [Err(Fault::Own(0)), of(0), of(0)]);
    }
}
