//! `kind = "3dvar"`.

use super::adapt::ADAPT_STATIC;
use super::work::ITERATIONS;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MethodSettings, Setup, Sizes, Surroundings, Work, variational,
};
use crate::kinds::Kind;
use isobar_assim::variational::{ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "3dvar",
    "3D-Var: a static B, conjugate gradients, biases in the control vector",
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &ADAPT_STATIC], variational::KEYS],
    |section, _| Ok(Box::new(variational::read(section)?)),
);

impl MethodSettings for ThreeDVarSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(ThreeDVar::new(setup.problem, self.clone())?))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        Work::minimisation(sizes, sizes.controls, ITERATIONS.min(self.max_iterations as f64))
    }

    fn describe(&self) -> String {
        format!("3D-Var, B × {}", self.covariance_scale)
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn static_covariance_scale(&self) -> Option<f64> {
        Some(self.covariance_scale)
    }
}
