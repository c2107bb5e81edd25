//! The processes of an MPI job: the first, rank 0, obeys the command line and hands out the runs of a batch; each of the others
//! computes one run at a time. A single run is computed by all of them together.
//!
//! A run's directory is written by the process that computes it, so all of them see the same file system. Between processes go
//! only what is to be run, how far it is, and its scores. A run has the same bits as on one machine: it is computed by the same
//! function, from the same scenario and options.
//!
//! Of a run that all compute together, rank 0 writes the directory; the others read what it reads, and exchange numbers with it (see
//! [`isobar_model::communicator`]). If one of them dies, or ends with an error of its own, the job ends.
//!
//! If a process dies during a batch, its run is left incomplete, and the others carry on unless the MPI launcher ends them.
//! `isobar resume` continues that run from its last checkpoint on disk.

#[cfg(feature = "mpi")]
mod coordinator;
#[cfg(feature = "mpi")]
mod job;
#[cfg(feature = "mpi")]
mod line;
#[cfg(feature = "mpi")]
mod messages;
mod part;
#[cfg(feature = "mpi")]
mod post;
#[cfg(feature = "mpi")]
mod together;
#[cfg(feature = "mpi")]
mod worker;
#[cfg(feature = "mpi")]
mod world;

pub use part::{Compute, Part};

use crate::batch::Runner;
use crate::options::RunOptions;
use crate::run::RunError;
use crate::scenario::Scenario;
use isobar_model::communicator::{Alone, Communicator};
use miette::Report;
use std::env;
use std::sync::Arc;

/// Joins the other processes of the MPI job, if there are any, and computes what rank 0 hands out, if this is another rank.
///
/// # Errors
/// If this program cannot speak with the others, or they are another program.
pub fn join(compute: Compute) -> Result<Part, Report> {
    #[cfg(feature = "mpi")]
    if is_launched() {
        return job::join(compute);
    }
    #[cfg(not(feature = "mpi"))]
    refuse_several(processes())?;
    let _ = compute;
    Ok(Part::Command)
}

/// Lets the other processes end. Call it when the command is done.
pub fn leave() {
    #[cfg(feature = "mpi")]
    coordinator::leave();
}

/// What computes the runs of a batch: the other processes, if there are any, or this one.
pub fn runner(compute: Compute) -> Runner<'static> {
    #[cfg(feature = "mpi")]
    if let Some(runner) = coordinator::runner() {
        return runner;
    }
    Runner::here(move |scenario, options, listener| compute(scenario, options, listener))
}

/// Computes a run in all processes together, or in this one if there are no others. `run` is given their communicator.
///
/// # Errors
/// If they cannot compute it together.
pub fn share<T>(
    scenario: &Scenario,
    options: &RunOptions,
    run: impl FnOnce(Arc<dyn Communicator>) -> Result<T, RunError>,
) -> Result<Result<T, RunError>, Report> {
    #[cfg(feature = "mpi")]
    if others() > 0 {
        return coordinator::share(scenario, options, run);
    }
    let _ = (scenario, options);
    Ok(run(Arc::new(Alone)))
}

/// Number of other processes.
pub fn others() -> usize {
    #[cfg(feature = "mpi")]
    return coordinator::workers();
    #[cfg(not(feature = "mpi"))]
    0
}

/// The variables by which launchers tell a process how many there are: Open MPI, and MPICH and its relatives.
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];

/// How many processes the launcher has started, as the environment says.
#[cfg(not(feature = "mpi"))]
fn processes() -> usize {
    let size = |name: &&str| env::var(name).ok()?.parse().ok();
    // A batch script of Slurm has its number of tasks as well, without being one of them.
    let of_slurm = || env::var("PMIX_RANK").ok().and_then(|_| env::var("SLURM_NTASKS").ok()?.parse().ok());
    SIZES.iter().find_map(size).or_else(of_slurm).unwrap_or(1)
}

/// Whether an MPI launcher has started this process. Without one MPI is left alone, which takes time to begin.
#[cfg(feature = "mpi")]
fn is_launched() -> bool {
    SIZES.iter().chain(&["PMIX_RANK", "PMI_RANK"]).any(|name| env::var_os(name).is_some())
}

/// Every one of them would do the same, and write into the same directory.
#[cfg(not(feature = "mpi"))]
fn refuse_several(processes: usize) -> Result<(), Report> {
    if processes > 1 {
        let help =
            "`cargo install --path . --features mpi` builds one that has it, where MPI and libclang are installed";
        return Err(miette::miette!(
            help = help,
            "started as {processes} processes, but this isobar is without the feature `mpi`"
        ));
    }
    Ok(())
}

#[cfg(all(test, not(feature = "mpi")))]
mod tests {
    #[test]
    fn several_processes_are_refused_without_the_feature() {
        assert!(super::refuse_several(1).is_ok());
        let error = super::refuse_several(4).unwrap_err();
        assert_eq!(error.to_string(), "started as 4 processes, but this isobar is without the feature `mpi`");
    }
}
