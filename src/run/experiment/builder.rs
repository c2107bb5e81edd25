//! A scenario and methods that are made by code.

use super::error::ExperimentError;
use crate::scenario::{Scenario, check_method_name};
use isobar_assim::{Assimilator, Error, Problem};

/// A scenario with methods that are made by code: they run after its own, with the same observations, events, scores and
/// outputs.
///
/// A run that was interrupted is continued by the same code with [`RunOptions::resume`](crate::options::RunOptions::resume);
/// `isobar resume` cannot make the methods and refuses.
pub struct ExperimentBuilder<'a> {
    /// The scenario.
    pub(crate) scenario: &'a Scenario,
    /// The methods added to it, in their order.
    pub(super) added: Vec<AddedMethod<'a>>,
}

/// A method that is made by code.
pub(super) struct AddedMethod<'a> {
    pub name: String,
    pub description: String,
    pub set_up: SetUp<'a>,
}

/// Makes a method for a problem.
type SetUp<'a> = Box<dyn FnOnce(Problem) -> Result<Box<dyn Assimilator>, Error> + Send + 'a>;

impl<'a> ExperimentBuilder<'a> {
    /// Adds a method.
    ///
    /// `set_up` is given the scenario's [`Problem`]. Observations have their biases; a method that does not estimate them
    /// returns zeros as its calibration. What `[sensors]` knows of the biases is used only for a method that has
    /// [`Views::calibration`](isobar_assim::Views::calibration).
    ///
    /// [`ExperimentBuilder::build`] refuses a name that is not valid or that another method has.
    pub fn method(
        mut self,
        name: &str,
        description: &str,
        set_up: impl FnOnce(Problem) -> Result<Box<dyn Assimilator>, Error> + Send + 'a,
    ) -> Self {
        let (name, description) = (name.to_string(), description.to_string());
        self.added.push(AddedMethod { name, description, set_up: Box::new(set_up) });
        self
    }

    /// Refuses names that are not valid or that another method has.
    ///
    /// # Errors
    /// [`ExperimentError::Method`] with the first such name.
    pub(super) fn check_names(&self) -> Result<(), ExperimentError> {
        for (number, AddedMethod { name, .. }) in self.added.iter().enumerate() {
            let others = self.scenario.methods.keys().chain(self.added[..number].iter().map(|method| &method.name));
            check_method_name(name, others).map_err(|(message, help)| ExperimentError::Method {
                name: name.clone(),
                error: Error::Setting(format!("{message}: {help}")),
            })?;
        }
        Ok(())
    }
}
