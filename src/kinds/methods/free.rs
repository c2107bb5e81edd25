//! `kind = "free"`.

use super::{MethodSettings, Setup, Surroundings};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Read, Section};
use isobar_assim::free::FreeRun;
use isobar_assim::{Assimilator, Error};

pub(super) struct FreeKind;

impl Kind<dyn MethodSettings, Surroundings> for FreeKind {
    fn name(&self) -> &'static str {
        "free"
    }

    fn about(&self) -> &'static str {
        "No assimilation: a forecast that never sees an observation"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        Vec::new()
    }

    fn read(&self, _: &Section<'_>, _: &Surroundings) -> Read<Box<dyn MethodSettings>> {
        Ok(Box::new(Free))
    }
}

#[derive(Debug)]
struct Free;

impl MethodSettings for Free {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(FreeRun::new(setup.problem)))
    }

    fn describe(&self) -> String {
        "no assimilation".into()
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn uses_observations(&self) -> bool {
        false
    }
}
