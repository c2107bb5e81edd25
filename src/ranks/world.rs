//! All processes of the MPI job, as they exchange numbers within a run.

use isobar_model::communicator::{Communicator, Sent};
use mpi::collective::SystemOperation;
use mpi::datatype::PartitionMut;
use mpi::request::multiple_scope;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator as _, CommunicatorCollectives, Destination, Root, Source};
use mpi::{Count, Tag};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The tag of numbers, which is not that of what is said to a worker: one that still waits for an order does not hear them.
const NUMBERS: Tag = 1;

/// The most numbers of one collective call: MPI counts them in 32 bits.
const MOST: usize = 1 << 30;

/// The most numbers that are gathered in one call, in which they are held twice.
const FEW: usize = 1 << 20;

/// The ranks of an MPI job. Calls may come from any thread, one at a time.
pub struct World {
    rank: usize,
    ranks: usize,
    sent: Mutex<Sent>,
}

impl World {
    /// All ranks. No other thread of this process may call MPI as long as the run goes on.
    pub fn new() -> Self {
        let world = SimpleCommunicator::world();
        Self { rank: world.rank() as usize, ranks: world.size() as usize, sent: Mutex::default() }
    }

    /// Takes the turn to call MPI, for so many messages to other ranks, with so many numbers in all.
    fn turn(&self, messages: usize, numbers: usize) -> MutexGuard<'_, Sent> {
        let mut sent = self.sent.lock().unwrap_or_else(PoisonError::into_inner);
        sent.messages += messages as u64;
        sent.bytes += 8 * numbers as u64;
        sent
    }

    /// Takes the turn to give others the same numbers.
    fn turn_to_tell(&self, others: usize, numbers: usize) -> MutexGuard<'_, Sent> {
        self.turn(others, others * numbers)
    }
}

impl Communicator for World {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.ranks
    }

    /// All that is sent is under way before anything is awaited: no message, however large, waits for another one.
    fn exchange(&self, outgoing: Vec<(usize, Vec<f64>)>, sources: &[usize]) -> Vec<Vec<f64>> {
        let (own, others): (Vec<_>, Vec<_>) = outgoing.into_iter().partition(|(rank, _)| *rank == self.rank);
        let _turn = self.turn(others.len(), others.iter().map(|(_, values)| values.len()).sum());
        let (world, mut own) = (SimpleCommunicator::world(), own.into_iter());
        multiple_scope(others.len(), |scope, sending| {
            for (rank, values) in &others {
                let to = world.process_at_rank(*rank as i32);
                sending.add(to.immediate_send_with_tag(scope, &values[..], NUMBERS));
            }
            let receive = |&rank: &usize| {
                if rank == self.rank {
                    let (_, values) = own.next().expect("a rank receives of itself what it has sent to itself");
                    values
                } else {
                    world.process_at_rank(rank as i32).receive_vec_with_tag(NUMBERS).0
                }
            };
            let received = sources.iter().map(receive).collect();
            sending.wait_all(&mut Vec::new());
            received
        })
    }

    fn gather_all(&self, own: &[f64]) -> Vec<Vec<f64>> {
        let _turn = self.turn_to_tell(self.ranks - 1, own.len());
        let (world, mut lengths) = (SimpleCommunicator::world(), vec![0_u64; self.ranks]);
        world.all_gather_into(&(own.len() as u64), &mut lengths[..]);
        let lengths: Vec<usize> = lengths.into_iter().map(|length| length as usize).collect();
        if lengths.iter().sum::<usize>() > FEW {
            let of_rank = |(rank, &length): (usize, &usize)| {
                let mut values = if rank == self.rank { own.to_vec() } else { vec![0.0; length] };
                broadcast(&world, rank, &mut values);
                values
            };
            return lengths.iter().enumerate().map(of_rank).collect();
        }
        let begins = lengths.iter().scan(0, |end, &length| Some(std::mem::replace(end, *end + length) as Count));
        let begins: Vec<Count> = begins.collect();
        let counts: Vec<Count> = lengths.iter().map(|&length| length as Count).collect();
        let mut all = vec![0.0; lengths.iter().sum()];
        world.all_gather_varcount_into(own, &mut PartitionMut::new(&mut all[..], counts, begins));
        let mut left = all.into_iter();
        lengths.iter().map(|&length| left.by_ref().take(length).collect()).collect()
    }

    /// Rank 0 adds, and tells the others: they have the same bits.
    fn sum(&self, values: &mut [f64]) {
        let _turn = self.turn_to_tell(if self.rank == 0 { self.ranks - 1 } else { 1 }, values.len());
        let world = SimpleCommunicator::world();
        let root = world.process_at_rank(0);
        for part in values.chunks_mut(MOST) {
            if self.rank == 0 {
                let mut sums = vec![0.0; part.len()];
                root.reduce_into_root(&*part, &mut sums[..], SystemOperation::sum());
                part.copy_from_slice(&sums);
            } else {
                root.reduce_into(&*part, SystemOperation::sum());
            }
        }
        broadcast(&world, 0, values);
    }

    fn of_first(&self, own: Vec<f64>) -> Vec<f64> {
        let _turn = self.turn_to_tell(if self.rank == 0 { self.ranks - 1 } else { 0 }, own.len());
        let (world, mut length) = (SimpleCommunicator::world(), own.len() as u64);
        world.process_at_rank(0).broadcast_into(&mut length);
        let mut values = if self.rank == 0 { own } else { vec![0.0; length as usize] };
        broadcast(&world, 0, &mut values);
        values
    }

    fn sent(&self) -> Sent {
        *self.sent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Replaces the values by those of a rank.
fn broadcast(world: &SimpleCommunicator, rank: usize, values: &mut [f64]) {
    let root = world.process_at_rank(rank as i32);
    values.chunks_mut(MOST).for_each(|part| root.broadcast_into(part));
}
