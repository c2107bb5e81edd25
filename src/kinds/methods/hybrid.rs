//! `kind = "hybrid_3dvar"`.

use super::work::ITERATIONS;
use super::{MethodSettings, Setup, Sizes, Surroundings, Work, ensemble, variational};
use crate::kinds::Kind;
use crate::reader::{Key, Limits};
use isobar_assim::variational::{HybridSettings, HybridThreeDVar};
use isobar_assim::{Assimilator, Error};

const ENSEMBLE_WEIGHT: Key<Limits> = Key::required(
    "ensemble_weight",
    "",
    Limits::Between(0.0, 1.0),
    "weight of the ensemble's covariance; the static one has the rest",
);

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "hybrid_3dvar",
    "3D-Var with the localised covariance of an ensemble beside the static one",
    &[ensemble::KEYS, ensemble::LOCAL_KEYS, &[&ENSEMBLE_WEIGHT], variational::KEYS],
    |section, _| {
        Ok(Box::new(HybridSettings {
            ensemble_weight: section.get(&ENSEMBLE_WEIGHT)?,
            variational: variational::read(section)?,
            ensemble: ensemble::read(section)?,
            local: ensemble::read_local(section)?,
        }))
    },
);

impl MethodSettings for HybridSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(HybridThreeDVar::new(setup.problem, self.clone())?))
    }

    fn takes_comparisons(&self) -> Result<(), &'static str> {
        Err("its members are analysed place by place, and a comparison has no place")
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // The control vector has weights of the members beside that of B: about a field for each.
        let members = self.ensemble.members as f64;
        let controls = sizes.controls + members * sizes.values / sizes.variables;
        let iterations = ITERATIONS.min(self.variational.max_iterations as f64);
        Work::ensemble(sizes, members).and(Work::minimisation(sizes, controls, iterations))
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
