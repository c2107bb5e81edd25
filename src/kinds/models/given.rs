//! A model that is made by code.

use super::equations::Equations;
use isobar_model::{Adjoint, Duration, Forced, Forcing, Grid, Layout, ModelError};
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;

/// A model that is made by code, with the grid and the parameters that it has.
#[derive(Clone)]
pub(super) struct GivenModel {
    model: Arc<dyn Adjoint>,
    variables: Vec<(&'static str, &'static str)>,
}

impl GivenModel {
    /// The settings of this model.
    pub fn new(model: Arc<dyn Adjoint>) -> Self {
        let variables = model.layout().variables.iter().map(|variable| (variable.name, variable.unit)).collect();
        Self { model, variables }
    }
}

impl Debug for GivenModel {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "a model given by code of {:?}", self.variables)
    }
}

impl Equations for GivenModel {
    fn variables(&self) -> &[(&'static str, &'static str)] {
        &self.variables
    }

    fn layout(&self, _: &Grid) -> Arc<Layout> {
        Arc::clone(self.model.layout())
    }

    fn build(
        &self,
        _: &Grid,
        _: Duration,
        _: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError> {
        Forced::of(Arc::clone(&self.model), forcing)
    }

    fn boxed_clone(&self) -> Box<dyn Equations> {
        Box::new(self.clone())
    }

    fn is_linear(&self) -> bool {
        false
    }

    fn has_other_resolutions(&self) -> bool {
        false
    }
}
