//! The tests of the crate, in one binary.

mod advection;
mod bands;
mod common;
mod conservation;
mod contracts;
mod errors;
mod forcing;
mod initial;
mod leapfrog;
mod ncar_swm;
mod phenomena;
mod rows;
mod stability;
mod waves;
