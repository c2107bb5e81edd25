//! The contracts that every covariance operator and every method must keep (feature `testing`): [`check_covariance`],
//! [`check_assimilator`]; and [`Still`], a model for tests.

mod assimilator;
mod covariance;
mod still;

pub use assimilator::{AssimilatorContract, Trial, check_assimilator};
pub use covariance::{CovarianceContract, check_covariance};
pub use still::Still;
