//! What the user should know of the observations before a run.

use crate::kinds::methods::Method;
use crate::memory;
use crate::plot::with_unit;
use crate::run::reference::mean_variances;
use crate::scenario::Scenario;
use crate::tables::figure;
use crate::threshold_warning::{PlacedWarning, Side};
use isobar_assim::Problem;
use isobar_obs::{LeftOutStation, ObservingSystem, RecordedUse};

/// How many stations a warning names.
const MOST_NAMED: usize = 5;

/// What there is to know without being wrong: of each network that is read from a file how many of its observations can be
/// used, why the others cannot, and how many biases they have; which stations are withheld; which stations lie in the margin,
/// and which of a list that covers more than the domain lie outside of it.
pub(super) fn information(
    scenario: &Scenario,
    observing: &ObservingSystem,
    recorded: &[(&str, RecordedUse)],
) -> Vec<String> {
    let recorded = recorded.iter().flat_map(|(network, usage)| {
        let lines = std::iter::once(usage.to_string()).chain(usage.biases.iter().map(ToString::to_string));
        lines.map(|line| format!("networks.{network}: {line}")).collect::<Vec<_>>()
    });
    let places = [Place::Margin, Place::Beyond].map(|place| left_out(scenario, observing, place));
    let withheld = observing.withheld().map(|(network, withheld)| {
        let names: Vec<&str> = withheld.names.iter().take(MOST_NAMED).map(|name| &**name).collect();
        let more = if withheld.names.len() > MOST_NAMED { ", …" } else { "" };
        let (count, of, names) = (withheld.names.len(), withheld.of, names.join(", "));
        format!("networks.{network}: {count} of {of} stations are withheld from all methods: {names}{more}")
    });
    recorded.chain(withheld).chain(places.into_iter().flatten()).collect()
}

/// What the user should know of the chosen methods with this model.
pub(super) fn of_methods(scenario: &Scenario, chosen: impl Fn(&String) -> bool) -> Vec<String> {
    let chosen = scenario.methods.iter().filter(|(name, _)| chosen(name));
    let warning = |(name, method): (&String, &Method)| {
        Some(format!("methods.{name}: {}", method.settings.warning(&scenario.model)?))
    };
    chosen.filter_map(warning).collect()
}

/// The number of standard deviations beyond which no value is expected.
const BEYOND_SIGMAS: f64 = 5.0;

/// Warnings whose event almost never or almost always occurs: the first background is further from the threshold than five
/// times the root of the sum of its error variance and of its variability squared.
pub(super) fn of_thresholds(warnings: &[PlacedWarning], problem: &Problem) -> Vec<String> {
    let (background, layout) = (&problem.background, problem.background.layout());
    let variances =
        if warnings.is_empty() { Vec::new() } else { mean_variances(&*problem.background_error, background) };
    let notice = |placed: &PlacedWarning| {
        let warning = &placed.warning;
        let number = warning.variable;
        let margin = BEYOND_SIGMAS * (variances[number] + background.variability(number).powi(2)).sqrt();
        let of_points = || placed.points.iter().map(|&point| background.values()[point]);
        let most = of_points().map(|value| warning.side.beyond(value, warning.threshold)).fold(f64::MIN, f64::max);
        let what = if most < -margin {
            "never"
        } else if most > margin {
            "always"
        } else {
            return None;
        };
        let extreme = match warning.side {
            Side::Above => format!("at most {}", figure(of_points().fold(f64::MIN, f64::max))),
            Side::Below => format!("at least {}", figure(of_points().fold(f64::MAX, f64::min))),
        };
        let unit = layout.variables[number].unit;
        Some(format!(
            "warnings.{}: {} almost {what} occurs: the first background is {} there, and five standard deviations of its error \
             and variability are {}",
            warning.name,
            warning.describe(layout),
            with_unit(extreme, unit),
            with_unit(figure(margin), unit),
        ))
    };
    warnings.iter().filter_map(notice).collect()
}

/// What makes a run that ends with cycle `last` other than the user may think.
pub(super) fn warnings(
    scenario: &Scenario,
    observing: &ObservingSystem,
    recorded: &[(&str, RecordedUse)],
    last: usize,
) -> Vec<String> {
    let mut warnings = Vec::new();
    for (network, usage) in recorded.iter().filter(|(_, usage)| usage.usable < usage.rows) {
        let on_earth = usage.outside > 0 && usage.usable == 0 && scenario.grid.projection.is_some();
        let hint = if on_earth { "; latitudes are positive to the north, longitudes to the east" } else { "" };
        warnings.push(format!("networks.{network}: {usage}{hint}"));
    }
    warnings.extend(left_out(scenario, observing, Place::Outside));
    warnings.extend(hemisphere(scenario));
    warnings.extend(only_passive(scenario));
    warnings.extend(not_yet(scenario, last));
    warnings
}

/// Where stations are that do not report.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Outside, as most of the network: the domain or the list may be another one than was meant.
    Outside,
    /// Outside, as a few of a list that covers more than the domain.
    Beyond,
    /// In the margin that the scenario leaves free.
    Margin,
}

/// For each network the stations that are left out there.
fn left_out(scenario: &Scenario, observing: &ObservingSystem, place: Place) -> Vec<String> {
    let grid = &scenario.grid.grid;
    let is_inside = |station: &LeftOutStation| station.place_m.is_some_and(|(x_m, y_m)| grid.contains(x_m, y_m));
    let in_words = |network: &str| {
        let all = || observing.left_out().iter().filter(|station| *station.network == *network);
        let placed = observing.stations().iter().filter(|own| *own.network == *network).count();
        let (total, outside) = (placed + all().count(), all().filter(|station| !is_inside(station)).count());
        let of_outside = if 2 * outside >= total { Place::Outside } else { Place::Beyond };
        let place_of = |station: &LeftOutStation| if is_inside(station) { Place::Margin } else { of_outside };
        let own: Vec<&LeftOutStation> = all().filter(|station| place_of(station) == place).collect();
        let named = |station: &&LeftOutStation| match station.line {
            Some(line) => format!("{} (line {line})", station.name),
            None => station.name.to_string(),
        };
        let names: Vec<String> = own.iter().take(MOST_NAMED).map(named).collect();
        let more = if own.len() > MOST_NAMED { ", …" } else { "" };
        let text = match place {
            Place::Outside | Place::Beyond => "lie outside of the domain",
            Place::Margin => "are left out, nearer than edge_margin_km to the edges",
        };
        let (count, names) = (own.len(), names.join(", "));
        (count > 0).then(|| format!("networks.{network}: {count} of {total} stations {text}: {names}{more}"))
    };
    scenario.networks.iter().filter_map(|network| in_words(&network.name)).collect()
}

/// A warning if all methods together would need more memory than there is.
pub(super) fn memory(needed_bytes: f64) -> Option<String> {
    let available_bytes = memory::available_bytes()? as f64;
    let [needed, available] = [needed_bytes, available_bytes].map(memory::in_words);
    (needed_bytes > available_bytes).then(|| {
        format!("the methods would hold about {needed} at one time, and {available} are free: --methods chooses some")
    })
}

/// A warning if there are networks and none of them is assimilated.
fn only_passive(scenario: &Scenario) -> Option<String> {
    let all_passive = !scenario.networks.is_empty() && scenario.networks.iter().all(|network| !network.assimilate);
    all_passive.then(|| {
        "all networks are passive (`assimilate = false`): nothing is assimilated, and every analysis is its background"
            .to_string()
    })
}

/// A warning for each network whose first report comes after the last cycle.
fn not_yet(scenario: &Scenario, last: usize) -> impl Iterator<Item = String> {
    let late = scenario.networks.iter().filter(move |network| network.schedule.first_cycle > last);
    late.map(move |network| {
        let (name, first) = (&network.name, network.schedule.first_cycle);
        format!("networks.{name}: it never reports: its first report would be in cycle {first}, and the last cycle is {last}")
    })
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
