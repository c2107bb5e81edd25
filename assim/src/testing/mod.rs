//! The contracts that every covariance operator and every method must keep (feature `testing`): [`check_covariance`],
//! [`check_assimilator`].

mod assimilator;
mod covariance;
#[cfg(test)]
mod still;

pub use assimilator::{AssimilatorContract, Trial, check_assimilator};
pub use covariance::{CovarianceContract, check_covariance};
#[cfg(test)]
pub(crate) use still::Still;
