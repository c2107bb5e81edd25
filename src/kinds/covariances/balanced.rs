//! `kind = "balanced"`.

use super::component::{CovarianceSettings, LENGTH_KM};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Key, Limits, YesNo};
use isobar_assim::covariance::{Balanced, BalancedParameters};
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;

const SIGMA_HEIGHT_M: Key<Limits> =
    Key::required("sigma_height_m", "m", Limits::Positive, "standard deviation of the height");

const BALANCED_AT_WALLS: Key<YesNo> = Key::absent(
    "balanced_at_walls",
    "",
    YesNo,
    Absent::Means(false),
    "whether the errors of h vanish at the walls of a channel, as balance without flow through them asks for; otherwise the wind \
     alone is cut off there, which leaves gravity waves",
);

pub(super) const KIND: Kind<dyn CovarianceSettings, Domain> = Kind::new(
    "balanced",
    "A height with a Gaussian correlation, and the wind in geostrophic balance with it",
    &[&[&SIGMA_HEIGHT_M, &LENGTH_KM, &BALANCED_AT_WALLS]],
    |section, domain| {
        let water = domain.model.equations.water().map(|water| water.parameters);
        let Some(water) = water.filter(|water| water.coriolis_per_s != 0.0) else {
            let message = "a balanced covariance needs a shallow-water model with coriolis_per_s other than 0".into();
            let allowed = "must be \"univariate\" or \"white\" for this model";
            return Err(section.required("kind")?.invalid(message, allowed));
        };
        Ok(Box::new(BalancedParameters {
            sigma_height_m: section.get(&SIGMA_HEIGHT_M)?,
            length_m: section.get(&LENGTH_KM)? * 1e3,
            gravity_m_per_s2: water.gravity_m_per_s2,
            coriolis_per_s: water.coriolis_per_s,
            beta_per_m_per_s: water.beta_per_m_per_s,
            balanced_at_walls: section.get(&BALANCED_AT_WALLS)?,
        }))
    },
);

impl CovarianceSettings for BalancedParameters {
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error> {
        Ok(Box::new(Balanced::new(layout, self)?))
    }

    fn length_m(&self) -> Option<f64> {
        Some(self.length_m)
    }

    fn balance(&self) -> Option<&BalancedParameters> {
        Some(self)
    }
}
