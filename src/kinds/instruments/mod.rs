//! `[networks.NAME]`: the observing systems.

mod bias;
mod file;
mod radiosonde;
mod satellite;

use super::{Domain, Kinds, check_name, choose};
use crate::reader::{Absent, AnyKey, Described, Field, Key, Limits, Read, ScenarioError, Section, Whole};
use crate::text::clean_lines;
use isobar_obs::table::TableError;
use isobar_obs::{Faults, InstrumentSettings, Network, ObservationError, Schedule};
use std::sync::Arc;

/// All kinds of instruments.
pub(crate) const INSTRUMENTS: &Kinds<dyn InstrumentSettings, Domain> =
    &[&radiosonde::RadiosondeKind, &satellite::SatelliteKind, &file::FileKind];

/// The most networks of a scenario.
const MOST_NETWORKS: usize = 100;

const INTERVAL_CYCLES: Key<Whole> = Key::absent(
    "interval_cycles",
    "cycles",
    Whole(1, 1_000_000),
    Absent::Means(1),
    "interval between the cycles in which it reports",
);

const FIRST_CYCLE: Key<Described> = Key::absent(
    "first_cycle",
    "",
    Described("a whole number from 1 to `interval_cycles`"),
    Absent::Means("1"),
    "first cycle in which it reports",
);

const MISSING_RATE: Key<Limits> = Key::absent(
    "missing_rate",
    "1",
    Limits::Fraction,
    Absent::Means(0.0),
    "probability that a station or footprint does not report in a cycle",
);

const FAULTS: Key<Described> = Key::absent(
    "faults",
    "",
    Described(
        "a table of the probabilities `gross_error_rate`, `not_finite_rate`, `duplicate_rate`, `misplaced_rate` and \
         `late_rate`, and of `gross_error_factor` (20), the size of gross errors in standard deviations",
    ),
    Absent::Explained("no faults"),
    "reports that must not be believed, to try quality control on",
);

/// What instruments that make their own observations have in common.
const COMMON: [&dyn AnyKey; 4] = [&INTERVAL_CYCLES, &FIRST_CYCLE, &MISSING_RATE, &FAULTS];

/// Reads `[networks]`; a scenario without it has no observations.
pub(crate) fn read(root: &Section<'_>, domain: &Domain) -> Read<Vec<Network>> {
    let mut networks = Vec::new();
    let Some(field) = root.optional("networks") else { return Ok(networks) };
    for (name, field) in field.any_section()?.fields() {
        check_name(name, &field, "network")?;
        if networks.len() == MOST_NETWORKS {
            return Err(field.misplaced(format!("there are more than {MOST_NETWORKS} networks"), "too many"));
        }
        networks.push(network(name, &field, domain)?);
    }
    Ok(networks)
}

fn network(name: &str, field: &Field<'_>, domain: &Domain) -> Read<Network> {
    let (kind, section) = choose(field, INSTRUMENTS, domain)?;
    let instrument = Arc::from(kind.read(&section, domain)?);
    let every_cycles = section.get(&INTERVAL_CYCLES)?;
    let first_cycle = section.whole_or(FIRST_CYCLE.name, 1, 1, every_cycles)?;
    Ok(Network {
        name: name.to_string(),
        schedule: Schedule { every_cycles, offset_cycles: first_cycle % every_cycles },
        missing_rate: section.get(&MISSING_RATE)?,
        faults: faults(&section)?,
        instrument,
    })
}

/// Reads the faults of a network.
fn faults(section: &Section<'_>) -> Read<Faults> {
    let none = Faults::NONE;
    let Some(field) = section.optional(FAULTS.name) else { return Ok(none) };
    let keys =
        ["gross_error_rate", "gross_error_factor", "not_finite_rate", "duplicate_rate", "misplaced_rate", "late_rate"];
    let section = field.section(&keys)?;
    let rate = |key| section.number_or(key, 0.0, Limits::Fraction);
    Ok(Faults {
        gross_error_rate: rate("gross_error_rate")?,
        gross_error_factor: section.number_or("gross_error_factor", none.gross_error_factor, Limits::Positive)?,
        not_finite_rate: rate("not_finite_rate")?,
        duplicate_rate: rate("duplicate_rate")?,
        misplaced_rate: rate("misplaced_rate")?,
        late_rate: rate("late_rate")?,
    })
}

/// The fault of a file, at the key that names it.
fn at_file(field: &Field<'_>, error: &TableError) -> ScenarioError {
    field.invalid(clean_lines(&error.to_string()), "this file")
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
