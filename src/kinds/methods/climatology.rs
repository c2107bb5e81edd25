//! `kind = "climatology"`.

use super::{MethodSettings, Setup, Surroundings};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Read, Section};
use isobar_assim::climatology::Climatology;
use isobar_assim::{Assimilator, Error};

pub(super) struct ClimatologyKind;

impl Kind<dyn MethodSettings, Surroundings> for ClimatologyKind {
    fn name(&self) -> &'static str {
        "climatology"
    }

    fn about(&self) -> &'static str {
        "The first background, which never changes"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        Vec::new()
    }

    fn read(&self, _: &Section<'_>, _: &Surroundings) -> Read<Box<dyn MethodSettings>> {
        Ok(Box::new(Constant))
    }
}

#[derive(Debug)]
struct Constant;

impl MethodSettings for Constant {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(Climatology::new(setup.problem)))
    }

    fn describe(&self) -> String {
        "the first background throughout".into()
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err("its background is no forecast of the model")
    }

    fn uses_observations(&self) -> bool {
        false
    }
}
