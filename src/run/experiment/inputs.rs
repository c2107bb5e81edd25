//! What a run reads beside its scenario's text: it can be resumed only with the same.

use super::builder::AddedMethod;
use super::error::ExperimentError;
use super::ground::ground;
use crate::scenario::Scenario;
use crate::sensors::knowledge::WarmStart;
use crate::text::{clean, listed};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Everything on which the results of a run, or of several, depend beside the scenario's text and the options.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Inputs {
    /// Checksums of what tables of stations, observations and fields say, by their names in the scenario: a project can be
    /// moved, and a remark added.
    tables: BTreeMap<String, u32>,
    /// Checksums of what is known of the sensors, by the names of their databases in the scenario.
    sensors: BTreeMap<String, u32>,
    /// Names of the networks, and of the methods that code has added.
    added: Vec<String>,
}

impl Inputs {
    /// Those of a run.
    pub(super) fn new(scenario: &Scenario, sensors: &WarmStart, added: &[AddedMethod<'_>]) -> Self {
        let networks = scenario.networks.iter().map(|network| &network.name);
        let added = networks.chain(added.iter().map(|method| &method.name)).cloned().collect();
        let known = scenario.sensors.iter().map(|settings| (settings.name.clone(), checksum(sensors)));
        Self { tables: scenario.tables.clone(), sensors: known.collect(), added }
    }

    /// Takes up what a run of a scenario reads beside that of others; of the sensors only in a run for which that is known.
    pub(super) fn add(&mut self, scenario: &Scenario, sensors: Option<&WarmStart>) {
        self.tables.extend(scenario.tables.clone());
        let known = scenario.sensors.iter().zip(sensors);
        self.sensors.extend(known.map(|(settings, sensors)| (settings.name.clone(), checksum(sensors))));
    }

    /// Whether it holds what is known of the sensors of a scenario, as far as it names a database of them.
    pub(super) fn has_sensors_of(&self, scenario: &Scenario) -> bool {
        scenario.sensors.as_ref().is_none_or(|settings| self.sensors.contains_key(&settings.name))
    }

    /// What is not as it was when these were the other ones; `None` if all is.
    pub fn difference(&self, other: &Self) -> Option<String> {
        let changed = |new: &BTreeMap<String, u32>, old: &BTreeMap<String, u32>| -> Vec<String> {
            let names = new.keys().chain(old.keys().filter(|name| !new.contains_key(*name)));
            names.filter(|name| new.get(*name) != old.get(*name)).map(|name| clean(name)).collect()
        };
        let list = |names: &[String]| listed(names.iter().map(String::as_str));
        let (tables, sensors) = (changed(&self.tables, &other.tables), changed(&self.sensors, &other.sensors));
        if self.added != other.added {
            Some("other methods or networks were added to its scenario in code".into())
        } else if !tables.is_empty() {
            Some(format!("what it reads has changed since: {}", list(&tables)))
        } else if !sensors.is_empty() {
            Some(format!("what is known of its sensors has changed since, in {}", list(&sensors)))
        } else {
            None
        }
    }
}

/// What runs of some scenarios read that are beside each other in one directory, each with at most this number of cycles.
///
/// # Errors
/// If a database of sensors cannot be read, or a scenario that names one cannot become an experiment.
pub fn inputs_of<'a>(
    scenarios: impl IntoIterator<Item = &'a Scenario>,
    seed: Option<u64>,
    cycles: Option<usize>,
) -> Result<Inputs, ExperimentError> {
    let mut inputs = Inputs::default();
    for scenario in scenarios {
        let (seed, cycles) = (seed.unwrap_or(scenario.seed), cycles.unwrap_or(scenario.cycle.count));
        let is_new = !inputs.has_sensors_of(scenario);
        let sensors = is_new.then(|| ground(scenario, seed, cycles)).transpose()?.map(|ground| ground.sensors);
        inputs.add(scenario, sensors.as_ref());
    }
    Ok(inputs)
}

/// Of what is known when a run begins.
fn checksum(WarmStart { calibration, knowledge, .. }: &WarmStart) -> u32 {
    let known = postcard::to_stdvec(&(calibration, knowledge)).expect("numbers and names can be serialised");
    crc32fast::hash(&known)
}
