//! Whether methods that are given the true biases can be given them.

use super::ExperimentError;
use crate::scenario::Scenario;
use isobar_assim::BiasTreatment;
use isobar_obs::ObservingSystem;

/// Refuses a method that is to be given true biases of which nothing is known.
pub(super) fn check(scenario: &Scenario, observing: &ObservingSystem) -> Result<(), ExperimentError> {
    let mut parameters = observing.calibration().parameters.iter().zip(observing.true_calibration());
    let unknown = parameters.find(|(_, truth)| truth.is_none());
    let given = scenario.methods.iter().find(|(_, method)| method.bias == BiasTreatment::Known);
    match unknown.zip(given) {
        Some(((parameter, _), (name, _))) => {
            Err(ExperimentError::UnknownBias { name: name.clone(), parameter: parameter.name.clone() })
        }
        None => Ok(()),
    }
}
