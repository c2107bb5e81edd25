//! `kind = "3dvar"`.

use super::adapt::ADAPT_STATIC;
use super::{BIAS, MethodSettings, Setup, Surroundings, variational};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Read, Section};
use isobar_assim::variational::{ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, Error};

pub(super) struct ThreeDVarKind;

impl Kind<dyn MethodSettings, Surroundings> for ThreeDVarKind {
    fn name(&self) -> &'static str {
        "3dvar"
    }

    fn about(&self) -> &'static str {
        "3D-Var: a static B, conjugate gradients, biases in the control vector"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        [&[&BIAS as &dyn AnyKey, &ADAPT_STATIC], variational::KEYS].concat()
    }

    fn read(&self, section: &Section<'_>, _: &Surroundings) -> Read<Box<dyn MethodSettings>> {
        Ok(Box::new(variational::read(section)?))
    }
}

impl MethodSettings for ThreeDVarSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(ThreeDVar::new(setup.problem, self.clone())?))
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
