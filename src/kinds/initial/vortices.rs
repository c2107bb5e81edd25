//! `kind = "vortices"`.

use super::state::{BalancedHeights, InitialState, LENGTH, MEAN_DEPTH_M, check_rotation, mean_depth_m, on_water};
use crate::kinds::{Domain, Kind};
use crate::reader::{Key, Limits, Whole};
use isobar_model::initial::{Vortex, vortices};
use isobar_model::random::stream;
use isobar_model::{ModelError, State};
use rand::RngExt;

const COUNT: Key<Whole> = Key::required("count", "", Whole(1, 1000), "number of vortices");

const HEIGHT_M: Key<Limits> = Key::required("height_m", "m", Limits::Any, "height of the first, third, fifth … vortex");

const RADIUS_KM: Key<Limits> =
    Key::required("radius_km", "km", LENGTH, "radius, the standard deviation of the Gaussian");

pub(super) const KIND: Kind<dyn InitialState, Domain> = Kind::<dyn InitialState, Domain>::new(
    "vortices",
    "Balanced vortices at random places, of both signs in turn",
    &[&[&MEAN_DEPTH_M, &COUNT, &HEIGHT_M, &RADIUS_KM]],
    |section, domain| {
        check_rotation(section, domain)?;
        Ok(Box::new(Vortices {
            mean_depth_m: mean_depth_m(section, domain)?,
            count: section.get(&COUNT)?,
            height_m: section.get(&HEIGHT_M)?,
            radius_m: section.get(&RADIUS_KM)? * 1e3,
        }))
    },
)
.only_if(|domain| domain.model.is_shallow_water());

#[derive(Debug)]
struct Vortices {
    mean_depth_m: f64,
    count: usize,
    /// Height of each, positive or negative in turn \[m\].
    height_m: f64,
    radius_m: f64,
}

impl InitialState for Vortices {
    fn build(&self, domain: &Domain, seed: u64) -> Result<State, ModelError> {
        let random = &mut stream(seed, "initial state");
        let all: Vec<Vortex> = (0..self.count)
            .map(|number| Vortex {
                center_x_m: random.random::<f64>() * domain.grid.width_m(),
                center_y_m: random.random::<f64>() * domain.grid.height_m(),
                amplitude_m: if number % 2 == 0 { self.height_m } else { -self.height_m },
                radius_m: self.radius_m,
            })
            .collect();
        on_water(domain, |water| vortices(water, self.mean_depth_m, &all))
    }

    fn balance(&self) -> Option<BalancedHeights> {
        let (height_m, length_m) = (self.height_m.abs(), self.radius_m);
        Some(BalancedHeights { what: "vortices", height_m, length_m, is_random: false })
    }
}
