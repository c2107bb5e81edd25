//! Many runs of one scenario: over several seeds, or over several settings.

mod jobs;
mod plan;
pub mod seeds;
pub mod sweep;
pub(crate) mod temporary;

pub use jobs::{Job, JobError, JobOutcome, OTHER_BYTES, Run, Schedule, fitting, run_jobs};
pub use plan::{BatchKind, BatchPlan, interrupted, unfinished};
