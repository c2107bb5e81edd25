//! `[background_error]` and `[model_error]`: covariances as sums of independent components.

mod balanced;
mod by_distance;
mod members;
mod univariate;
mod white;

use super::{Domain, Kinds};
use crate::reader::{Described, Field, Key, Limits, Read};
use isobar_assim::covariance::Sum;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;
use std::fmt::Debug;
use std::sync::Arc;

/// All kinds of components.
pub(crate) const COVARIANCES: &Kinds<dyn CovarianceSettings, Domain> = &[
    &balanced::BalancedKind,
    &univariate::UnivariateKind,
    &by_distance::ByDistanceKind,
    &members::MembersKind,
    &white::WhiteKind,
];

/// The settings of one of the independent components whose covariances add up.
pub trait CovarianceSettings: Debug + Send + Sync {
    /// The covariance of a state.
    ///
    /// # Errors
    /// If there is no such covariance for the layout.
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error>;

    /// The correlation length \[m\]; `None` where points are not correlated, or nothing says how far.
    fn length_m(&self) -> Option<f64>;
}

/// The components of a covariance.
pub type Components = Vec<Arc<dyn CovarianceSettings>>;

/// The most components of a covariance.
const MOST_COMPONENTS: usize = 20;

/// Reads a table of components.
pub(crate) fn read(field: &Field<'_>, domain: &Domain) -> Read<Components> {
    let components = field.section(&["components"])?.required("components")?.elements(MOST_COMPONENTS)?;
    components.iter().map(|element| Ok(Arc::from(super::read(element, COVARIANCES, domain)?))).collect()
}

/// The sum of the components: zero if there are none.
///
/// # Errors
/// That of a component.
pub fn build(components: &Components, layout: &Layout) -> Result<Arc<dyn Covariance>, Error> {
    let terms = components.iter().map(|component| component.build(layout)).collect::<Result<Vec<_>, _>>()?;
    Ok(Arc::new(Sum::new(layout.len(), terms)))
}

const LENGTH_KM: Key<Limits> = Key::required(
    "length_km",
    "km",
    Limits::Between(1e-3, 1e5),
    "correlation length: of the height, or of the variable",
);

const VARIABLE: Key<Described> = Key::required("variable", "", Described("a variable of the model"), "the variable");

const SIGMA: Key<Limits> = Key::required("sigma", "of the variable", Limits::Positive, "standard deviation");
