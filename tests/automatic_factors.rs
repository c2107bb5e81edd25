//! `factors = "auto"`: what it chooses, says and is worth.

use crate::runs::run_options;
use isobar::event::Event;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use std::path::Path;

struct Deaf;

impl Sink for Deaf {
    fn record(&mut self, _: &Event<'_>) -> Result<(), SinkError> {
        Ok(())
    }
}

const BALANCED: &str = r#"{ kind = "balanced", sigma_height_m = 10, length_km = 700 }"#;
const WHITE: &str = r#"{ kind = "white", variable = "u", sigma = 0.2 }"#;

/// A linear model on a plane of `n` × `n` cells of 250 km, with this component of B and Q, beside something white.
fn text(n: usize, component: &str, methods: &str) -> String {
    format!(
        r#"
title = "Factors"
phenomenon = "How many there should be"
source = "The tests"
seed = 1
start = "2026-01-15T00:00:00Z"
grid = {{ nx = {n}, ny = {n}, dx_km = 250, boundary = "periodic" }}
initial = {{ kind = "rest" }}
background_error.components = [{component}, {WHITE}]
model_error.components = [{component}, {WHITE}]
cycle = {{ count = 12, window_hours = 3, score_from_cycle = 4 }}

[model]
kind = "linear_shallow_water"
time_step_s = 900
coriolis_per_s = 1e-4
mean_depth_m = 1000
mean_flow_m_per_s = 20

[networks.sondes]
kind = "radiosonde"
stations = {{ random = 12 }}
sigma_height_m = 5
sigma_wind_m_per_s = 2

[methods]
{methods}
"#
    )
}

fn parse(text: &str) -> Scenario {
    Scenario::parse(Path::new("factors.toml"), text).unwrap()
}

fn scenario(n: usize, component: &str, methods: &str) -> Scenario {
    parse(&text(n, component, methods))
}

fn description(n: usize, component: &str, rest: &str) -> String {
    scenario(n, component, &format!("own = {{ kind = \"fkf\", factors = \"auto\"{rest} }}")).methods["own"].describe()
}

#[test]
fn it_says_what_it_chose() {
    let white = description(10, WHITE, "");
    assert!(white.contains("0 common factors (B and Q ask for 0)"), "{white}");
    let number = |length_km: usize| -> usize {
        let words = description(10, &BALANCED.replace("700", &length_km.to_string()), "");
        words.split("ask for ").nth(1).unwrap().split(')').next().unwrap().parse().unwrap()
    };
    // In proportion to area / L², but for what a domain of few lengths has.
    let numbers = [500, 700, 1000].map(number);
    assert!(numbers.is_sorted_by(|a, b| a > b) && (25..=60).contains(&numbers[1]), "{numbers:?}");
    let large = description(40, BALANCED, "");
    assert!(large.contains("8 factors on each tile of 1400 km") && large.contains("in place of"), "{large}");
    for (keys, words) in [
        (", factor_precision = \"single\"", "cut off beyond 4 tiles in single precision, in place of"),
        (", factor_grid = 2", "cut off beyond 4 tiles on a grid 2 times as wide, in place of"),
        (", smoother_lag_cycles = 3", "8 factors on each tile of 1400 km"),
    ] {
        let local = description(40, BALANCED, keys);
        assert!(local.contains(words), "{keys}: {local}");
    }
    // Supports of 5600 km lose what travels further than 2100 km in a cycle: waves of 210 m/s, but not of 100 m/s, and a flow of 20 m/s.
    let text = text(40, BALANCED, "own = { kind = \"fkf\" }");
    for (depth_m, is_local) in [(1000, true), (2900, true), (3200, false)] {
        let deep = parse(&text.replace("mean_depth_m = 1000", &format!("mean_depth_m = {depth_m}")));
        assert_eq!(deep.methods["own"].describe().contains("factors on each tile"), is_local, "{depth_m}");
    }
    // What belongs to factors of the whole domain keeps them.
    let whole = description(40, BALANCED, ", separator_factors = 50");
    assert!(whole.contains("common factors (B and Q ask for "), "{whole}");
}

/// The key left out: `"auto"` for blocks of a cell, which need factors, and none where blocks do without.
#[test]
fn it_is_the_default_where_blocks_need_factors() {
    let described =
        |keys: &str| scenario(10, BALANCED, &format!("own = {{ kind = \"fkf\"{keys} }}")).methods["own"].describe();
    let default = described("");
    assert!(default.contains("(B and Q ask for "), "{default}");
    for keys in [
        ", blocks = { tile = [5, 5] }",
        ", blocks = \"domain\"",
        ", residual = \"exact\"",
        ", bias_coupling = \"drop\"",
    ] {
        let without = described(keys);
        assert!(without.contains("0 common factors") && !without.contains("ask for"), "{keys}: {without}");
    }
    let asked = described(", blocks = { tile = [5, 5] }, factors = 7");
    assert!(asked.contains("7 common factors"), "{asked}");
}

#[test]
fn it_is_within_two_percent_of_the_best_fixed_number() {
    let fixed = [10, 20, 40, 80, 160];
    let methods: String = fixed.iter().map(|r| format!("r{r} = {{ kind = \"fkf\", factors = {r} }}\n")).collect();
    let scenario = scenario(10, BALANCED, &format!("{methods}auto = {{ kind = \"fkf\", factors = \"auto\" }}"));
    let directory = tempfile::tempdir().unwrap();
    let summary = isobar::run::run(&scenario, &run_options(directory.path(), 12), &mut Deaf).unwrap();
    let error = |name: &str| summary.methods[name].all()["rmse_analysis.h"];
    let best = fixed.iter().map(|r| error(&format!("r{r}"))).fold(f64::INFINITY, f64::min);
    assert!(error("auto") < 1.02 * best, "{} {best}", error("auto"));
    assert!(error("r10") > 1.02 * best, "the number does not matter: {} {best}", error("r10"));
}
