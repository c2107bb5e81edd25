//! What of a scenario must be the same in a run that goes on from an earlier one.

use crate::scenario::{Scenario, TruthSettings};
use crate::text::clean;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use toml::{Table, Value};

/// Keys that may differ: what a run is called, how long it is, what is found out and written. The start and the seed are
/// compared apart.
const FREE: [&str; 15] = [
    "title",
    "phenomenon",
    "source",
    "seed",
    "start",
    "cycle.count",
    "cycle.score_from_cycle",
    "diagnostics",
    "warnings",
    "comparisons",
    "sweep",
    "sensors.writes",
    "output",
    "regression",
    "expected",
];

/// The most characters of a value that a message shows.
const SHOWN: usize = 60;

/// All that determines how a cycle follows from the one before: the keys of the scenario, and what the tables say that it names.
/// New observations are read, new states of a truth that is a series, and new times of a forcing's table, so that the names and
/// contents of their files are no part of it; nor is the place of the database of sensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Values by their keys with those of the tables that they are in, as in `model.time_step_s`.
    values: BTreeMap<String, String>,
    /// Checksums of tables by their names in the scenario.
    tables: BTreeMap<String, u32>,
}

impl Settings {
    /// Those of a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        let file: Table = scenario.text.parse().expect("the text has been read before");
        let mut values = BTreeMap::new();
        flatten("", &Value::Table(file.clone()), &mut values);
        values.retain(|key, _| !FREE.iter().any(|free| is_below(key, free)));
        if let Some(name) = values.get_mut("sensors.database") {
            *name = "a database".into();
        }
        let mut read_anew = BTreeSet::new();
        for (name, network) in file.get("networks").and_then(Value::as_table).into_iter().flatten() {
            if network.get("kind").and_then(Value::as_str) == Some("file") {
                read_anew.extend(network.get("file").and_then(Value::as_str));
                values.remove(&format!("networks.{name}.file"));
            }
        }
        if let Some(TruthSettings::Series(series)) = &scenario.truth {
            read_anew.insert(series.name());
            values.remove("truth.file");
        }
        let of_truth = file.get("truth").and_then(|truth| truth.get("forcing"));
        for (list, sources) in [("forcing", file.get("forcing")), ("truth.forcing", of_truth)] {
            for (number, source) in sources.and_then(Value::as_array).into_iter().flatten().enumerate() {
                // The next run may have a longer table.
                let table = source.get("time").and_then(|time| time.get("file")?.as_str());
                read_anew.extend(table);
                values.remove(&format!("{list}[{number}].time.file"));
            }
        }
        let fixed = scenario.tables.iter().filter(|(name, _)| !read_anew.contains(name.as_str()));
        Self { values, tables: fixed.map(|(name, checksum)| (name.clone(), *checksum)).collect() }
    }

    /// What differs from `before`, a line for each key. Only the settings of the methods of these names are compared.
    pub fn differences(&self, before: &Self, methods: &[&str]) -> Vec<String> {
        let is_compared = |key: &str| {
            !is_below(key, "methods") || methods.iter().any(|name| is_below(key, &format!("methods.{name}")))
        };
        let keys: BTreeSet<&String> = self.values.keys().chain(before.values.keys()).collect();
        let changed = keys.into_iter().filter(|key| self.values.get(*key) != before.values.get(*key));
        let shown = |value: Option<&String>| value.map_or("absent".into(), |value| shortened(value));
        let line = |key: &String| {
            let (before, now) = (shown(before.values.get(key)), shown(self.values.get(key)));
            format!("{}: {before} before, {now} now", clean(key))
        };
        let mut lines: Vec<String> = changed.filter(|key| is_compared(key)).map(line).collect();
        let tables =
            self.tables.iter().filter(|(name, checksum)| before.tables.get(*name).is_some_and(|it| it != *checksum));
        lines.extend(tables.map(|(name, _)| format!("{}: what it says has changed", clean(name))));
        lines
    }
}

/// Whether a key is this one, or in the table of this name.
fn is_below(key: &str, table: &str) -> bool {
    key.strip_prefix(table).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// The values of a table, and of tables in it, by their keys. A number is the same with and without a point.
fn flatten(key: &str, value: &Value, values: &mut BTreeMap<String, String>) {
    let below = |name: &str| if key.is_empty() { name.to_string() } else { format!("{key}.{name}") };
    match value {
        Value::Table(table) => table.iter().for_each(|(name, value)| flatten(&below(name), value, values)),
        Value::Array(array) if array.iter().any(Value::is_table) => {
            let elements = array.iter().enumerate();
            elements.for_each(|(number, value)| flatten(&format!("{key}[{number}]"), value, values));
        }
        value => {
            values.insert(key.to_string(), text(value));
        }
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::Integer(integer) => (*integer as f64).to_string(),
        Value::Float(float) => float.to_string(),
        Value::Array(array) => format!("[{}]", array.iter().map(text).collect::<Vec<_>>().join(", ")),
        value => value.to_string(),
    }
}

fn shortened(value: &str) -> String {
    let short: String = value.chars().take(SHOWN).collect();
    clean(&short) + if short.len() < value.len() { "…" } else { "" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn settings(change: impl Fn(&str) -> String) -> Settings {
        let text = change(include_str!("../../cli/template.toml"));
        Settings::of(&Scenario::parse(Path::new("mine.toml"), &text).unwrap())
    }

    #[test]
    fn what_says_the_same_is_the_same() {
        let plain = settings(str::to_string);
        assert!(!plain.values.is_empty());
        let other = settings(|text| {
            let mut file: Table = text.parse().unwrap();
            for (key, value) in [("title", "another"), ("start", "2026-03-01T00:00:00Z")] {
                file.insert(key.into(), value.into());
            }
            let cycle = file["cycle"].as_table_mut().unwrap();
            let hours = cycle["window_hours"].as_integer().unwrap();
            cycle.insert("window_hours".into(), Value::Float(hours as f64));
            cycle.insert("count".into(), Value::Integer(33));
            toml::to_string(&file).unwrap()
        });
        assert_eq!(other.differences(&plain, &["var", "fkf"]), Vec::<String>::new());
        assert_eq!(other, plain);
    }

    #[test]
    fn each_difference_is_a_line_with_key_before_and_now() {
        let (plain, all) = (settings(str::to_string), ["free", "fkf"]);
        let changed = |section: &str, key: &str, value: Value| {
            settings(|text| {
                let mut file: Table = text.parse().unwrap();
                let mut table = &mut file;
                for name in section.split('.') {
                    table = table[name].as_table_mut().unwrap();
                }
                table.insert(key.into(), value.clone());
                toml::to_string(&file).unwrap()
            })
        };
        let step = changed("model", "time_step_s", Value::Integer(240)).differences(&plain, &all);
        assert!(step.len() == 1 && step[0].starts_with("model.time_step_s: "), "{step:?}");
        assert!(step[0].ends_with(" before, 240 now"), "{step:?}");
        let method = changed("methods.fkf", "memory_limit_gb", Value::Integer(3));
        assert_eq!(method.differences(&plain, &all), ["methods.fkf.memory_limit_gb: absent before, 3 now"]);
        assert!(method.differences(&plain, &["free"]).is_empty());
    }
}
