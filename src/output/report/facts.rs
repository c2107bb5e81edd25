//! What was run, in short: from the run's facts, and from the scenario's text where they do not tell.

use crate::calendar::utc;
use crate::event::RunInfo;
use crate::plot::{number, unit};
use crate::scores::Summary;
use crate::text::counted;
use isobar_model::Boundary;
use toml::{Table, Value};

/// The facts: what each is about, and what it says.
pub fn facts(info: &RunInfo, summary: &Summary) -> Vec<(String, String)> {
    let scenario: Table = info.scenario_text.parse().unwrap_or_default();
    let mut facts: Vec<(String, String)> = Vec::new();
    let mut add = |name: &str, text: Option<String>| facts.extend(text.map(|text| (name.to_string(), text)));
    add("phenomenon", text(&scenario, "phenomenon"));
    add("source", text(&scenario, "source"));
    add("grid", Some(grid(info)));
    add("model", scenario.get("model").and_then(Value::as_table).map(settings));
    add("observations", networks(&scenario));
    add("stations and files", (!info.notes.is_empty()).then(|| info.notes.join("; ")));
    let no_truth = "all observations are recorded: methods are judged by departures of observations, with no truth";
    add("truth", (!info.has_truth).then(|| no_truth.to_string()));
    add("truth", info.truth_file.as_ref().map(|file| format!("the states of {file}")));
    add("quality control", summary.observations.describe_rejected());
    let parameters = info.calibration.len();
    add("biases", (parameters > 0).then(|| format!("{parameters} unknown parameters")));
    let end = info.time(info.cycles);
    let hours = number(info.window.hours());
    add("time", Some(format!("{} cycles of {hours} h, {} to {}", info.count(), utc(info.begin()), utc(end))));
    let earlier = || format!("from {} cycles of earlier runs, since {}", info.done, utc(info.start));
    add("goes on", (info.done > 0).then(earlier));
    add("scores", Some(format!("over cycles {} to {}", summary.scored_from_cycle, summary.cycles)));
    add("seed", Some(info.seed.to_string()));
    add("version", Some(format!("isobar {}", summary.version)));
    facts
}

fn text(table: &Table, key: &str) -> Option<String> {
    table.get(key)?.as_str().map(String::from)
}

fn grid(info: &RunInfo) -> String {
    let grid = &info.layout.grid;
    let [dx, dy] = [grid.dx_m, grid.dy_m].map(|metres| number(metres / 1000.0));
    let edges = match grid.boundary {
        Boundary::Periodic => "doubly periodic",
        Boundary::Channel => "a channel between walls in the south and the north",
    };
    let variables: Vec<String> =
        info.layout.variables.iter().map(|it| format!("{} ({} [{}])", it.name, it.long_name, unit(it.unit))).collect();
    format!("{} × {} cells of {dx} × {dy} km, {edges}; {}", grid.nx, grid.ny, variables.join(", "))
}

/// The settings of a table that are not tables themselves: `shallow_water, time_step_s = 1200, …`.
fn settings(table: &Table) -> String {
    let kind = table.get("kind").and_then(Value::as_str).map(String::from);
    let rest = table.iter().filter(|(key, value)| *key != "kind" && !value.is_table() && !value.is_array());
    kind.into_iter()
        .chain(rest.map(|(key, value)| match value {
            Value::Float(value) => format!("{key} = {}", number(*value)),
            Value::String(value) => format!("{key} = {value}"),
            value => format!("{key} = {value}"),
        }))
        .collect::<Vec<_>>()
        .join(", ")
}

fn networks(scenario: &Table) -> Option<String> {
    let networks = scenario.get("networks")?.as_table()?;
    let describe = |(name, network): (&String, &Value)| {
        let network = network.as_table()?;
        let biases = network.get("bias").and_then(Value::as_array).map_or(0, Vec::len);
        let biases = if biases > 0 { format!(", with {} of bias", counted(biases, "kind")) } else { String::new() };
        Some(format!("{name} ({}{biases})", network.get("kind")?.as_str()?))
    };
    let all: Vec<String> = networks.iter().filter_map(describe).collect();
    (!all.is_empty()).then(|| all.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_is_put_in_words_and_a_broken_one_is_left_out() {
        let text = "[model]\nkind = \"shallow_water\"\nstep = 3\n[networks.a]\nkind = \"satellite\"\nbias = [{}, {}]\n";
        let scenario: Table = text.parse().unwrap();
        assert_eq!(settings(scenario["model"].as_table().unwrap()), "shallow_water, step = 3");
        assert_eq!(networks(&scenario).as_deref(), Some("a (satellite, with 2 kinds of bias)"));
        assert_eq!(networks(&Table::new()), None);
    }
}
