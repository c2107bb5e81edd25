//! Ranks that are threads of one process, for tests of what ranks do together.

use crate::communicator::{Communicator, Sent};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Mutex, PoisonError};
use std::thread;

/// A rank that is a thread.
pub struct ThreadRank {
    rank: usize,
    /// To each rank.
    to: Vec<Sender<Vec<f64>>>,
    /// From each rank.
    from: Mutex<Vec<Receiver<Vec<f64>>>>,
    messages: AtomicU64,
    bytes: AtomicU64,
}

/// Lets a number of ranks do the same, each with its communicator; what each returns, in their order.
///
/// # Panics
/// If one panics.
pub fn on_ranks<T: Send>(ranks: usize, work: impl Fn(ThreadRank) -> T + Sync) -> Vec<T> {
    let mut to: Vec<Vec<Sender<_>>> = (0..ranks).map(|_| Vec::new()).collect();
    let mut from: Vec<Vec<Receiver<_>>> = (0..ranks).map(|_| Vec::new()).collect();
    for receiving in &mut from {
        for sending in &mut to {
            let (sender, receiver) = mpsc::channel();
            sending.push(sender);
            receiving.push(receiver);
        }
    }
    thread::scope(|scope| {
        let begin = |(rank, (to, from))| {
            let (messages, bytes) = (AtomicU64::new(0), AtomicU64::new(0));
            let communicator = ThreadRank { rank, to, from: Mutex::new(from), messages, bytes };
            let work = &work;
            scope.spawn(move || work(communicator))
        };
        let threads: Vec<_> = to.into_iter().zip(from).enumerate().map(begin).collect();
        threads.into_iter().map(|thread| thread.join().expect("a rank panics")).collect()
    })
}

impl Communicator for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.to.len()
    }

    fn exchange(&self, outgoing: Vec<(usize, Vec<f64>)>, sources: &[usize]) -> Vec<Vec<f64>> {
        for (rank, values) in outgoing {
            if rank != self.rank {
                self.messages.fetch_add(1, Ordering::Relaxed);
                self.bytes.fetch_add(8 * values.len() as u64, Ordering::Relaxed);
            }
            self.to[rank].send(values).expect("the other rank is there");
        }
        let from = self.from.lock().unwrap_or_else(PoisonError::into_inner);
        sources.iter().map(|&rank| from[rank].recv().expect("the other rank is there")).collect()
    }

    fn sent(&self) -> Sent {
        Sent { messages: self.messages.load(Ordering::Relaxed), bytes: self.bytes.load(Ordering::Relaxed) }
    }
}

#[cfg(test)]
mod tests {
    use super::on_ranks;
    use crate::communicator::{Alone, Communicator, all_succeed};

    #[test]
    fn ranks_exchange_sum_and_fail_together() {
        let sums = on_ranks(3, |communicator| {
            let rank = communicator.rank();
            let to_next = vec![((rank + 1) % 3, vec![rank as f64; 2])];
            assert_eq!(communicator.exchange(to_next, &[(rank + 2) % 3]), [vec![((rank + 2) % 3) as f64; 2]]);
            assert_eq!(communicator.of_first(vec![rank as f64 + 7.0]), [7.0]);
            assert_eq!(all_succeed(&communicator, Ok::<_, String>(rank)), Ok(rank));
            let failure = all_succeed(&communicator, if rank == 0 { Ok(()) } else { Err(format!("no {rank}")) });
            let failure = failure.unwrap_err();
            assert_eq!((failure.rank, &*failure.reason), (1, "no 1"));
            let mut sum = [rank as f64, 1.0];
            communicator.sum(&mut sum);
            sum
        });
        assert_eq!(sums, [[3.0, 3.0]; 3]);
        let mut alone = [5.0];
        Alone.sum(&mut alone);
        assert_eq!((alone, Alone.gather_all(&[1.0])), ([5.0], vec![vec![1.0]]));
    }
}
