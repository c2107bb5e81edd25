//! What the user should know of the observations before a run.

use crate::kinds::methods::Method;
use crate::scenario::Scenario;
use isobar_obs::{LeftOutStation, ObservingSystem};

/// How many stations a warning names.
const MOST_NAMED: usize = 5;

/// For each network that is read from a file: how many of its observations can be used, and why the others cannot.
pub(super) fn recorded(observing: &ObservingSystem, cycles: usize) -> Vec<String> {
    observing.recorded_use(cycles).map(|(network, usage)| format!("networks.{network}: {usage}")).collect()
}

/// What the user should know of the chosen methods with this model.
pub(super) fn of_methods(scenario: &Scenario, chosen: impl Fn(&String) -> bool) -> Vec<String> {
    let chosen = scenario.methods.iter().filter(|(name, _)| chosen(name));
    let warning = |(name, method): (&String, &Method)| {
        Some(format!("methods.{name}: {}", method.settings.warning(&scenario.model)?))
    };
    chosen.filter_map(warning).collect()
}

/// What makes the run other than the user may think.
pub(super) fn warnings(scenario: &Scenario, observing: &ObservingSystem, cycles: usize) -> Vec<String> {
    let mut warnings = Vec::new();
    for (network, usage) in observing.recorded_use(cycles).filter(|(_, usage)| usage.usable < usage.rows) {
        let on_earth = usage.outside > 0 && usage.usable == 0 && scenario.grid.projection.is_some();
        let hint = if on_earth { "; latitudes are positive to the north, longitudes to the east" } else { "" };
        warnings.push(format!("networks.{network}: {usage}{hint}"));
    }
    for network in scenario.networks.iter().map(|network| network.name.as_str()) {
        let left_out: Vec<&LeftOutStation> =
            observing.left_out().iter().filter(|station| *station.network == *network).collect();
        if left_out.is_empty() {
            continue;
        }
        let all = left_out.len() + observing.stations().iter().filter(|own| *own.network == *network).count();
        let named = |station: &&LeftOutStation| match station.line {
            Some(line) => format!("{} (line {line})", station.name),
            None => station.name.to_string(),
        };
        let names: Vec<String> = left_out.iter().take(MOST_NAMED).map(named).collect();
        let more = if left_out.len() > MOST_NAMED { ", …" } else { "" };
        warnings.push(format!(
            "networks.{network}: {} of {all} stations lie outside of the domain or in its margin: {}{more}",
            left_out.len(),
            names.join(", ")
        ));
    }
    warnings.extend(hemisphere(scenario));
    warnings
}

/// A warning if the Coriolis parameter has the sign of the other hemisphere.
fn hemisphere(scenario: &Scenario) -> Option<String> {
    let latitude_deg = scenario.grid.projection.as_ref()?.center_latitude_deg;
    let f = scenario.model.equations.water()?.parameters.coriolis_per_s;
    (f * latitude_deg < 0.0).then(|| {
        format!(
            "model.coriolis_per_s = {f} has not the sign of grid.center_latitude_deg = {latitude_deg}: it is positive in \
             the north and negative in the south"
        )
    })
}
