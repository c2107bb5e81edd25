//! Results do not hang on the last bit: a σ that is one unit in the last place larger changes no score by more than rounding
//! grows in a run. Where eigenvalues are equal, as those of sine and cosine on a periodic plane, only rounding says which
//! direction comes first.

use crate::runs::{run_options, scenarios};
use isobar::event::Event;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use isobar::scores::{MethodScores, Values};
use std::path::Path;

/// The largest shipped scenarios that are run, in cells.
const MOST_CELLS: usize = 200;

struct Deaf;

impl Sink for Deaf {
    fn record(&mut self, _: &Event<'_>) -> Result<(), SinkError> {
        Ok(())
    }
}

/// The scores of each method, but for its cost.
fn scores(scenario: &Scenario, cycles: usize) -> Vec<(String, Values)> {
    let directory = tempfile::tempdir().unwrap();
    let summary = isobar::run::run(scenario, &run_options(directory.path(), cycles), &mut Deaf).unwrap();
    let without_cost = |scores: &MethodScores| {
        assert_eq!(scores.failure, None);
        scores.all().into_iter().filter(|(key, _)| !key.contains("seconds")).collect()
    };
    summary.methods.iter().map(|(name, scores)| (name.clone(), without_cost(scores))).collect()
}

/// The scenario from the second cycle on, with the σ of the first error of the background one unit in the last place
/// larger or not; `None` if it gives no σ.
fn with_sigma(scenario: &Scenario, larger: bool) -> Option<Scenario> {
    let mut file: toml::Table = scenario.text.parse().unwrap();
    file["cycle"].as_table_mut()?.insert("score_from_cycle".into(), 2.into());
    let component = file.get_mut("background_error")?.get_mut("components")?.get_mut(0)?.as_table_mut()?;
    let key = ["sigma", "sigma_height_m"].into_iter().find(|key| component.contains_key(*key))?;
    let sigma = component[key].as_float().or_else(|| Some(component[key].as_integer()? as f64))?;
    component.insert(key.into(), toml::Value::Float(if larger { sigma.next_up() } else { sigma }));
    Some(Scenario::parse(&scenario.path, &toml::to_string(&file).unwrap()).unwrap())
}

/// The largest relative difference of scores in units of what is allowed, and the score: 1e-9, and 1e-5 where a minimisation
/// ends at a tolerance.
fn difference([first, second]: &[Scenario; 2], cycles: usize) -> (f64, String) {
    let (name, methods) = (&first.name, &first.methods);
    let [first, second] = [first, second].map(|scenario| scores(scenario, cycles));
    let mut largest = (0.0, String::new());
    for ((method, first), (_, second)) in first.iter().zip(&second) {
        assert!(!first.is_empty() && first.keys().eq(second.keys()), "{method}");
        for (key, value) in first {
            // Beside the size of the score, but not of one that is zero but for rounding.
            let allowed = if methods[method].kind.ends_with("var") { 1e-5 } else { 1e-9 };
            let found = (second[key] - value).abs() / value.abs().max(1e-6) / allowed;
            if found > largest.0 {
                largest = (found, format!("{name}: {method} {key}, {value}"));
            }
        }
    }
    largest
}

/// Whether the scenario has a σ, with which it was checked.
fn check(scenario: &Scenario, cycles: usize) -> bool {
    let [Some(first), Some(second)] = [false, true].map(|larger| with_sigma(scenario, larger)) else { return false };
    let (found, score) = difference(&[first, second], cycles);
    println!("{score}: {found:e}");
    assert!(found < 1.0, "{score}: {found:e}");
    true
}

#[test]
fn a_unit_in_the_last_place_changes_no_score_of_a_small_scenario() {
    let small = |scenario: &Scenario| scenario.grid.grid.cells() <= MOST_CELLS;
    let checked = scenarios().into_iter().filter(small).filter(|scenario| check(scenario, 3)).count();
    assert!(checked >= 3, "{checked}");
}

/// A periodic plane with stations on a regular grid: every wave has three others of its eigenvalue, for ever.
#[test]
fn nor_where_eigenvalues_are_equal_and_factors_are_cut_between_them() {
    let text = r#"
title = "A tracer"
phenomenon = "Equal eigenvalues"
source = "The tests"
seed = 1
start = "2026-01-15T00:00:00Z"
grid = { nx = 16, ny = 8, dx_km = 100, boundary = "periodic" }
model = { kind = "exact_shift", time_step_s = 3600, columns_per_step = 1 }
initial = { kind = "cosine_wave", amplitude = 1, waves_x = 2 }
background_error.components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 250 }]
model_error.components = [{ kind = "univariate", variable = "tracer", sigma = 0.05, length_km = 300 }]
cycle = { count = 8, window_hours = 3, score_from_cycle = 2 }

[networks.fixed]
kind = "radiosonde"
stations = { regular = [4, 2] }
groups = ["A", "B"]
reference_groups = ["A"]
observe = { tracer = 0.1 }
bias = [{ per = "group", variable = "tracer", value = 0.3, assumed_sigma = 0.3 }]

[methods.volume]
kind = "time_volume"
factors = 9
window_cycles = 4
observation_factors = [{ name = "daily", kind = "sinusoid", period_hours = 24, biases = ["fixed/tracer"] }]

[methods]
kf = { kind = "kf" }
"#;
    let mut text = text.to_string();
    for factors in 1..=12 {
        text += &format!("fkf_{factors} = {{ kind = \"fkf\", factors = {factors} }}\n");
    }
    for (name, rest) in [
        ("energy", "factors = { retained = 0.9, at_most = 40 }"),
        ("tiles", "blocks = { tile = [4, 4] }, factors = 6"),
        ("probes", "residual = \"probe\", probes = 4, factors = 18"),
    ] {
        text += &format!("{name} = {{ kind = \"fkf\", {rest} }}\n");
    }
    for (name, rest) in [
        ("local", "per_tile = 3, tile_km = 200"),
        ("narrow", "per_tile = 4, tile_km = 200, support_km = 400"),
        ("mixed", "per_tile = 5, tile_km = 200, mixed = 2"),
    ] {
        text += &format!("{name} = {{ kind = \"fkf\", local_factors = {{ {rest} }} }}\n");
    }
    for (name, kind, rest) in [
        ("etkf", "etkf", "members = 14"),
        ("etkf_large", "etkf", "members = 140, model_error_treatment = \"square_root\""),
        ("letkf", "letkf", "members = 9, localization_radius_km = 600"),
        ("enkf", "enkf", "members = 12, localization_radius_km = 600"),
        ("hybrid", "hybrid_3dvar", "members = 9, localization_radius_km = 600, ensemble_weight = 0.5"),
    ] {
        text += &format!("{name} = {{ kind = \"{kind}\", {rest}, initial_members = \"second_order_exact\" }}\n");
    }
    assert!(check(&Scenario::parse(Path::new("tracer.toml"), &text).unwrap(), 8));
}

/// A nonlinear model, in which the members themselves matter, not only their covariance.
#[test]
fn nor_in_a_nonlinear_model() {
    let text = r#"
title = "A jet"
phenomenon = "Equal eigenvalues"
source = "The tests"
seed = 1
start = "2026-01-15T00:00:00Z"
grid = { nx = 10, ny = 10, dx_km = 300, boundary = "periodic" }
model = { kind = "shallow_water", time_step_s = 1200, coriolis_per_s = 1e-4, hyperdiffusion_m4_per_s = 3e15 }
initial = { kind = "jet", mean_depth_m = 1000, speed_m_per_s = 20, width_km = 500 }
background_error.components = [
    { kind = "balanced", sigma_height_m = 20, length_km = 700 },
    { kind = "white", variable = "u", sigma = 0.2 },
]
model_error.components = [{ kind = "balanced", sigma_height_m = 1, length_km = 700 }]
cycle = { count = 6, window_hours = 3, score_from_cycle = 2 }

[networks.sondes]
kind = "radiosonde"
stations = { regular = [4, 4] }
groups = ["A", "B"]
reference_groups = ["A"]
sigma_height_m = 5
sigma_wind_m_per_s = 2
bias = [{ per = "group", variable = "h", sigma = 8 }]

[methods]
fkf_probes = { kind = "fkf", factors = 22 }
fkf_persisting = { kind = "fkf", factors = 21, residual = "persist" }
local = { kind = "fkf", local_factors = { per_tile = 6, tile_km = 700 } }
local_mixed = { kind = "fkf", local_factors = { per_tile = 6, tile_km = 600, support_km = 1200, mixed = 2 } }
etkf = { kind = "etkf", members = 15, initial_members = "second_order_exact" }
letkf = { kind = "letkf", members = 14, initial_members = "second_order_exact", localization_radius_km = 1200 }
"#;
    assert!(check(&Scenario::parse(Path::new("jet.toml"), text).unwrap(), 6));
}
