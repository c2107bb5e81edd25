//! `kind = "optimal_interpolation"`.

use super::adapt::ADAPT_STATIC;
use super::{BIAS, COVARIANCE_SCALE, ERROR_CORRELATION, MethodSettings, Setup, Surroundings};
use crate::kinds::Kind;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "optimal_interpolation",
    "Optimal interpolation: a static B, solved directly in the space of the observations",
    &[&[&BIAS, &ERROR_CORRELATION, &COVARIANCE_SCALE, &ADAPT_STATIC]],
    |section, _| Ok(Box::new(Interpolation { covariance_scale: section.get(&COVARIANCE_SCALE)? })),
);

#[derive(Debug)]
struct Interpolation {
    /// Factor on the covariance B.
    covariance_scale: f64,
}

impl MethodSettings for Interpolation {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(OptimalInterpolation::new(setup.problem, self.covariance_scale)?))
    }

    fn describe(&self) -> String {
        format!("optimal interpolation, B × {}", self.covariance_scale)
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn static_covariance_scale(&self) -> Option<f64> {
        Some(self.covariance_scale)
    }
}
