//! Data-assimilation methods.

pub mod assimilator;
pub mod error;
pub mod partition;

pub use assimilator::{Analysis, Assimilator, BiasTreatment, Estimate};
pub use error::Error;
