//! `[networks.NAME]`: the observing systems.

mod bias;
mod common;
mod correlation;
mod file;
mod radiosonde;
mod satellite;

use super::{Domain, Kinds, check_name, choose, distinct_name};
use crate::reader::{Field, Read, Section, read_all};
use common::{ASSIMILATE, FIRST_CYCLE, INTERVAL_CYCLES, MISSING_RATE, TIMES_PER_WINDOW, WITHHOLD, faults};
use isobar_obs::{InstrumentSettings, Network, ObservationError, Schedule};
use std::sync::Arc;

/// All kinds of instruments.
pub(crate) const INSTRUMENTS: &Kinds<dyn InstrumentSettings, Domain> =
    &[&radiosonde::KIND, &satellite::KIND, &file::KIND];

/// The most networks of a scenario.
const MOST_NETWORKS: usize = 100;

/// Reads `[networks]`; a scenario without it has no observations.
pub(crate) fn read(root: &Section<'_>, domain: &Domain) -> Read<Vec<Network>> {
    let Some(field) = root.optional("networks") else { return Ok(Vec::new()) };
    let mut names: Vec<&str> = Vec::new();
    read_all(field.any_section()?.fields().map(|(name, field)| {
        check_name(name, &field, "network")?;
        distinct_name(name, names.iter().copied(), "network")
            .map_err(|(message, help)| field.misplaced(message, help))?;
        if names.len() == MOST_NETWORKS {
            return Err(field.misplaced(format!("there are more than {MOST_NETWORKS} networks"), "too many"));
        }
        names.push(name);
        network(name, &field, domain)
    }))
}

fn network(name: &str, field: &Field<'_>, domain: &Domain) -> Read<Network> {
    let (kind, section) = choose(field, INSTRUMENTS, domain)?;
    let instrument: Arc<dyn InstrumentSettings> = Arc::from((kind.read)(&section, domain)?);
    Ok(Network {
        name: name.to_string(),
        schedule: Schedule { every_cycles: section.get(&INTERVAL_CYCLES)?, first_cycle: section.get(&FIRST_CYCLE)? },
        missing_rate: section.get(&MISSING_RATE)?,
        faults: faults(&section)?,
        error_correlation: correlation::read(&section, &*instrument)?,
        assimilate: section.get(&ASSIMILATE)?,
        withhold: section.get(&WITHHOLD)?,
        times_per_window: section.get(&TIMES_PER_WINDOW)?,
        instrument,
    })
}

/// The keys of a scenario's text that lead to the setting of which an error speaks: that of the network whose name without
/// its unit the setting begins with.
pub(crate) fn place(error: &ObservationError, text: &str) -> Vec<String> {
    let mut path = vec!["networks".to_string()];
    let Some((network, setting)) = error.network().zip(error.setting()) else { return path };
    path.push(network.to_string());
    let scenario: toml::Table = text.parse().unwrap_or_default();
    let section = scenario.get("networks").and_then(|networks| networks.get(network)?.as_table());
    let stem = |key: &str| key.strip_suffix("_km").unwrap_or(key).to_string();
    let keys = section.into_iter().flat_map(toml::Table::keys);
    path.extend(keys.filter(|key| setting.starts_with(&stem(key))).max_by_key(|key| stem(key).len()).cloned());
    path
}
