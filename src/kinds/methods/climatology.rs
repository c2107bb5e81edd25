//! `kind = "climatology"`.

use super::{MethodSettings, Setup, Sizes, Surroundings, Work};
use crate::kinds::Kind;
use isobar_assim::climatology::Climatology;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> =
    Kind::new("climatology", "The first background, which never changes", &[], |_, _| Ok(Box::new(Constant)));

#[derive(Debug)]
struct Constant;

impl MethodSettings for Constant {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(Climatology::new(setup.problem)))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        Work { steps: 0.0, ..Work::forecast(sizes) }
    }

    fn describe(&self) -> String {
        "the first background throughout".into()
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err("its background is no forecast of the model")
    }

    fn forecasts(&self) -> bool {
        false
    }

    fn uses_observations(&self) -> bool {
        false
    }
}
