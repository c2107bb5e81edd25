//! `kind = "gaussian_hill"`.

use super::state::{InitialState, LENGTH, fraction};
use crate::kinds::{Domain, Kind};
use crate::reader::{AnyKey, Key, Limits, Read, Section};
use isobar_model::initial::{GaussianHill, gaussian_hills};
use isobar_model::{ModelError, State, advection};

pub(super) struct GaussianHillKind;

const AMPLITUDE: Key<Limits> = Key::required("amplitude", "1", Limits::Any, "tracer on the top, above 0 around it");

const WIDTH_KM: Key<Limits> = Key::required("width_km", "km", LENGTH, "standard deviation of the Gaussian");

const CENTER_X: Key<Limits> = fraction("center_x_fraction", "x of the top");

const CENTER_Y: Key<Limits> = fraction("center_y_fraction", "y of the top");

impl Kind<dyn InitialState, Domain> for GaussianHillKind {
    fn name(&self) -> &'static str {
        "gaussian_hill"
    }

    fn about(&self) -> &'static str {
        "A Gaussian hill of tracer"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        vec![&AMPLITUDE, &WIDTH_KM, &CENTER_X, &CENTER_Y]
    }

    fn fits(&self, domain: &Domain) -> bool {
        !domain.model.is_shallow_water()
    }

    fn read(&self, section: &Section<'_>, domain: &Domain) -> Read<Box<dyn InitialState>> {
        Ok(Box::new(GaussianHill {
            center_x_m: section.get(&CENTER_X)? * domain.grid.width_m(),
            center_y_m: section.get(&CENTER_Y)? * domain.grid.height_m(),
            amplitude: section.get(&AMPLITUDE)?,
            radius_m: section.get(&WIDTH_KM)? * 1e3,
        }))
    }
}

impl InitialState for GaussianHill {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        gaussian_hills(&advection::layout(domain.grid.clone()), 0.0, &[*self])
    }
}
