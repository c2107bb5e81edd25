//! `[initial]`: the background at the start; `[truth.initial]`: the truth there, where it is given.

mod cosine_wave;
mod file;
mod gaussian_hill;
mod given;
mod jet;
mod netcdf;
mod random_balanced;
mod rest;
mod state;
mod vortices;

pub(crate) use cosine_wave::{WAVE, wave};
pub(crate) use gaussian_hill::{HILL, hill};
pub(crate) use given::GivenState;
pub(crate) use netcdf::{TRUE_VARIABLES, state_file};
pub(crate) use state::layout;
pub use state::{BalancedHeights, InitialState};

use super::{Domain, Kinds};

/// All kinds of initial states. Fractions are of the domain's extent, from the west and from the south.
pub(crate) const INITIAL: &Kinds<dyn InitialState, Domain> = &[
    &rest::KIND,
    &jet::KIND,
    &vortices::KIND,
    &random_balanced::KIND,
    &gaussian_hill::KIND,
    &cosine_wave::KIND,
    &file::KIND,
    &netcdf::KIND,
];
