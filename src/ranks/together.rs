//! A run that all processes of the MPI job compute together.

use super::messages::Order;
use super::world::World;
use crate::output::Sink;
use crate::run::RunError;
use crate::run::experiment::Experiment;
use isobar_model::communicator::{Communicator, all_succeed};
use miette::miette;
use mpi::topology::SimpleCommunicator;
use mpi::traits::Communicator as _;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// The code with which the job ends if a rank fails.
const FAILURE: i32 = 1;

/// Computes a run on rank 0; the error may be one for which the other ranks wait, so that the job must end.
///
/// # Errors
/// Those of the run, or of another rank that cannot begin it.
pub fn lead<T>(run: impl FnOnce(Arc<dyn Communicator>) -> Result<T, RunError>) -> Result<T, RunError> {
    let world = Arc::new(World::new());
    guarded(&world, || {
        all_succeed(&*world, Ok::<_, String>(()))?;
        run(Arc::clone(&world) as Arc<dyn Communicator>)
    })
}

/// Computes a run on another rank, without any output. An error for which the others would wait ends the job.
pub fn take_part(order: &Order) {
    let world = Arc::new(World::new());
    let outcome = guarded(&world, || {
        let scenario = all_succeed(&*world, order.scenario().map_err(|report| report.to_string()))?;
        let mut deaf: Vec<Box<dyn Sink>> = Vec::new();
        let communicator = Arc::clone(&world) as Arc<dyn Communicator>;
        Experiment::builder(&scenario).shared_by(communicator).run(&order.options(), &mut deaf)
    });
    // What fails on all ranks, rank 0 says.
    if let Err(error) = outcome
        && error.is_of_one_rank()
    {
        end(&world, &error.to_string());
    }
}

/// Ends the job, all processes of it.
pub fn abort() -> ! {
    SimpleCommunicator::world().abort(FAILURE)
}

/// Ends the job if the work panics: the other ranks may wait for what this one was to send.
fn guarded<T>(world: &World, work: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| end(world, "a fault of this program, as it says above"))
}

/// Ends the job for a reason.
fn end(world: &World, reason: &str) -> ! {
    let report = miette!("rank {}: {reason}", world.rank());
    // There is nowhere to report that standard error is closed.
    let _ = writeln!(std::io::stderr(), "{report:?}");
    abort()
}
