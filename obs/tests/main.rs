//! The tests of the crate, in one binary.

mod air_mass;
mod common;
mod determinism;
mod error_correlation;
mod errors;
mod passive;
mod quality;
mod radiosondes;
mod recorded_biases;
mod satellites;
mod station_files;
mod within_window;
