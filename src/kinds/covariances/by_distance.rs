//! `kind = "by_distance"`.

use super::component::{CovarianceSettings, LENGTH_KM, SIGMA, VARIABLE};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Choice, Key, Limits};
use isobar_assim::covariance::{CorrelationFunction, Univariate};
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;

const CORRELATION: Key<Choice<CorrelationFunction>> = Key::required(
    "correlation",
    "",
    Choice(&[
        ("gaussian", CorrelationFunction::Gaussian),
        ("exponential", CorrelationFunction::Exponential),
        ("second_order_autoregressive", CorrelationFunction::SecondOrderAutoregressive),
        ("third_order_autoregressive", CorrelationFunction::ThirdOrderAutoregressive),
        ("gaspari_cohn", CorrelationFunction::GaspariCohn),
    ]),
    "the correlation as a function of distance",
);

const UNCORRELATED_FRACTION: Key<Limits> = Key::absent(
    "uncorrelated_fraction",
    "",
    Limits::Fraction,
    Absent::Means(0.0),
    "fraction of the variance that is not correlated from point to point",
);

pub(super) const KIND: Kind<dyn CovarianceSettings, Domain> = Kind::new(
    "by_distance",
    "One variable alone, with a correlation that is a function of the shortest distance",
    &[&[&VARIABLE, &CORRELATION, &SIGMA, &LENGTH_KM, &UNCORRELATED_FRACTION]],
    |section, domain| {
        Ok(Box::new(ByDistanceSettings {
            variable: domain.variable(&section.required(VARIABLE.name)?)?,
            correlation: section.get(&CORRELATION)?,
            sigma: section.get(&SIGMA)?,
            length_m: section.get(&LENGTH_KM)? * 1e3,
            uncorrelated_fraction: section.get(&UNCORRELATED_FRACTION)?,
        }))
    },
);

#[derive(Debug)]
struct ByDistanceSettings {
    /// The variable's number.
    variable: usize,
    correlation: CorrelationFunction,
    /// Standard deviation, in the variable's unit.
    sigma: f64,
    /// Correlation length \[m\].
    length_m: f64,
    /// Fraction of the variance that is not correlated from point to point.
    uncorrelated_fraction: f64,
}

impl CovarianceSettings for ByDistanceSettings {
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error> {
        let function = (self.correlation, self.length_m);
        Ok(Box::new(Univariate::by_distance(layout, self.variable, self.sigma, function, self.uncorrelated_fraction)?))
    }

    fn length_m(&self) -> Option<f64> {
        Some(self.length_m)
    }
}
