//! `kind = "gaussian_hill"`.

use super::state::{InitialState, LENGTH, fraction};
use crate::kinds::{Domain, Kind};
use crate::reader::{AnyKey, Key, Limits, Read, Section};
use isobar_model::initial::{GaussianHill, gaussian_hills};
use isobar_model::{Grid, ModelError, State, advection};

const AMPLITUDE: Key<Limits> = Key::required("amplitude", "1", Limits::Any, "tracer on the top, above 0 around it");

const WIDTH_KM: Key<Limits> = Key::required("width_km", "km", LENGTH, "standard deviation of the Gaussian");

const CENTER_X: Key<Limits> = fraction("center_x_fraction", "x of the top");

const CENTER_Y: Key<Limits> = fraction("center_y_fraction", "y of the top");

pub(super) const KIND: Kind<dyn InitialState, Domain> = Kind::<dyn InitialState, Domain>::new(
    "gaussian_hill",
    "A Gaussian hill of tracer",
    &[&[&AMPLITUDE], HILL],
    |section, domain| Ok(Box::new(hill(section, &domain.grid, section.get(&AMPLITUDE)?)?)),
)
.only_if(|domain| !domain.model.is_shallow_water());

/// The keys of a hill but for its amplitude.
pub(crate) const HILL: &[&dyn AnyKey] = &[&WIDTH_KM, &CENTER_X, &CENTER_Y];

/// Reads a hill of this amplitude.
pub(crate) fn hill(section: &Section<'_>, grid: &Grid, amplitude: f64) -> Read<GaussianHill> {
    Ok(GaussianHill {
        center_x_m: section.get(&CENTER_X)? * grid.width_m(),
        center_y_m: section.get(&CENTER_Y)? * grid.height_m(),
        amplitude,
        radius_m: section.get(&WIDTH_KM)? * 1e3,
    })
}

impl InitialState for GaussianHill {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        gaussian_hills(&advection::layout(domain.grid.clone()), 0.0, &[*self])
    }
}
