//! `kind = "free"`.

use super::{MethodSettings, Setup, Sizes, Surroundings, Work};
use crate::kinds::Kind;
use isobar_assim::free::FreeRun;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> =
    Kind::new("free", "No assimilation: a forecast that never sees an observation", &[], |_, _| Ok(Box::new(Free)));

#[derive(Debug)]
struct Free;

impl MethodSettings for Free {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(FreeRun::new(setup.problem)))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        Work::forecast(sizes)
    }

    fn describe(&self) -> String {
        "no assimilation".into()
    }

    fn in_bands(&self) -> bool {
        true
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn uses_observations(&self) -> bool {
        false
    }
}
