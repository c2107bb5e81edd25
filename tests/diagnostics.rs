//! Diagnostics of whole runs, on known answers.

use crate::common::{isobar, text};
use crate::runs::run_options;
use isobar::event::Event;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use std::fs;
use std::path::Path;

/// A tracer on a plane of 9 × 9 cells with a station at the centre of the middle one, and what `more` adds.
fn scenario(stations: &str, more: &str) -> String {
    format!(
        r#"
title = "A tracer"
phenomenon = "None"
source = "The tests"
seed = 3
start = "2026-01-15T00:00:00Z"
[grid]
nx = 9
ny = 9
dx_km = 100
boundary = "periodic"
[model]
kind = "exact_shift"
time_step_s = 3600
columns_per_step = 1
[initial]
kind = "cosine_wave"
amplitude = 1
waves_x = 2
[background_error]
components = [{{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 200 }}]
[model_error]
components = [{{ kind = "univariate", variable = "tracer", sigma = 0.2, length_km = 200 }}]
[cycle]
count = 30
window_hours = 3
score_from_cycle = 5
[networks.fixed]
kind = "radiosonde"
stations = {{ regular = {stations} }}
groups = ["A"]
observe = {{ tracer = 0.3 }}
{more}
[methods.kf]
kind = "kf"
"#
    )
}

const INFLUENCE: &str = "[diagnostics]\ninfluence_every_cycles = 1\n";

/// The claimed background variance of the middle cell in every cycle.
#[derive(Default)]
struct Variances(Vec<f64>);

impl Sink for Variances {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        if let Event::Analysed(analysed) = event {
            self.0.push(analysed.background.state_spread.as_ref().unwrap()[4 * 9 + 4].powi(2));
        }
        Ok(())
    }
}

fn run(text: &str, listener: &mut dyn Sink) -> Summary {
    let scenario = Scenario::parse(Path::new("tracer.toml"), text).unwrap();
    let directory = tempfile::tempdir().unwrap();
    isobar::run::run(&scenario, &run_options(directory.path(), 30), listener).unwrap()
}

/// One observation of one cell has p/(p + r) degrees of freedom for signal.
#[test]
fn the_signal_of_one_observation_is_its_weight() {
    let mut variances = Variances::default();
    let summary = run(&scenario("[1, 1]", INFLUENCE), &mut variances);
    let diagnostics = summary.methods["kf"].diagnostics.as_ref().unwrap();
    let own = &diagnostics.observations["fixed/tracer"];
    let scored = &variances.0[4..];
    let expected = scored.iter().map(|p| p / (p + 0.09)).sum::<f64>() / scored.len() as f64;
    assert!((own.signal.unwrap() / expected - 1.0).abs() < 1e-9, "{:?}, {expected}", own.signal);
    assert!(own.count == 26 && (own.sigma_assumed - 0.3).abs() < 1e-12);
}

const OTHERS: &str = r#"
[[networks.fixed.bias]]
per = "group"
variable = "tracer"
value = 0.1
assumed_sigma = 0.3
[networks.polar]
kind = "satellite"
variable = "tracer"
sigma = 0.4
swath_width_km = 300
scan_positions = 3
along_track_spacing_km = 200
footprint_sigma_km = 80
[diagnostics]
influence_every_cycles = 1
[methods.var]
kind = "3dvar"
[methods.oi]
kind = "optimal_interpolation"
[methods.fkf]
kind = "fkf"
blocks = "cell"
factors = 10
[methods.etkf]
kind = "etkf"
members = 20
[methods.letkf]
kind = "letkf"
members = 20
localization_radius_km = 300
[methods.free]
kind = "free"
"#;

#[test]
fn the_impacts_of_all_types_are_what_the_analysis_takes_off_the_error() {
    let summary = run(&scenario("[3, 3]", OTHERS), &mut Deaf);
    let mut seen = 0;
    for (name, scores) in &summary.methods {
        let diagnostics = scores.diagnostics.as_ref().unwrap();
        let reduction = diagnostics.error_reduction.as_ref().unwrap()["tracer"];
        let (before, after) = (scores.values["rmse_background.tracer"], scores.values["rmse_analysis.tracer"]);
        let expected = before * before - after * after;
        assert!((reduction - expected).abs() < 1e-9, "{name}: {reduction}, {expected}");
        let impacts = diagnostics.observations.values().map(|own| own.impact.as_ref().unwrap()["tracer"]);
        let sum: f64 = impacts.sum();
        assert!((sum - expected).abs() < 1e-6 * before * before, "{name}: {sum}, {expected}");
        if name != "free" {
            assert!(expected > 0.0 && diagnostics.observations.len() == 2, "{name}");
            seen += 1;
        }
    }
    assert_eq!(seen, 6);
    // A filter that knows all covariances finds them again, and knows how well it knows the bias.
    let kf = summary.methods["kf"].diagnostics.as_ref().unwrap();
    for own in kf.observations.values() {
        assert!((own.sigma_observation.unwrap() / own.sigma_assumed - 1.0).abs() < 0.1, "{own:?}");
        let signals = own.signal_from_departures / own.signal.unwrap();
        assert!((signals - 1.0).abs() < 0.3, "{own:?}");
    }
    assert!(kf.biases["fixed/tracer/A"].normalised_rmse.unwrap() < 3.0);
    assert!((kf.state["tracer"].coverage_95.unwrap() - 0.95).abs() < 0.02);
    let counts = &summary.observations.by_type;
    assert_eq!(counts.values().map(|own| own.used).sum::<usize>(), summary.observations.used);
}

/// Hears nothing.
struct Deaf;

impl Sink for Deaf {
    fn record(&mut self, _: &Event<'_>) -> Result<(), SinkError> {
        Ok(())
    }
}

#[test]
fn what_is_found_out_changes_no_score() {
    let with = scenario("[3, 3]", OTHERS);
    let without = with.replace(INFLUENCE, "");
    assert_ne!(with, without);
    let scores = |text: &str| {
        let mut summary = run(text, &mut Deaf);
        for scores in summary.methods.values_mut() {
            scores.values.retain(|key, _| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()));
            scores.diagnostics = None;
        }
        summary.methods
    };
    assert_eq!(scores(&with), scores(&without));
}

#[test]
fn a_run_is_diagnosed_and_what_is_none_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    fs::write(here.join("tracer.toml"), scenario("[3, 3]", OTHERS)).unwrap();
    let output = isobar(here, &["run", "tracer.toml", "--quiet", "--no-rerun", "--no-netcdf"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let short = text(&isobar(here, &["diagnose", "out/tracer"]).stdout);
    let worst = short.split("Biases with the largest errors").nth(1).unwrap_or_else(|| panic!("{short}"));
    let beyond: Vec<f64> = worst.lines().filter_map(|line| line.split_whitespace().last()?.parse().ok()).collect();
    assert!((1..=5).contains(&beyond.len()) && beyond.is_sorted_by(|a, b| a >= b), "the worst are first: {short}");
    assert!(short.lines().count() < 40 && short.contains("`isobar diagnose --all out/tracer`"), "{short}");
    let output = isobar(here, &["diagnose", "--all", "out/tracer"]);
    let said = text(&output.stdout);
    let titles = [
        "Claimed distributions",
        "What departures tell",
        "Impact of observations",
        "Calibration of bias errors",
        "Error of each bias",
        "Quality control",
    ];
    for title in titles {
        assert!(said.contains(title), "{title} is missing: {said}");
    }
    assert!(said.lines().all(|line| line.chars().count() <= 100), "{said}");
    assert!(said.find("its claimed spread is ").unwrap() < said.find(titles[0]).unwrap(), "{said}");
    let page = fs::read_to_string(here.join("out/tracer/report.html")).unwrap();
    assert!(titles.iter().all(|title| page.contains(title)) && page.contains("Rank histogram"));
    let output = isobar(here, &["diagnose", "out"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("summary.json"));
    let wrong = scenario("[3, 3]", "[diagnostics]\ninfluence_every_cycles = 0\n");
    fs::write(here.join("wrong.toml"), wrong).unwrap();
    let said = text(&isobar(here, &["check", "wrong.toml"]).stderr);
    assert!(said.contains("diagnostics.influence_every_cycles") && said.contains("from 1 to"), "{said}");
}
