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

    /// Takes the turn to call MPI, for a number of messages to other ranks, with a number of values in all.
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

#[cfg(test)]
mod tests {
    use super::World;
    use isobar_model::communicator::{Communicator, Sent};
    use std::process::Command;

    /// Longer than what MPI sends without waiting for the receiver, and in all than what is gathered in one call.
    const LONG: usize = 400_000;

    fn check(world: &World) {
        let (rank, ranks) = (world.rank(), world.ranks());
        let all: Vec<usize> = (0..ranks).collect();
        let message = |from: usize, to: usize, length: usize| vec![(10 * from + to) as f64; length + from];
        for length in [0, 1, LONG] {
            let outgoing = all.iter().map(|&to| (to, message(rank, to, length))).collect();
            let expected: Vec<_> = all.iter().map(|&from| message(from, rank, length)).collect();
            assert_eq!(world.exchange(outgoing, &all), expected);
            let own = message(rank, 0, length);
            assert_eq!(world.gather_all(&own), all.iter().map(|&from| message(from, 0, length)).collect::<Vec<_>>());
            assert_eq!(world.of_first(own), message(0, 0, length));
            let mut sum = vec![rank as f64 + 0.5; length];
            world.sum(&mut sum);
            assert_eq!(sum, vec![4.5; length]);
        }
        // Along a line, where the first and the last have one neighbour, in two messages.
        let neighbors = [rank.checked_sub(1), Some(rank + 1).filter(|&next| next < ranks)];
        let neighbors: Vec<usize> = neighbors.into_iter().flatten().flat_map(|it| [it, it]).collect();
        let before = world.sent();
        let outgoing = neighbors.iter().enumerate().map(|(number, &to)| (to, vec![(number % 2) as f64; 7])).collect();
        let received = world.exchange(outgoing, &neighbors);
        assert!(received.iter().enumerate().all(|(number, values)| *values == [(number % 2) as f64; 7]));
        let (messages, bytes) = (neighbors.len() as u64, neighbors.len() as u64 * 56);
        assert_eq!(world.sent(), Sent { messages: before.messages + messages, bytes: before.bytes + bytes });
    }

    /// It launches itself on three ranks.
    #[test]
    fn ranks_exchange_messages_of_all_lengths() {
        if std::env::var_os("OMPI_COMM_WORLD_RANK").is_some() {
            let (_universe, _) = mpi::initialize_with_threading(mpi::Threading::Serialized).unwrap();
            return check(&World::new());
        }
        let name = "ranks::world::tests::ranks_exchange_messages_of_all_lengths";
        let mut mpirun = Command::new("mpirun");
        mpirun.args(["-n", "3", "--oversubscribe"]).arg(std::env::current_exe().unwrap()).args([name, "--exact"]);
        mpirun.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
        let output = mpirun.output().expect("mpirun is on the PATH");
        let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        assert!(output.status.success() && said[0].matches("1 passed").count() == 3, "{said:?}");
    }
}
