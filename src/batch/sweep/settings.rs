//! All combinations of values, and the scenario with each of them.

use crate::scenario::{Scenario, ScenarioError, SweepSettings};
use crate::text::clean;
use indexmap::IndexMap;
use toml::{Table, Value};

/// The most settings of all methods together.
const MOST_SETTINGS: usize = 10_000;

/// A combination of values, with the methods that are run with it.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The name of its directory.
    pub directory: String,
    /// The values of the keys.
    pub values: IndexMap<String, Value>,
    /// The methods.
    pub methods: Vec<String>,
    /// The scenario with these values.
    pub scenario: Scenario,
}

/// All settings of a scenario's sweep, with these of its methods.
///
/// # Errors
/// With its place in the file: a key that is not there, a value that the scenario refuses, or a scenario without `[sweep]`.
pub fn settings(
    scenario: &Scenario,
    chosen: Option<&[String]>,
) -> Result<(SweepSettings, Vec<Setting>), ScenarioError> {
    let Some(sweep) = scenario.sweep.clone() else {
        let help = "a sweep needs [sweep], with `vary = { \"methods.NAME.KEY\" = [values] }`".to_string();
        return Err(scenario.fault(&[], help, "there is no [sweep] in this file"));
    };
    check(scenario, &sweep)?;
    let is_chosen = |name: &&String| chosen.is_none_or(|chosen| chosen.contains(name));
    let methods: Vec<&String> = scenario.methods.keys().filter(is_chosen).collect();
    let of = |method: Option<&str>| -> Vec<(&String, &Vec<Value>)> {
        sweep.vary.iter().filter(|(key, _)| method_of(scenario, key) == method).collect()
    };
    let mut all = Vec::new();
    let mut add = |values: IndexMap<String, Value>, methods: Vec<String>| {
        if all.len() == MOST_SETTINGS {
            let message = format!("the combinations of values are more than {MOST_SETTINGS}");
            return Err(scenario.fault(&["sweep", "vary"], message, "too many"));
        }
        let scenario = with_values(scenario, &values)?;
        all.push(Setting { directory: format!("setting-{:04}", all.len() + 1), values, methods, scenario });
        Ok(())
    };
    for common in combinations(&of(None)) {
        let (plain, own): (Vec<&String>, Vec<&String>) =
            methods.iter().partition(|name| of(Some(name.as_str())).is_empty());
        if !plain.is_empty() {
            add(common.clone(), plain.into_iter().cloned().collect())?;
        }
        for name in own {
            for values in combinations(&of(Some(name.as_str()))) {
                add(
                    common.iter().chain(&values).map(|(key, value)| (key.clone(), value.clone())).collect(),
                    vec![name.clone()],
                )?;
            }
        }
    }
    Ok((sweep, all))
}

/// The method that a key concerns alone.
fn method_of<'a>(scenario: &Scenario, key: &'a str) -> Option<&'a str> {
    let name = key.strip_prefix("methods.")?.split('.').next()?;
    scenario.methods.contains_key(name).then_some(name)
}

/// All combinations of the keys' values; one without any where there are no keys.
fn combinations(keys: &[(&String, &Vec<Value>)]) -> Vec<IndexMap<String, Value>> {
    let mut all = vec![IndexMap::new()];
    for (key, values) in keys {
        let with = |before: &IndexMap<String, Value>, value: &Value| {
            let mut own = before.clone();
            own.insert(key.to_string(), value.clone());
            own
        };
        all = all.iter().flat_map(|before| values.iter().map(move |value| with(before, value))).collect();
    }
    all
}

/// Whether each value alone makes a valid scenario.
fn check(scenario: &Scenario, sweep: &SweepSettings) -> Result<(), ScenarioError> {
    for (key, values) in &sweep.vary {
        for value in values {
            with_values(scenario, &[(key.clone(), value.clone())].into())?;
        }
    }
    Ok(())
}

/// The scenario with other values, and without its sweep, its accepted scores, and what it writes back of sensors.
fn with_values(scenario: &Scenario, values: &IndexMap<String, Value>) -> Result<Scenario, ScenarioError> {
    let described = || values.iter().map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ");
    let fault = |key: &str, message: String| scenario.fault(&["sweep", "vary", key], clean(&message), "this key");
    let mut table: Table = scenario.text.parse().map_err(|error| fault("", format!("{error}")))?;
    table.remove("sweep");
    table.remove("expected");
    for (key, value) in values {
        put(&mut table, key, value.clone()).map_err(|message| fault(key, message))?;
    }
    let last = values.keys().last().map_or("", String::as_str);
    let parse = |table: &Table| {
        let text = toml::to_string(table).map_err(|error| fault(last, error.to_string()))?;
        Scenario::parse(&scenario.path, &text)
            .map_err(|error| fault(last, format!("with {}: {}", described(), error.message())))
    };
    let own = parse(&table)?;
    match own.sensors.as_ref().filter(|sensors| sensors.writes.is_some()).map(|sensors| sensors.database.exists()) {
        None => return Ok(own),
        // A sweep writes nothing back.
        Some(true) => drop(table.get_mut("sensors").and_then(|sensors| sensors.as_table_mut()?.remove("writes"))),
        // Nothing is known yet.
        Some(false) => drop(table.remove("sensors")),
    }
    parse(&table)
}

/// Sets a dotted key, whose table must be there.
fn put(table: &mut Table, key: &str, value: Value) -> Result<(), String> {
    let (path, last) = key.rsplit_once('.').ok_or_else(|| format!("`{key}` is no key of a table"))?;
    let mut parts = path.split('.');
    let first = parts.next().unwrap_or_default();
    let mut place = table.get_mut(first).ok_or_else(|| format!("there is no [{first}] in this file"))?;
    let mut name = first.to_string();
    for part in parts {
        name = format!("{name}.{part}");
        place = inner(place, part).ok_or_else(|| format!("there is no [{name}] in this file"))?;
    }
    match place {
        Value::Table(table) => drop(table.insert(last.to_string(), value)),
        other => *inner(other, last).ok_or_else(|| format!("there is no `{key}` in this file"))? = value,
    }
    Ok(())
}

/// What a key of a table or a number of a list, from 0, leads to.
fn inner<'a>(value: &'a mut Value, key: &str) -> Option<&'a mut Value> {
    match value {
        Value::Table(table) => table.get_mut(key),
        Value::Array(array) => array.get_mut(key.parse::<usize>().ok()?),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn scenario(sweep: &str) -> Result<Scenario, ScenarioError> {
        let text = format!("{}\n{sweep}", include_str!("../../cli/template.toml"));
        Scenario::parse(Path::new("mine.toml"), &text)
    }

    fn of(sweep: &str) -> Result<Vec<Setting>, String> {
        let scenario = scenario(sweep).map_err(|error| error.to_string())?;
        settings(&scenario, None).map(|(_, settings)| settings).map_err(|error| error.to_string())
    }

    #[test]
    fn a_methods_own_keys_concern_it_alone_and_all_others_every_method() {
        let settings = of("[sweep.vary]\n\"methods.var.covariance_scale\" = [0.5, 2]\n\
                           \"networks.sondes.sigma_height_m\" = { from = 10, to = 20, count = 3 }\n\
                           \"background_error.components.0.length_km\" = [700]")
        .unwrap();
        let described: Vec<String> = settings
            .iter()
            .map(|own| {
                let values: Vec<String> = own.values.values().map(Value::to_string).collect();
                format!("{} {}", own.methods.join("+"), values.join(" "))
            })
            .collect();
        let expected = ["free+fkf 10 700", "var 10 700 0.5", "var 10 700 2", "free+fkf 15 700"];
        assert_eq!(described[..4], expected);
        assert_eq!((settings.len(), settings[8].directory.as_str()), (9, "setting-0009"));
        let own = &settings[8].scenario;
        let scale = |scenario: &Scenario| format!("{:?}", scenario.methods["var"].settings);
        assert!(scale(own).contains("covariance_scale: 2.0"), "{}", scale(own));
        assert!(
            own.text.contains("sigma_height_m = 20") && own.text.contains("length_km = 700") && own.sweep.is_none()
        );
    }

    #[test]
    fn ranges_keep_their_ends_and_whole_numbers() {
        let values = |range: &str| -> Vec<String> {
            let settings = of(&format!("[sweep.vary]\n\"methods.var.covariance_scale\" = {range}")).unwrap();
            settings.iter().flat_map(|own| own.values.values().map(Value::to_string)).collect()
        };
        assert_eq!(values("{ from = 0.1, to = 10, count = 3, spacing = \"logarithmic\" }"), ["0.1", "1.0", "10.0"]);
        assert_eq!(values("{ from = 1, to = 9, count = 3 }"), ["1", "5", "9"]);
        assert_eq!(values("{ from = 1, to = 2, count = 3 }"), ["1.0", "1.5", "2.0"]);
    }

    #[test]
    fn what_cannot_be_is_named() {
        for (sweep, expected) in [
            ("[sweep]\nseeds = 2", "`vary` is missing"),
            ("[sweep.vary]", "no key varies"),
            ("[sweep.vary]\n\"seed\" = [1]", "`seed` cannot vary"),
            ("[sweep.vary]\n\"methods.kv.covariance_scale\" = [1]", "there is no [methods.kv] in this file"),
            ("[sweep.vary]\n\"methods.var.covariance_scale\" = []", "has no values"),
            ("[sweep.vary]\n\"methods.var.covariance_scale\" = [1, -1]", "with methods.var.covariance_scale = -1: "),
            ("[sweep.vary]\n\"methods.var.scale\" = [1]", "unknown key `scale`"),
            ("[sweep.vary]\n\"background_error.components.4.length_km\" = [1]", "no [background_error.components.4]"),
            ("[sweep.vary]\n\"grid.dx_km\" = { from = 0, to = 1, count = 3, spacing = \"logarithmic\" }", "spaced"),
            ("", "a sweep needs [sweep]"),
        ] {
            let message = of(sweep).unwrap_err();
            assert!(message.contains(expected), "{sweep}: {message}");
        }
    }
}
