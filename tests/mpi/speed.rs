//! What messages between two ranks of this machine take, for the model of time in `src/ranks/README.md`. It launches itself.

use mpi::traits::{Communicator, Destination, Source};
use std::process::Command;
use std::time::Instant;

const NAME: &str = "speed::messages_take_their_time";

/// Seconds for the round trip of a message with this many numbers between two ranks, the fastest of 200.
fn there_and_back(numbers: usize) -> f64 {
    let world = mpi::topology::SimpleCommunicator::world();
    let other = world.process_at_rank(1 - world.rank());
    let message = vec![1.0_f64; numbers];
    let once = || {
        let begin = Instant::now();
        if world.rank() == 0 {
            other.send(&message[..]);
            other.receive_vec::<f64>();
        } else {
            other.receive_vec::<f64>();
            other.send(&message[..]);
        }
        begin.elapsed().as_secs_f64()
    };
    (0..200).map(|_| once()).fold(f64::INFINITY, f64::min)
}

#[test]
#[ignore = "it prints a measurement"]
fn messages_take_their_time() {
    if std::env::var_os("OMPI_COMM_WORLD_RANK").is_some() {
        let universe = mpi::initialize().unwrap();
        let (latency, bandwidth) = (0.5 * there_and_back(1), 8e6 / (0.5 * there_and_back(1_000_000)));
        if universe.world().rank() == 0 {
            println!("latency {:.2} µs, bandwidth {:.2} GB/s", 1e6 * latency, 1e-9 * bandwidth);
        }
        return;
    }
    let mut mpirun = Command::new("mpirun");
    mpirun.args(["-n", "2", "--oversubscribe"]).arg(std::env::current_exe().unwrap());
    mpirun.args([NAME, "--exact", "--ignored", "--nocapture"]);
    mpirun.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    assert!(mpirun.status().expect("mpirun is on the PATH").success());
}
