//! A model that is made by code.

use super::{Equations, Model};
use isobar_model::{Adjoint, Duration, Grid, ModelError};
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;

/// What the scenario's kind of model is called if it is made by code.
const KIND: &str = "given by code";

#[derive(Clone)]
struct GivenModel {
    model: Arc<dyn Adjoint>,
    variables: Vec<(&'static str, &'static str)>,
}

/// The settings of a model that is made by code.
pub(crate) fn given(model: Arc<dyn Adjoint>) -> Model {
    let variables = model.layout().variables.iter().map(|variable| (variable.name, variable.unit)).collect();
    Model { kind: KIND, time_step: model.time_step(), equations: Arc::new(GivenModel { model, variables }) }
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

    fn build(&self, _: &Grid, _: Duration, _: Duration) -> Result<Arc<dyn Adjoint>, ModelError> {
        Ok(Arc::clone(&self.model))
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
