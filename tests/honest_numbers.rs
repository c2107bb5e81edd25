//! Runs whose numbers would be wrong say so, or end.

use crate::common::{TRACER, isobar, one_line, text};
use serde_json::Value;
use std::path::Path;

/// Observations of a file.
const STATIONS: &str = "[networks.stations]\nkind = \"file\"\nfile = \"observations.csv\"\n";

const WATER: &str = r#"
title = "Water at rest"
phenomenon = "Geostrophic adjustment"
source = "made up"
seed = 1
start = "2026-01-15T00:00:00Z"

[grid]
nx = 12
ny = 10
dx_km = 200
boundary = "channel"

[model]
kind = "shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4

[initial]
kind = "rest"
mean_depth_m = 2000

[background_error]
components = [{ kind = "balanced", sigma_height_m = 20, length_km = 800 }]

[cycle]
count = 1
window_hours = 6

[methods.free]
kind = "free"
"#;

/// What a run of a scenario, with a file of observations, came to: whether it succeeded, all that it said, its summary.
fn run(scenario: &str, observations: &str) -> (bool, String, Value) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("s.toml"), scenario).unwrap();
    std::fs::write(folder.path().join("observations.csv"), observations).unwrap();
    let arguments = ["run", "s.toml", "--threads", "1", "--out", "out", "--no-rerun"];
    let output = isobar(folder.path(), &arguments);
    let said = one_line(&(text(&output.stdout) + &text(&output.stderr)));
    let summary = std::fs::read_to_string(folder.path().join("out/s/summary.json")).unwrap_or("null".into());
    let report = std::fs::read_to_string(folder.path().join("out/s/report.html")).unwrap_or_default();
    assert!(!Path::new("out/s").exists());
    (output.status.success(), said + &report, serde_json::from_str(&summary).unwrap())
}

/// Values of a smooth field at 40 places.
fn smooth(sigma: f64) -> String {
    let row = |i: usize| {
        let (x, y) = ((37 * i % 160) as f64 * 1e4, (53 * i % 120) as f64 * 1e4);
        let value = (std::f64::consts::TAU * x / 1.6e6).sin() + 2.0 * (std::f64::consts::TAU * y / 1.2e6).cos();
        format!("1,{x},{y},{value},{sigma}\n")
    };
    "cycle,x_m,y_m,value,sigma\n".to_string() + &(0..40).map(row).collect::<String>()
}

fn parameter<'a>(summary: &'a Value, method: &str, name: &str) -> &'a Value {
    let all = summary["methods"][method]["parameters"].as_array().unwrap();
    all.iter().find(|it| it["name"] == name).unwrap()
}

#[test]
fn a_minimisation_that_is_cut_off_says_so_and_has_no_chi2() {
    let methods = r#"
[methods.oi]
kind = "optimal_interpolation"
[methods.cut]
kind = "3dvar"
max_iterations = 5
tolerance = 1e-12
[methods.var]
kind = "3dvar"
max_iterations = 2000
[methods.cut_four]
kind = "4dvar"
window_cycles = 1
max_iterations = 5
tolerance = 1e-12
[methods.cut_hybrid]
kind = "hybrid_3dvar"
ensemble_weight = 0.5
members = 10
localization_radius_km = 600
max_iterations = 3
tolerance = 1e-12
"#;
    let (ok, said, summary) = run(&(TRACER.to_string() + STATIONS + methods), &smooth(0.1));
    assert!(ok, "{said}");
    for cut in ["cut", "cut_four", "cut_hybrid"] {
        assert!(summary["methods"][cut]["innovation_chi2"].is_null(), "{cut}");
        assert!(said.contains(&format!("method {cut}, cycle 1: the minimisation has not converged")), "{said}");
        let gradient = parameter(&summary, cut, "minimiser/relative_gradient");
        assert!(
            gradient["value"].as_f64().unwrap() > 1e-4 && gradient["verdict"].as_str().unwrap().contains("not conv")
        );
        assert_eq!(parameter(&summary, cut, "minimiser/unconverged_analyses")["value"], 1.0);
    }
    assert_eq!(parameter(&summary, "cut", "minimiser/iterations")["value"], 5.0);
    assert_eq!(parameter(&summary, "var", "minimiser/unconverged_analyses")["value"], 0.0);
    let chi2 = |method: &str| summary["methods"][method]["innovation_chi2"].as_f64().unwrap();
    assert!((chi2("var") / chi2("oi") - 1.0).abs() < 1e-6, "{} and {}", chi2("var"), chi2("oi"));
    assert!(!said.contains("method var, cycle 1"), "{said}");
}

/// The tolerance is relative to a gradient that a prior makes as steep as it is wide.
#[test]
fn a_wide_prior_of_biases_does_not_end_the_minimisation() {
    let networks = r#"
[networks.fixed]
kind = "radiosonde"
stations = { regular = [5, 4] }
sigma_height_m = 12
[networks.biased]
kind = "radiosonde"
stations = { regular = [3, 3] }
groups = ["A", "B"]
sigma_height_m = 12
[[networks.biased.bias]]
per = "group"
variable = "h"
sigma = 20
assumed_sigma = 1e7
[methods.oi]
kind = "optimal_interpolation"
[methods.var]
kind = "3dvar"
max_iterations = 1000
"#;
    let (ok, said, summary) = run(&(WATER.to_string() + networks), "");
    assert!(ok, "{said}");
    let error = |method: &str| summary["methods"][method]["rmse_analysis"]["h"].as_f64().unwrap();
    let warned = said.contains("method var, cycle 1: the minimisation has not converged");
    assert!(warned || (error("var") / error("oi") - 1.0).abs() < 1e-2, "{} and {}", error("var"), error("oi"));
}

#[test]
fn a_time_step_that_a_restarted_leapfrog_cannot_have_is_refused() {
    let scenario = WATER
        .replace(
            "kind = \"shallow_water\"",
            "kind = \"linear_shallow_water\"\nmean_depth_m = 2000\ntime_scheme = \"leapfrog\"\nrobert_filter = 0.01",
        )
        .replace("mean_depth_m = 2000\n\n[background", "\n[background")
        .replace("window_hours = 6", "window_hours = 0.3333333333333333");
    let (ok, said, _) = run(&scenario, "");
    assert!(!ok && said.contains("time_step_s"), "{said}");
}

#[test]
fn balance_next_to_the_equator_is_refused_with_f_and_the_wind() {
    let slow = WATER.replace("coriolis_per_s = 1.0e-4", "coriolis_per_s = 3.0e-6");
    let (ok, said, _) = run(&slow, "");
    // 9.81 · 20 m / (3e-6 s⁻¹ · 800 km) = 81.75 m/s, the waves 140 m/s.
    assert!(!ok && said.contains("3.0e-6") && said.contains("81.7") && said.contains("140."), "{said}");
    let across = WATER.replace("coriolis_per_s = 1.0e-4", "coriolis_per_s = 1.0e-5\nbeta_per_m_per_s = 2.2e-11");
    let (ok, said, _) = run(&across, "");
    assert!(!ok && said.contains("-1.2e-5") && said.contains("3.2e-5") && said.contains("24.5"), "{said}");
    assert!(run(WATER, "").0);
}

/// Heights in decametres: 14 that are all a tenth of what they should be.
#[test]
fn observations_in_another_unit_are_named_and_impossible_states_fail_at_once() {
    let heights = |factor: f64| {
        let row = |i: usize| {
            let (x, y) = (150e3 + 160e3 * i as f64, 200e3 + 1e5 * (7 * i % 16) as f64);
            format!("1,{x},{y},h,{},12,S{i}\n", factor * (5500.0 + 3.0 * i as f64))
        };
        "cycle,x_m,y_m,variable,value,sigma,id\n".to_string() + &(0..14).map(row).collect::<String>()
    };
    let base = WATER
        .replace("mean_depth_m = 2000", "mean_depth_m = 5500")
        .replace("sigma_height_m = 20, length_km = 800", "sigma_height_m = 150, length_km = 500")
        + "[methods.oi]\nkind = \"optimal_interpolation\"\n[networks.stations]\nkind = \"file\"\nfile = \"observations.csv\"\n";
    for control in ["", "[quality_control]\n"] {
        let (_, said, _) = run(&(base.clone() + control), &heights(0.1));
        assert!(said.contains("cycle 1, stations/h: all 14 observations"), "{said}");
        assert!(said.contains("is it another unit?"), "{said}");
        let (ok, said, _) = run(&(base.clone() + control), &heights(1.0));
        assert!(ok && !said.contains("another unit"), "{said}");
    }
    // Without quality control they are believed, and what lies between them is extrapolated to below zero.
    let below = heights(0.0).replace(",0,12,", ",-3000,12,");
    let (ok, said, summary) = run(&base, &below);
    assert!(!ok && said.contains("oi: failed in cycle 1: the analysis is impossible"), "{said}");
    assert_eq!(summary["methods"]["oi"]["failure"]["cycle"], 1);
}
