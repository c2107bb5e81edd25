//! `[background_error]` and `[model_error]`: covariances as sums of independent components.

mod balanced;
mod by_distance;
mod component;
mod members;
mod univariate;
mod white;

pub use component::CovarianceSettings;

use super::{Domain, Kinds};
use crate::reader::{AnyKey, Described, Field, Form, Key, Read, read_all};
use isobar_assim::covariance::Sum;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;
use std::sync::Arc;

/// All kinds of components.
pub(crate) const COVARIANCES: &Kinds<dyn CovarianceSettings, Domain> =
    &[&balanced::KIND, &univariate::KIND, &by_distance::KIND, &members::KIND, &white::KIND];

/// The components of a covariance.
pub type Components = Vec<Arc<dyn CovarianceSettings>>;

/// The most components of a covariance.
const MOST_COMPONENTS: usize = 20;

/// The most values of the control vectors of all components of a covariance: 1 GB, and eight components of the largest grid.
const MOST_CONTROLS: usize = 1 << 27;

const COMPONENTS: Key<Described> = Key::required(
    "components",
    "",
    Described("a list of tables, each with a `kind` of covariance", || Form::list(Form::Listed("covariances"))),
    "independent parts of the errors, whose covariances add up; an empty list for no errors",
);

/// The keys of a covariance.
pub(crate) const KEYS: &[&dyn AnyKey] = &[&COMPONENTS];

/// Reads a table of components.
pub(crate) fn read(field: &Field<'_>, domain: &Domain) -> Read<Components> {
    let components = field.section_with(KEYS)?.required(COMPONENTS.name)?.elements(MOST_COMPONENTS)?;
    read_all(components.iter().map(|element| Ok(Arc::from(super::read(element, COVARIANCES, domain)?))))
}

/// The sum of the components: zero if there are none.
///
/// # Errors
/// That of a component; too many values in all.
pub fn build(components: &Components, layout: &Layout) -> Result<Arc<dyn Covariance>, Error> {
    let (mut terms, mut controls) = (Vec::with_capacity(components.len()), 0);
    for component in components {
        let term = component.build(layout)?;
        controls += term.control_len();
        if controls > MOST_CONTROLS {
            let message = format!(
                "the components of a covariance would need {controls} values or more, of at most {MOST_CONTROLS}: fewer \
                 components, or in a channel shorter lengths, fit"
            );
            return Err(Error::Setting(message));
        }
        terms.push(term);
    }
    Ok(Arc::new(Sum::new(layout.len(), terms)))
}

/// The shortest correlation length of the components \[m\], if any has one.
pub fn shortest_length_m(components: &Components) -> Option<f64> {
    components.iter().filter_map(|component| component.length_m()).reduce(f64::min)
}
