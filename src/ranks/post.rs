//! The thread of rank 0 that speaks with the workers.

use super::line::{receive, send};
use super::messages::{FromWorker, Order, ToWorker};
use crate::interrupt;
use mpi::topology::SimpleCommunicator;
use std::collections::{BTreeMap, VecDeque};
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

/// How long rank 0 sleeps when nothing was said.
pub const LOOK: Duration = Duration::from_millis(5);

/// After how long a worker that says nothing counts as dead. It speaks every half second, as long as its processor lets it.
const SILENCE: Duration = Duration::from_secs(60);

/// What rank 0 has the workers do.
pub enum Errand {
    /// A run for one of them.
    Run(OneRun),
    /// A run that all of them compute together with rank 0.
    Share(SharedRun),
}

/// A run for a worker, and the channel for its progress and outcome.
pub struct OneRun {
    /// The run.
    pub order: Order,
    /// Hears the worker; without an end of the run, if the worker has died.
    pub answer: Sender<FromWorker>,
}

/// A run for all.
pub struct SharedRun {
    /// The run.
    pub order: Order,
    /// Hears that the workers have been told, unless some have died.
    pub begun: Sender<()>,
    /// Closed when the run is over: until then another thread speaks with MPI.
    pub over: Receiver<()>,
}

/// A worker with a run.
struct Busy {
    answer: Sender<FromWorker>,
    heard: Instant,
}

/// What the thread knows.
pub struct Post {
    world: SimpleCommunicator,
    idle: Vec<i32>,
    busy: BTreeMap<i32, Busy>,
    waiting: VecDeque<OneRun>,
    dead: usize,
}

impl Post {
    /// With workers that have nothing to do.
    pub fn new(workers: Vec<i32>) -> Self {
        let world = SimpleCommunicator::world();
        Self { world, idle: workers, busy: BTreeMap::new(), waiting: VecDeque::new(), dead: 0 }
    }

    /// Hands out errands until there can be no more, then sends the workers away; whether all of them are alive.
    pub fn serve(mut self, errands: &Receiver<Errand>) -> bool {
        let mut ending = false;
        loop {
            match errands.try_recv() {
                Ok(Errand::Run(run)) => self.waiting.push_back(run),
                Ok(Errand::Share(run)) => self.share(run),
                Err(TryRecvError::Disconnected) if self.busy.is_empty() => break,
                Err(_) => {}
            }
            self.hand_out();
            if interrupt::requested() && !ending {
                ending = true;
                self.busy.keys().for_each(|&rank| send(&self.world, rank, &ToWorker::End));
            }
            if !self.hear() {
                thread::sleep(LOOK);
            }
            self.count_dead();
        }
        self.idle.iter().for_each(|&rank| send(&self.world, rank, &ToWorker::Leave));
        self.dead == 0
    }

    /// Lets all workers compute a run together, and waits for its end. None of them may have something else to do.
    fn share(&self, SharedRun { order, begun, over }: SharedRun) {
        if self.dead > 0 || !self.busy.is_empty() {
            return;
        }
        let message = ToWorker::Share(Box::new(order));
        self.idle.iter().for_each(|&rank| send(&self.world, rank, &message));
        // Whoever asked for the run may have ended.
        let _ = begun.send(());
        let _ = over.recv();
    }

    /// Gives what waits to those who have nothing to do; what nobody is left to compute is dropped.
    fn hand_out(&mut self) {
        if self.idle.is_empty() && self.busy.is_empty() {
            self.waiting.clear();
        }
        while let Some(rank) = self.idle.pop() {
            let Some(OneRun { order, answer }) = self.waiting.pop_front() else {
                self.idle.push(rank);
                return;
            };
            send(&self.world, rank, &ToWorker::Run(Box::new(order)));
            self.busy.insert(rank, Busy { answer, heard: Instant::now() });
        }
    }

    /// Takes a message; whether there was one.
    fn hear(&mut self) -> bool {
        let Some((rank, message)) = receive::<FromWorker>(&self.world) else { return false };
        let Some(busy) = self.busy.get_mut(&rank) else { return true };
        busy.heard = Instant::now();
        match message {
            Ok(message) => {
                let is_done = matches!(message, FromWorker::Done(_));
                // Whoever asked for the run waits for its end.
                let _ = busy.answer.send(message);
                if is_done {
                    self.busy.remove(&rank);
                    self.idle.push(rank);
                }
            }
            // What became of the run is not known.
            Err(_) => self.bury(rank),
        }
        true
    }

    fn count_dead(&mut self) {
        let is_dead = |(rank, busy): (&i32, &Busy)| (busy.heard.elapsed() > SILENCE).then_some(*rank);
        self.busy.iter().filter_map(is_dead).collect::<Vec<_>>().into_iter().for_each(|rank| self.bury(rank));
    }

    fn bury(&mut self, rank: i32) {
        self.busy.remove(&rank);
        self.dead += 1;
    }
}
