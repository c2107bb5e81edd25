//! A first background that is made by code.

use super::state::InitialState;
use crate::kinds::Domain;
use isobar_model::{ModelError, State};

/// A first background that is made by code.
#[derive(Debug)]
pub(crate) struct GivenState(pub State);

impl InitialState for GivenState {
    fn build(&self, _: &Domain, _: u64) -> Result<State, ModelError> {
        Ok(self.0.clone())
    }
}
