//! What `isobar check` estimates of memory, beside what methods hold.

use crate::common::{VALID, isobar, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// A grid that is large enough for matrices to count, and a method of each kind that has matrices of its own.
const METHODS: &str = r#"
[methods.oi]
kind = "optimal_interpolation"
covariance_scale = 0.1
[methods.var]
kind = "3dvar"
covariance_scale = 0.1
[methods.window]
kind = "4dvar"
covariance_scale = 0.1
window_cycles = 2
[methods.kf]
kind = "kf"
[methods.serial]
kind = "serial_kf"
[methods.banded]
kind = "banded_kf"
half_bandwidth = 40
[methods.federated]
kind = "federated_kf"
[methods.federated_fast]
kind = "federated_fkf"
factors = 60
[methods.factors]
kind = "fkf"
factors = 60
[methods.tiles]
kind = "fkf"
blocks = { tile = [12, 8] }
factors = 0
[methods.etkf]
kind = "etkf"
members = 60
[methods.letkf]
kind = "letkf"
members = 40
localization_radius_km = 800
[methods.enkf]
kind = "enkf"
members = 60
"#;

/// Within this factor an estimate is right.
const FACTOR: f64 = 3.0;

#[test]
fn memory_is_as_estimated_within_a_factor() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let scenario = VALID.replace("nx = 8", "nx = 24").replace("ny = 6", "ny = 16").replace("count = 10", "count = 3");
    let scenario = scenario.replace("{ regular = [3, 2] }", "{ regular = [9, 6] }") + METHODS;
    fs::write(here.join("s.toml"), scenario).unwrap();
    let json = |arguments: &[&str]| -> Value {
        let output = isobar(here, arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let run = json(&["run", "s.toml", "--json", "--quiet", "--no-netcdf", "--no-report", "--no-rerun", "--no-state"]);
    let checked = json(&["check", "s.toml", "--json"]);
    let estimates = checked["scenarios"][0]["estimates"].as_array().unwrap();
    let mut wrong = Vec::new();
    for estimate in estimates {
        let is_memory = |row: &&Value| row["method"] == estimate["method"] && row["score"] == "peak_memory_bytes";
        let measured = run["runs"][0]["scores"].as_array().unwrap().iter().find(is_memory).unwrap();
        let (bytes, measured) = (estimate["memory_bytes"].as_f64().unwrap(), measured["value"].as_f64().unwrap());
        // What a small method holds is not in matrices.
        if measured > 2e5 && !(measured / FACTOR..measured * FACTOR).contains(&bytes) {
            wrong.push(format!("{}: {bytes} estimated, {measured} held", estimate["method"]));
        }
    }
    assert!(estimates.len() > 10 && wrong.is_empty(), "{wrong:#?}");
}

/// The biases of stations are in the blocks: they do not take a column of the state each. This scenario has thousands.
#[test]
fn thousands_of_station_biases_do_not_swell_the_estimate() {
    let output = isobar(Path::new(env!("CARGO_MANIFEST_DIR")), &["check", "million", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let checked: Value = serde_json::from_slice(&output.stdout).unwrap();
    let estimates = checked["scenarios"][0]["estimates"].as_array().unwrap();
    let filter = estimates.iter().find(|estimate| estimate["method"] == "fkf").unwrap();
    // Measured: 4.8 GB.
    let bytes = filter["memory_bytes"].as_f64().unwrap();
    assert!((4.8e9 / FACTOR..4.8e9 * FACTOR).contains(&bytes), "{bytes}");
}
