//! `kind = "univariate"`.

use super::component::{CovarianceSettings, LENGTH_KM, SIGMA, VARIABLE};
use crate::kinds::{Domain, Kind};
use isobar_assim::covariance::Univariate;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;

pub(super) const KIND: Kind<dyn CovarianceSettings, Domain> = Kind::new(
    "univariate",
    "One variable alone, with a Gaussian correlation",
    &[&[&VARIABLE, &SIGMA, &LENGTH_KM]],
    |section, domain| {
        Ok(Box::new(UnivariateSettings {
            variable: domain.variable(&section.required(VARIABLE.name)?)?,
            sigma: section.get(&SIGMA)?,
            length_m: section.get(&LENGTH_KM)? * 1e3,
        }))
    },
);

#[derive(Debug)]
struct UnivariateSettings {
    /// The variable's number.
    variable: usize,
    /// Standard deviation, in the variable's unit.
    sigma: f64,
    /// Correlation length \[m\].
    length_m: f64,
}

impl CovarianceSettings for UnivariateSettings {
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error> {
        Ok(Box::new(Univariate::new(layout, self.variable, self.sigma, self.length_m)?))
    }

    fn length_m(&self) -> Option<f64> {
        Some(self.length_m)
    }
}
