//! Worlds of recorded observations alone: nothing is scored against a truth that nobody has observed.

use crate::common::{isobar, one_line, text};
use netcdf_reader::NcFile;
use serde_json::Value;
use std::fs;
use std::path::Path;

pub const SCENARIO: &str = r#"
title = "Heights of three stations"
phenomenon = "One analysis"
source = "made up"
seed = 1
start = "2026-01-15T00:00:00Z"

[grid]
nx = 20
ny = 16
dx_km = 200
boundary = "channel"
center_latitude_deg = 50
center_longitude_deg = 10

[model]
kind = "linear_shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4
mean_depth_m = 5500

[initial]
kind = "rest"

[background_error]
components = [{ kind = "univariate", variable = "h", sigma = 150, length_km = 500 }]

[cycle]
count = 3
window_hours = 6

[networks.stations]
kind = "file"
file = "observations.csv"

[methods.oi]
kind = "optimal_interpolation"
[methods.etkf]
kind = "etkf"
members = 20
smoother_lag_cycles = 1
"#;

const OBSERVATIONS: &str = "cycle,latitude_deg,longitude_deg,variable,value,sigma,id
1,50.0,5.0,h,5380,12,A
1,47.0,15.0,h,5620,12,B
1,55.0,12.0,h,5300,12,C
2,50.0,5.0,h,5400,12,A
3,47.0,15.0,h,5590,12,B
";

pub fn folder(scenario: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("s.toml"), scenario).unwrap();
    fs::write(folder.path().join("observations.csv"), OBSERVATIONS).unwrap();
    folder
}

/// Runs the program, which succeeds; all that it says.
fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = isobar(folder, arguments);
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    said
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(file: &NcFile, name: &str) -> Vec<f64> {
    file.read_variable::<f64>(name).unwrap().iter().copied().collect()
}

const FILL_VALUE: f64 = 9.96921e36;

#[test]
fn departures_take_the_place_of_errors() {
    let folder = folder(SCENARIO);
    let said = succeeds(folder.path(), &["run", "s.toml", "--threads", "1", "--quiet"]);
    assert!(said.contains("departure of observations from background (O−B)") && !said.contains("error of"), "{said}");
    let out = folder.path().join("out/s");
    assert!(!out.join("truth.nc").exists());
    let file = NcFile::open(out.join("observations.nc")).unwrap();
    let background = numbers(&file, "background_departure_oi");
    assert!(background[..3].iter().zip([-120.0, 120.0, -200.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{background:?}");
    for name in ["true_bias", "value_bias_removed"] {
        assert_eq!(numbers(&file, name), [FILL_VALUE; 5], "{name}");
    }
    let source = file.global_attribute("source").unwrap().value.as_string().unwrap();
    assert!(source.ends_with("recorded observations: stations"), "{source}");
    let summary = json(&out.join("summary.json"));
    let analysis = numbers(&file, "analysis_departure_oi");
    for method in ["oi", "etkf"] {
        let own = summary["methods"][method].as_object().unwrap();
        let against_truth = own.keys().filter(|key| key.starts_with("rmse") || key.starts_with("bias_rmse"));
        assert_eq!(against_truth.count(), 0, "{own:?}");
        let diagnostics = &own["diagnostics"];
        assert!(diagnostics["state"].as_object().unwrap().is_empty() && diagnostics["error_reduction"].is_null());
    }
    let used = &summary["methods"]["oi"]["diagnostics"]["used"]["stations/h"];
    for (stage, departures) in [("background", &background), ("analysis", &analysis)] {
        let mean = departures.iter().sum::<f64>() / 5.0;
        let rms = (departures.iter().map(|d| d * d).sum::<f64>() / 5.0).sqrt();
        assert!((used[format!("{stage}_mean")].as_f64().unwrap() - mean).abs() < 1e-9);
        assert!((used[format!("{stage}_rms")].as_f64().unwrap() - rms).abs() < 1e-9);
        let score = summary["methods"]["oi"][format!("departure_{stage}")]["h"].as_f64().unwrap();
        assert!((score - rms).abs() < 1e-9);
    }
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    // What pictures are made of may spell anything.
    let report: String = report.split("base64,").map(|part| part.split_once('"').map_or(part, |it| it.1)).collect();
    for absent in ["Truth", "Coverage", "CRPS", "RMSE", "Impact of observations"] {
        assert!(!report.contains(absent), "{absent}");
    }
    let figures: Vec<String> = fs::read_dir(out.join("figures"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    assert!(figures.iter().any(|name| name.ends_with("_analysis.svg")), "{figures:?}");
    assert!(!figures.iter().any(|name| name.contains("truth") || name.contains("error")), "{figures:?}");
    let scores = fs::read_to_string(out.join("scores.csv")).unwrap();
    let header = scores.lines().next().unwrap();
    assert!(header.contains("departure_background h [m]") && !header.contains("rmse"), "{header}");
}

#[test]
fn seeds_sweeps_comparisons_and_accepted_scores_work_with_departures() {
    let sweep = "\n[sweep]\n[sweep.vary]\n\"methods.oi.covariance_scale\" = [0.5, 1]\n";
    let folder = folder(&format!("{SCENARIO}{sweep}"));
    let here = folder.path();
    let plain = ["--threads", "1", "--quiet", "--no-report", "--no-rerun", "--no-netcdf"];
    succeeds(here, &[&["run", "s.toml"][..], &plain].concat());
    succeeds(here, &[&["run", "s.toml", "--out", "other", "--methods", "oi"][..], &plain].concat());
    let compared = succeeds(here, &["compare", "out/s", "other/s", "--out", "compare.html"]);
    assert!(compared.contains("B oi − A oi") && compared.contains("O−B"), "{compared}");
    let seeds = succeeds(here, &["run", "s.toml", "--seeds", "3", "--out", "seeds", "--quiet"]);
    assert!(seeds.contains("O−B") && !seeds.contains("NaN"), "{seeds}");
    let swept = succeeds(here, &["sweep", "s.toml", "--out", "swept", "--quiet"]);
    assert!(swept.contains("departure_background.h") || swept.contains("O−B"), "{swept}");
    assert_eq!(json(&here.join("swept/s-sweep/sweep.json"))["score"], "departure_background.h");
    assert!(succeeds(here, &["diagnose", "--all", "out/s"]).contains("O−A rms"));
    fs::create_dir(here.join("scenarios")).unwrap();
    for name in ["s.toml", "observations.csv"] {
        fs::copy(here.join(name), here.join("scenarios").join(name)).unwrap();
    }
    succeeds(here, &["regress", "--accept", "s"]);
    let accepted = fs::read_to_string(here.join("scenarios/s.toml")).unwrap();
    assert!(accepted.contains("departure_analysis = { h = ") && !accepted.contains("rmse"), "{accepted}");
    succeeds(here, &["regress", "s"]);
}

#[test]
fn a_truth_that_cannot_be_is_refused_and_one_that_is_given_is_kept() {
    let check = |scenario: &str| {
        let folder = folder(scenario);
        let output = isobar(folder.path(), &["check", "s.toml"]);
        (output.status.success(), one_line(&(text(&output.stdout) + &text(&output.stderr))))
    };
    assert!(check(&format!("{SCENARIO}[truth]\nkind = \"none\"\n")).0);
    let (ok, said) = check(&format!("{SCENARIO}[truth]\nkind = \"none\"\nmodel_error_scale = 2\n"));
    assert!(!ok && said.contains("says something of a truth that is not there"), "{said}");
    let synthetic = "kind = \"radiosonde\"\nstations = { regular = [2, 2] }\nsigma_height_m = 9";
    let synthetic = SCENARIO.replace("kind = \"file\"\nfile = \"observations.csv\"", synthetic);
    let (ok, said) = check(&format!("{synthetic}[truth]\nkind = \"none\"\n"));
    assert!(!ok && said.contains("there is no truth that network stations could observe"), "{said}");
    let (ok, said) = check(&format!(
        "{SCENARIO}[sweep]\nscore = \"rmse_analysis.h\"\n[sweep.vary]\n\"methods.oi.covariance_scale\" = [1]\n"
    ));
    assert!(!ok && said.contains("cannot be \"rmse_analysis.h\""), "{said}");
    let folder = folder(&SCENARIO.replace("[methods.oi]", "[truth.initial]\nkind = \"rest\"\n\n[methods.oi]"));
    let exact = isobar(folder.path(), &["exact", "s.toml"]);
    assert!(!exact.status.success());
    succeeds(folder.path(), &["run", "s.toml", "--threads", "1", "--quiet", "--no-rerun", "--methods", "oi"]);
    let own = &json(&folder.path().join("out/s/summary.json"))["methods"]["oi"];
    assert!(own["rmse_analysis"]["h"].as_f64().is_some() && own.get("departure_analysis").is_none(), "{own}");
    assert!(folder.path().join("out/s/truth.nc").exists());
}

#[test]
fn exact_performance_without_a_truth_is_refused_by_name() {
    let folder = folder(SCENARIO);
    let output = isobar(folder.path(), &["exact", "s.toml"]);
    let said = one_line(&text(&output.stderr));
    assert!(!output.status.success() && said.contains("all observations are recorded"), "{said}");
}

#[test]
fn a_run_without_a_truth_can_be_interrupted() {
    let folder = folder(SCENARIO);
    let plain = ["--threads", "1", "--quiet", "--no-report", "--no-rerun"];
    succeeds(folder.path(), &[&["run", "s.toml"][..], &plain].concat());
    let scenario = isobar::scenario::Scenario::load(&folder.path().join("s.toml")).unwrap();
    let options = |resume| isobar::options::RunOptions {
        threads: Some(1),
        checkpoints: Some(isobar::options::CheckpointPolicy { minutes: None, cycles: Some(1) }),
        resume,
        ..isobar::options::RunOptions::new(folder.path().join("again"))
    };
    let mut stop = StopAfter(2);
    isobar::run::run(&scenario, &options(false), &mut stop).unwrap_err();
    let summary = isobar::run::run(&scenario, &options(true), &mut StopAfter(usize::MAX)).unwrap();
    let whole = json(&folder.path().join("out/s/summary.json"));
    for score in ["departure_background", "departure_analysis", "spread_analysis"] {
        let found = summary.methods["etkf"].values[&format!("{score}.h")];
        assert_eq!(found, whole["methods"]["etkf"][score]["h"].as_f64().unwrap(), "{score}");
    }
}

/// Hears the events of a run, and fails after a cycle.
struct StopAfter(usize);

impl isobar::output::Sink for StopAfter {
    fn record(&mut self, event: &isobar::event::Event<'_>) -> Result<(), isobar::output::SinkError> {
        match event {
            isobar::event::Event::Truth { .. } => panic!("there is no truth"),
            isobar::event::Event::Analysed(analysed) if analysed.cycle > self.0 => {
                Err(isobar::output::SinkError { path: "here".into(), reason: "enough".into() })
            }
            _ => Ok(()),
        }
    }
}
