//! `kind = "white"`.

use super::component::{CovarianceSettings, SIGMA, VARIABLE};
use crate::kinds::{Domain, Kind};
use isobar_assim::covariance::White;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;

pub(super) const KIND: Kind<dyn CovarianceSettings, Domain> = Kind::new(
    "white",
    "One variable alone, uncorrelated from point to point",
    &[&[&VARIABLE, &SIGMA]],
    |section, domain| {
        let variable = domain.variable(&section.required(VARIABLE.name)?)?;
        Ok(Box::new(WhiteSettings { variable, sigma: section.get(&SIGMA)? }))
    },
);

#[derive(Debug)]
struct WhiteSettings {
    /// The variable's number.
    variable: usize,
    /// Standard deviation, in the variable's unit.
    sigma: f64,
}

impl CovarianceSettings for WhiteSettings {
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error> {
        Ok(Box::new(White::new(layout, self.variable, self.sigma)))
    }

    fn length_m(&self) -> Option<f64> {
        None
    }
}
