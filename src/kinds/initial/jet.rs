//! `kind = "jet"`.

use super::state::{InitialState, LENGTH, MEAN_DEPTH_M, check_rotation, fraction, mean_depth_m, on_water};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Key, Limits};
use isobar_model::initial::{HeightPerturbation, JetConfig, geostrophic_jet};
use isobar_model::{ModelError, State};

const SPEED: Key<Limits> = Key::required("speed_m_per_s", "m/s", Limits::Between(-300.0, 300.0), "speed on the axis");

const WIDTH_KM: Key<Limits> = Key::required("width_km", "km", LENGTH, "half width");

const CENTER_Y: Key<Limits> = fraction("center_y_fraction", "y of the axis");

const PERTURBATION_HEIGHT_M: Key<Limits> = Key::absent(
    "perturbation_height_m",
    "m",
    Limits::Any,
    Absent::Means(0.0),
    "height of a bump in the middle of the axis that sets off the jet's instability",
);

const PERTURBATION_WIDTH_KM: Key<Limits> = Key::absent(
    "perturbation_width_km",
    "km",
    LENGTH,
    Absent::Explained("that of the jet"),
    "half width of the bump in both directions",
);

pub(super) const KIND: Kind<dyn InitialState, Domain> = Kind::<dyn InitialState, Domain>::new(
    "jet",
    "An eastward jet in geostrophic balance",
    &[&[&MEAN_DEPTH_M, &SPEED, &WIDTH_KM, &CENTER_Y, &PERTURBATION_HEIGHT_M, &PERTURBATION_WIDTH_KM]],
    |section, domain| {
        check_rotation(section, domain)?;
        let grid = &domain.grid;
        let center_y_m = section.get(&CENTER_Y)? * grid.height_m();
        let width_km = section.get(&WIDTH_KM)?;
        let bump_width_m = section.find(&PERTURBATION_WIDTH_KM)?.unwrap_or(width_km) * 1e3;
        let bump = HeightPerturbation {
            amplitude_m: section.get(&PERTURBATION_HEIGHT_M)?,
            center_x_m: 0.5 * grid.width_m(),
            center_y_m,
            width_x_m: bump_width_m,
            width_y_m: bump_width_m,
        };
        Ok(Box::new(JetConfig {
            mean_depth_m: mean_depth_m(section, domain)?,
            speed_m_per_s: section.get(&SPEED)?,
            center_y_m,
            width_m: width_km * 1e3,
            perturbation: (bump.amplitude_m != 0.0).then_some(bump),
        }))
    },
)
.only_if(|domain| domain.model.is_shallow_water());

impl InitialState for JetConfig {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        on_water(domain, |water| geostrophic_jet(water, self))
    }
}
