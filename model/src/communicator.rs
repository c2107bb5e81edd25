//! The processes that compute one run together, as the rest of the program sees them.
//!
//! Every process, a rank, runs the same program and makes the same decisions; data too large for one is divided among them (see
//! [`crate::bands`]). All functions of a [`Communicator`] are collective: each rank calls the same ones in the same order, from one
//! thread at a time; otherwise all of them hang.

use std::fmt::Display;

/// How the ranks of a run exchange numbers.
///
/// An implementation sends and receives; how sums are made and values collected follows from that, unless it has a faster way.
pub trait Communicator: Send + Sync {
    /// The number of this process, from 0.
    fn rank(&self) -> usize;

    /// How many there are.
    fn ranks(&self) -> usize;

    /// Sends numbers to other ranks, and returns what each of `sources` has sent here, in their order. What a rank sends to itself is
    /// received as well. A message may be empty.
    fn exchange(&self, outgoing: Vec<(usize, Vec<f64>)>, sources: &[usize]) -> Vec<Vec<f64>>;

    /// The numbers of each rank, in the order of ranks, on all.
    fn gather_all(&self, own: &[f64]) -> Vec<Vec<f64>> {
        let all: Vec<usize> = (0..self.ranks()).collect();
        self.exchange(all.iter().map(|&rank| (rank, own.to_vec())).collect(), &all)
    }

    /// The numbers of each rank, in the order of ranks, on rank 0; nothing on the others.
    fn gather_to_first(&self, own: Vec<f64>) -> Vec<Vec<f64>> {
        let all: Vec<usize> = (0..self.ranks()).collect();
        self.exchange(vec![(0, own)], if self.rank() == 0 { &all } else { &[] })
    }

    /// Replaces each value by its sum over the ranks, with the same bits on all.
    fn sum(&self, values: &mut [f64]) {
        let all = self.gather_all(values);
        values.fill(0.0);
        for of_rank in all {
            values.iter_mut().zip(of_rank).for_each(|(sum, value)| *sum += value);
        }
    }

    /// What rank 0 has, on all.
    fn of_first(&self, own: Vec<f64>) -> Vec<f64> {
        let to_all = |rank| (rank, own.clone());
        let outgoing = if self.rank() == 0 { (0..self.ranks()).map(to_all).collect() } else { Vec::new() };
        self.exchange(outgoing, &[0]).swap_remove(0)
    }

    /// Messages that this rank has sent to others so far.
    fn sent(&self) -> Sent {
        Sent::default()
    }
}

/// What a rank has sent to others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Number of messages.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// One process that has everything.
#[derive(Clone, Copy, Debug)]
pub struct Alone;

impl Communicator for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn ranks(&self) -> usize {
        1
    }

    fn exchange(&self, outgoing: Vec<(usize, Vec<f64>)>, sources: &[usize]) -> Vec<Vec<f64>> {
        assert_eq!(outgoing.len(), sources.len(), "one process receives what it sends");
        outgoing.into_iter().map(|(_, values)| values).collect()
    }

    fn sum(&self, _values: &mut [f64]) {}
}

/// What has failed on another rank, or on this one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct RankFailure {
    /// The first rank on which it has.
    pub rank: usize,
    /// Why, in words.
    pub reason: String,
}

/// A result that some of the ranks may not have: if one has none, all get its reason.
///
/// # Errors
/// [`RankFailure`] of the first rank without a result.
pub fn all_succeed<T, E: Display>(communicator: &dyn Communicator, own: Result<T, E>) -> Result<T, RankFailure> {
    let mut failures = [f64::from(u8::from(own.is_err()))];
    communicator.sum(&mut failures);
    let reason = match own {
        Ok(value) if failures == [0.0] => return Ok(value),
        Ok(_) => Vec::new(),
        Err(error) => error.to_string().into_bytes(),
    };
    let reasons = communicator.gather_all(&reason.into_iter().map(f64::from).collect::<Vec<_>>());
    let rank = reasons.iter().position(|reason| !reason.is_empty()).unwrap_or_default();
    let bytes: Vec<u8> = reasons[rank].iter().map(|&byte| byte as u8).collect();
    Err(RankFailure { rank, reason: String::from_utf8_lossy(&bytes).into_owned() })
}
