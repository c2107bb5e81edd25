//! A scenario with methods and networks that are made by code.

use super::error::ExperimentError;
use crate::kinds::{distinct_name, plain_name};
use crate::scenario::{Scenario, check_method_name};
use isobar_assim::{Assimilator, Error, Problem};
use isobar_model::communicator::Communicator;
use isobar_obs::{Network, ObservationError};
use std::borrow::Cow;
use std::sync::Arc;

/// A scenario with methods and networks that are made by code: they run after its own, in the same cycles, with the same
/// events, scores and outputs. A model made by code is part of the scenario:
/// [`Scenario::parse_with_model`](crate::scenario::Scenario::parse_with_model).
///
/// A run that was interrupted is continued by the same code with [`RunOptions::resume`](crate::options::RunOptions::resume);
/// `isobar resume` cannot make what the code makes and refuses.
pub struct ExperimentBuilder<'a> {
    /// The scenario, with the added networks.
    pub(crate) scenario: Cow<'a, Scenario>,
    /// The methods added to it, in their order.
    pub(super) added: Vec<AddedMethod<'a>>,
    /// The ranks that compute it together.
    pub(crate) communicator: Arc<dyn Communicator>,
}

/// A method that is made by code.
pub(super) struct AddedMethod<'a> {
    pub name: String,
    pub description: String,
    pub set_up: Box<SetUp<'a>>,
}

/// Makes a method for a problem.
type SetUp<'a> = dyn Fn(Problem) -> Result<Box<dyn Assimilator>, Error> + Send + Sync + 'a;

impl<'a> ExperimentBuilder<'a> {
    /// Adds a method.
    ///
    /// `set_up` is given the scenario's [`Problem`]. Observations have their biases; a method that does not estimate them
    /// returns zeros as its calibration. Those within a window have the operator of
    /// [`WithinWindow`](isobar_obs::WithinWindow), about the trajectory from the problem's background or the method's last
    /// analysis. What `[sensors]` knows of the biases is used only for a method that has
    /// [`Views::calibration`](isobar_assim::Views::calibration).
    ///
    /// [`ExperimentBuilder::build`] refuses a name that is not valid or that another method has.
    pub fn method<M: Assimilator + 'static>(
        mut self,
        name: &str,
        description: &str,
        set_up: impl Fn(Problem) -> Result<M, Error> + Send + Sync + 'a,
    ) -> Self {
        let (name, description) = (name.to_string(), description.to_string());
        let set_up = move |problem: Problem| -> Result<Box<dyn Assimilator>, Error> { Ok(Box::new(set_up(problem)?)) };
        self.added.push(AddedMethod { name, description, set_up: Box::new(set_up) });
        self
    }

    /// Adds a network with an instrument of any kind, such as [`Steady`](isobar_obs::Steady).
    ///
    /// [`ExperimentBuilder::build`] refuses a name that is not valid or that another network has.
    pub fn network(mut self, network: Network) -> Self {
        self.scenario.to_mut().networks.push(network);
        self
    }

    /// Lets the ranks of a communicator compute the experiment together. Each of them builds and runs it from the same scenario,
    /// with the same options; the model and the methods divide their work, and rank 0 alone writes files.
    pub fn shared_by(self, communicator: Arc<dyn Communicator>) -> Self {
        Self { communicator, ..self }
    }

    /// The names of the methods that are made by code.
    pub(crate) fn added(&self) -> impl Iterator<Item = &str> {
        self.added.iter().map(|method| &*method.name)
    }

    /// Refuses names that are not valid or that another method or network has.
    ///
    /// # Errors
    /// [`ExperimentError`] with the first such name.
    pub(super) fn check_names(&self) -> Result<(), ExperimentError> {
        for (number, AddedMethod { name, .. }) in self.added.iter().enumerate() {
            let others = self.scenario.methods.keys().chain(self.added[..number].iter().map(|method| &method.name));
            check_method_name(name, others).map_err(|(message, help)| ExperimentError::Method {
                name: name.clone(),
                error: Error::Setting(format!("{message}: {help}")),
            })?;
        }
        let networks = &self.scenario.networks;
        for (number, Network { name, instrument, .. }) in networks.iter().enumerate() {
            let others = networks[..number].iter().map(|network| network.name.as_str());
            plain_name(name, "network")
                .and_then(|()| distinct_name(name, others, "network"))
                .map_err(|(message, help)| ObservationError::in_setting(name, "name", format!("{message}: {help}")))?;
            if self.scenario.truth.is_none() && !instrument.is_recorded() {
                let problem =
                    "there is no truth that the network could observe: all networks of the scenario are recorded";
                return Err(ObservationError::in_setting(name, "instrument", problem).into());
            }
        }
        Ok(())
    }
}
