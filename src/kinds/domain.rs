//! The plane and the model.

use super::models::Model;
use crate::reader::{Field, Read};
use isobar_model::Grid;
use isobar_obs::Projection;

/// The plane and the model: what initial states, covariances and instruments must fit to.
#[derive(Clone, Debug)]
pub struct Domain {
    /// The grid.
    pub grid: Grid,
    /// Where the plane lies on the Earth, if anywhere.
    pub projection: Option<Projection>,
    /// The model.
    pub model: Model,
}

impl Domain {
    /// The number of the model's variable that a key names.
    pub(crate) fn variable(&self, field: &Field<'_>) -> Read<usize> {
        let variables = self.model.variables().iter().enumerate();
        field.choice(&variables.map(|(number, variable)| (variable.0, number)).collect::<Vec<_>>())
    }
}
