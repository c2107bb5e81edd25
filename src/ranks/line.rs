//! Messages between the processes.
//!
//! Standard sends and probes that do not block: on each side one thread alone speaks with MPI, looks for messages from time to time,
//! and sleeps in between, so that waiting takes no processor from those that compute. Rank 0 speaks first only to a worker that has
//! nothing to do or looks for messages, and no message waits for another one: there is no deadlock. While all compute one run together,
//! nobody looks for messages.

use super::messages::{FromWorker, ToWorker, packed, unpacked};
use miette::{Report, miette};
use mpi::Tag;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Source};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The tag of what is said on a line. Numbers within a run have another one.
const WORDS: Tag = 0;

/// The line from a worker to rank 0.
pub struct Line(pub SimpleCommunicator);

impl Line {
    /// Says something to rank 0.
    pub fn say(&self, message: &FromWorker) {
        send(&self.0, 0, message);
    }

    /// What rank 0 has said, if anything.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn heard(&self) -> Result<Option<ToWorker>, Report> {
        match receive(&self.0) {
            None => Ok(None),
            Some((_, message)) => message.map(Some).map_err(|reason| miette!("rank 0 sent {reason}")),
        }
    }
}

/// Sends a message to a rank.
pub fn send(world: &SimpleCommunicator, rank: i32, message: &impl Serialize) {
    world.process_at_rank(rank).send_with_tag(&packed(message)[..], WORDS);
}

/// A message and the rank that has sent it, if there is one.
pub fn receive<T: DeserializeOwned>(world: &SimpleCommunicator) -> Option<(i32, Result<T, String>)> {
    let rank = world.any_process().immediate_probe_with_tag(WORDS)?.source_rank();
    let (bytes, _) = world.process_at_rank(rank).receive_vec_with_tag::<u8>(WORDS);
    Some((rank, unpacked(&bytes)))
}
