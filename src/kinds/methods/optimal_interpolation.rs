//! `kind = "optimal_interpolation"`.

use super::adapt::ADAPT_STATIC;
use super::{
    BIAS, COMPARISONS, COVARIANCE_SCALE, ERROR_CORRELATION, FIRST_GUESS, MethodSettings, Setup, Sizes, Surroundings,
    Work,
};
use crate::kinds::Kind;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "optimal_interpolation",
    "Optimal interpolation: a static B, solved directly in the space of the observations",
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &COVARIANCE_SCALE, &ADAPT_STATIC]],
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

    fn work(&self, sizes: &Sizes) -> Work {
        // s B Hᵀ and its transpose, S, and P_c.
        let (n, unknowns) = (sizes.observations, sizes.unknowns());
        let numbers = 2.0 * n * unknowns + n * n + 2.0 * sizes.biases.powi(2);
        let multiplications = n * n * unknowns + n.powi(3) / 3.0;
        Work { roots: 2.0 * n, multiplications, ..Work::forecast(sizes).and(Work { numbers, ..Work::default() }) }
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
