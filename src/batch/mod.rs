//! Many runs of one scenario: over several seeds, or over several settings.

mod jobs;
mod plan;
pub mod seeds;
mod side_by_side;
pub mod sweep;
pub(crate) mod temporary;

pub use jobs::{Elsewhere, Job, JobError, JobOutcome, OTHER_BYTES, Runner, Schedule, run_jobs};
pub use plan::{BatchKind, BatchPlan, interrupted, unfinished};
pub use side_by_side::side_by_side;
