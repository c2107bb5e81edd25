//! `kind = "hybrid_3dvar"`.

use super::{MethodSettings, Setup, Surroundings, ensemble, variational};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Key, Limits, Read, Section};
use isobar_assim::variational::{HybridSettings, HybridThreeDVar};
use isobar_assim::{Assimilator, Error};

const ENSEMBLE_WEIGHT: Key<Limits> = Key::required(
    "ensemble_weight",
    "",
    Limits::Between(0.0, 1.0),
    "weight of the ensemble's covariance; the static one has the rest",
);

pub(super) struct HybridKind;

impl Kind<dyn MethodSettings, Surroundings> for HybridKind {
    fn name(&self) -> &'static str {
        "hybrid_3dvar"
    }

    fn about(&self) -> &'static str {
        "3D-Var with the localised covariance of an ensemble beside the static one"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        [ensemble::KEYS, ensemble::LOCAL_KEYS, &[&ENSEMBLE_WEIGHT], variational::KEYS].concat()
    }

    fn read(&self, section: &Section<'_>, _: &Surroundings) -> Read<Box<dyn MethodSettings>> {
        Ok(Box::new(HybridSettings {
            ensemble_weight: section.get(&ENSEMBLE_WEIGHT)?,
            variational: variational::read(section)?,
            ensemble: ensemble::read(section)?,
            local: ensemble::read_local(section)?,
        }))
    }
}

impl MethodSettings for HybridSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(HybridThreeDVar::new(setup.problem, self.clone())?))
    }

    fn describe(&self) -> String {
        format!(
            "hybrid 3D-Var, B × {}, an ensemble with weight {}, {} localised within {} km",
            self.variational.covariance_scale,
            self.ensemble_weight,
            ensemble::describe(&self.ensemble),
            self.local.localization_radius_m / 1e3
        )
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err(ensemble::RANDOM_GAIN)
    }
}
