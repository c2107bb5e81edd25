//! The beginning of an MPI job: who is there, and what each is to do.

use super::coordinator::{self, Coordinator, Open};
use super::line::{Line, receive, send};
use super::messages::{FromWorker, Greeting, ToWorker};
use super::part::{Compute, Part};
use super::post::{LOOK, Post};
use super::worker;
use miette::{IntoDiagnostic, Report, miette};
use mpi::Threading;
use mpi::topology::SimpleCommunicator;
use mpi::traits::Communicator;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// How long a worker has to say that it is there.
const PATIENCE: Duration = Duration::from_secs(120);

/// Joins the job, and computes what rank 0 hands out if this is another rank.
///
/// # Errors
/// If MPI cannot be used, or the processes are not the same program.
pub fn join(compute: Compute) -> Result<Part, Report> {
    let (universe, _) = mpi::initialize_with_threading(Threading::Serialized)
        .ok_or_else(|| miette!("MPI is in use already, or has no thread support"))?;
    let world = universe.world();
    let greeting = greeting()?;
    if world.rank() != 0 {
        let line = Line(world);
        line.say(&FromWorker::Ready(greeting));
        worker::serve(&line, compute)?;
        return Ok(Part::Done);
    }
    let workers: Vec<i32> = (1..world.size()).collect();
    if workers.is_empty() {
        return Ok(Part::Command);
    }
    let Expected { threads, unlike } = match expect(&world, workers.len(), &greeting) {
        Ok(expected) => expected,
        Err(error) => {
            workers.iter().for_each(|&rank| send(&world, rank, &ToWorker::Leave));
            return Err(error);
        }
    };
    let (errands, received) = mpsc::channel();
    let count = workers.len();
    let serve = move || Post::new(workers).serve(&received);
    let thread = thread::Builder::new().name("MPI".into()).spawn(serve).into_diagnostic()?;
    coordinator::begin(Coordinator::new(count, threads, unlike, Open { errands, thread, universe }));
    Ok(Part::Command)
}

/// Who this process is.
fn greeting() -> Result<Greeting, Report> {
    let program = std::env::current_exe().and_then(std::fs::read).into_diagnostic()?;
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let instructions = format!("{:?}", pulp::Arch::new());
    Ok(Greeting { version: crate::VERSION.into(), program: crc32fast::hash(&program), threads, instructions })
}

/// What the workers have.
struct Expected {
    /// The least number of threads that one has.
    threads: usize,
    /// The ranks with other vector instructions than rank 0.
    unlike: Vec<i32>,
}

/// Waits until all workers are there.
fn expect(world: &SimpleCommunicator, workers: usize, own: &Greeting) -> Result<Expected, Report> {
    let (begin, mut there, mut threads, mut unlike) = (Instant::now(), 0, usize::MAX, Vec::new());
    while there < workers {
        let Some((rank, message)) = receive(world) else {
            if begin.elapsed() > PATIENCE {
                return Err(miette!("{there} of {workers} other processes are there after {PATIENCE:?}"));
            }
            thread::sleep(LOOK);
            continue;
        };
        match message {
            Ok(FromWorker::Ready(other)) if (&other.version, other.program) == (&own.version, own.program) => {
                (there, threads) = (there + 1, threads.min(other.threads));
                unlike.extend((other.instructions != own.instructions).then_some(rank));
            }
            Ok(FromWorker::Ready(_)) => {
                let help = "start the same file on all of them";
                return Err(miette!(help = help, "rank {rank} is another build of isobar than rank 0"));
            }
            Ok(other) => return Err(miette!("rank {rank} does not say who it is, but {other:?}")),
            Err(reason) => return Err(miette!("rank {rank} sent {reason}")),
        }
    }
    unlike.sort_unstable();
    Ok(Expected { threads, unlike })
}
