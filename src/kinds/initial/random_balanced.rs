//! `kind = "random_balanced"`.

use super::state::{BalancedHeights, InitialState, LENGTH, MEAN_DEPTH_M, check_rotation, mean_depth_m, on_water};
use crate::kinds::{Domain, Kind};
use crate::reader::{Key, Limits};
use isobar_model::initial::{RandomConfig, random_balanced};
use isobar_model::random::stream;
use isobar_model::{ModelError, State};

const SIGMA_HEIGHT_M: Key<Limits> =
    Key::required("sigma_height_m", "m", Limits::Positive, "standard deviation of the height");

const LENGTH_KM: Key<Limits> = Key::required("length_km", "km", LENGTH, "correlation length");

pub(super) const KIND: Kind<dyn InitialState, Domain> = Kind::<dyn InitialState, Domain>::new(
    "random_balanced",
    "A random height with the wind in geostrophic balance",
    &[&[&MEAN_DEPTH_M, &SIGMA_HEIGHT_M, &LENGTH_KM]],
    |section, domain| {
        check_rotation(section, domain)?;
        Ok(Box::new(RandomConfig {
            mean_depth_m: mean_depth_m(section, domain)?,
            height_standard_deviation_m: section.get(&SIGMA_HEIGHT_M)?,
            length_scale_m: section.get(&LENGTH_KM)? * 1e3,
        }))
    },
)
.only_if(|domain| domain.model.is_shallow_water());

impl InitialState for RandomConfig {
    fn build(&self, domain: &Domain, seed: u64) -> Result<State, ModelError> {
        on_water(domain, |water| random_balanced(water, self, &mut stream(seed, "initial state")))
    }

    fn balance(&self) -> Option<BalancedHeights> {
        let (height_m, length_m) = (self.height_standard_deviation_m, self.length_scale_m);
        Some(BalancedHeights { what: "a random balanced state", height_m, length_m, is_random: true })
    }
}
