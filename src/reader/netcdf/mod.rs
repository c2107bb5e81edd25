//! netCDF files, of version 3 or 4, of others and of isobar: states and observations.

mod attributes;
mod observations;
mod states;

pub(crate) use observations::{Plane, observations};
pub(crate) use states::StateFile;
