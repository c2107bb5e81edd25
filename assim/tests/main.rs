//! The tests of the crate, in one binary.

mod accurate_observations;
mod adaptive;
mod agreement;
mod banded;
mod block_angular;
mod closed_form;
mod common;
mod contracts;
mod covariance_columns;
mod ensemble;
mod factors;
mod federated;
mod high_pass;
mod oracles;
mod recovered_amplitudes;
mod response;
mod sensors;
mod separators;
mod single_precision;
mod smoother;
mod sparse_partition;
mod structure;
mod time_volume;
mod transition;
mod variational;
mod wind_finding;
