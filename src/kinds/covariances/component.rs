//! What the kinds of components have in common.

use crate::reader::{Described, Form, Key, Limits};
use isobar_assim::covariance::BalancedParameters;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;
use std::fmt::Debug;

/// The settings of one of the independent components whose covariances add up.
pub trait CovarianceSettings: Debug + Send + Sync {
    /// The covariance of a state.
    ///
    /// # Errors
    /// If there is no such covariance for the layout.
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error>;

    /// The correlation length \[m\]; `None` where points are not correlated, or nothing says how far.
    fn length_m(&self) -> Option<f64>;

    /// What is balanced, for a component whose winds are in geostrophic balance with its heights.
    fn balance(&self) -> Option<&BalancedParameters> {
        None
    }
}

pub(super) const LENGTH_KM: Key<Limits> = Key::required(
    "length_km",
    "km",
    Limits::Between(1e-3, 1e5),
    "correlation length: of the height, or of the variable",
);

pub(super) const VARIABLE: Key<Described> =
    Key::required("variable", "", Described("a variable of the model", Form::text), "the variable");

pub(super) const SIGMA: Key<Limits> = Key::required("sigma", "of the variable", Limits::Positive, "standard deviation");
