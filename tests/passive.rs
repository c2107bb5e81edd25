//! Passive networks: their departures are known, and nothing else depends on them.

use crate::common::{TRACER, isobar, one_line, text};
use crate::runs::run_options;
use isobar::output::Sink;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::{Against, MethodScores, Summary, kind};
use netcdf_reader::NcFile;
use std::path::Path;

/// Every kind of method, with what there is around them.
pub const METHODS: &str = r#"
[methods.free]
kind = "free"
[methods.climatology]
kind = "climatology"
[methods.oi]
kind = "optimal_interpolation"
adapt = { observation_error = true, background_error = true }
[methods.var]
kind = "3dvar"
[methods.four]
kind = "4dvar"
window_cycles = 2
[methods.hybrid]
kind = "hybrid_3dvar"
members = 6
localization_radius_km = 900
ensemble_weight = 0.5
[methods.kf]
kind = "kf"
smoother_lag_cycles = 2
[methods.adaptive]
kind = "kf"
adapt = { observation_error = true, model_error = true }
[methods.serial]
kind = "serial_kf"
[methods.banded]
kind = "banded_kf"
half_bandwidth = 40
[methods.federated]
kind = "federated_kf"
[methods.fkf]
kind = "fkf"
blocks = { tile = [2, 2] }
factors = 6
[methods.window]
kind = "time_volume"
blocks = "domain"
window_cycles = 3
model_factors = [{ name = "mean", kind = "constant", variable = "tracer" }]
[methods.etkf]
kind = "etkf"
members = 8
inflation = "adaptive"
smoother_lag_cycles = 2
[methods.letkf]
kind = "letkf"
members = 8
localization_radius_km = 900
[methods.enkf]
kind = "enkf"
members = 8
localization_radius_km = 900
"#;

pub const WORLD: &str = r#"
title = "Tracer in a box"
phenomenon = "Advection"
source = "made up"
seed = 5
start = "2026-01-15T00:00:00Z"

[grid]
nx = 10
ny = 6
dx_km = 100
boundary = "periodic"

[model]
kind = "exact_shift"
time_step_s = 3600
columns_per_step = 1

[initial]
kind = "cosine_wave"
amplitude = 1

[background_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 200 }, { kind = "white", variable = "tracer", sigma = 0.05 }]

[model_error]
components = [{ kind = "white", variable = "tracer", sigma = 0.1 }]

[cycle]
count = 6
window_hours = 3

[quality_control]

[diagnostics]
influence_every_cycles = 2

[networks.fixed]
kind = "radiosonde"
stations = { regular = [4, 3] }
groups = ["A", "B"]
reference_groups = ["A"]
observe = { tracer = 0.1 }
faults = { gross_error_rate = 0.05 }

[[networks.fixed.bias]]
per = "group"
variable = "tracer"
sigma = 0.3
"#;

pub const PASSIVE: &str = r#"
[networks.seen]
kind = "radiosonde"
stations = { random = 25 }
observe = { tracer = 0.2 }
faults = { gross_error_rate = 0.3, gross_error_factor = 300 }
assimilate = false
"#;

/// The summary of a run.
pub fn summary(text: &str) -> Summary {
    let scenario = Scenario::parse(Path::new("s.toml"), text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut listener: Vec<Box<dyn Sink>> = Vec::new();
    run(&scenario, &run_options(folder.path(), scenario.cycle.count), &mut listener).unwrap()
}

/// The scores of a method without its cost and those against passive observations.
fn own(scores: &MethodScores) -> MethodScores {
    let mut own = scores.clone();
    own.values.retain(|key, _| {
        let kind = kind(key.split('.').next().unwrap()).unwrap();
        kind.regressed && kind.against != Against::Passive
    });
    own.intervals.retain(|key, _| !key.starts_with("passive"));
    own.diagnostics.as_mut().unwrap().passive.clear();
    own
}

#[test]
fn every_method_is_the_same_with_a_passive_network_and_without() {
    let without = summary(&format!("{WORLD}{METHODS}"));
    // First and last among the networks.
    for with in [
        format!("{}{PASSIVE}{METHODS}", WORLD),
        WORLD.replace("[networks.fixed]", &format!("{PASSIVE}\n[networks.fixed]")) + METHODS,
    ] {
        let with = summary(&with);
        assert_eq!(with.methods.len(), 16);
        assert_eq!(with.failures().count(), 0, "{:?}", with.failures().collect::<Vec<_>>());
        for (name, scores) in &with.methods {
            assert_eq!(own(scores), own(&without.methods[name]), "{name}");
            let passive = scores.diagnostics.as_ref().unwrap().passive["seen/tracer"];
            assert!(passive.count > 60, "{name}: {passive:?}");
            let value = |stage: &str| scores.values[&format!("passive_departure_{stage}.tracer")];
            assert_eq!((value("background"), value("analysis")), (passive.background_rms, passive.analysis_rms));
        }
        let rms = |name: &str| with.methods[name].values["passive_departure_analysis.tracer"];
        assert!(
            rms("kf") < 0.8 * rms("free"),
            "a better analysis is nearer to what it has not seen: {} {}",
            rms("kf"),
            rms("free")
        );
        let (with, without) = (&with.observations, &without.observations);
        assert_eq!((with.used, &with.by_type["fixed/tracer"]), (without.used, &without.by_type["fixed/tracer"]));
        assert_eq!(with.by_type["seen/tracer"].used, 0);
        let rejected: usize = with.by_type["seen/tracer"].rejected.values().sum();
        assert!(with.passive > 60 && rejected > 10, "{with:?}");
    }
}

/// Two observations that are used and two that are compared, where errors of different places have nothing in common.
fn small() -> String {
    let smooth = "kind = \"univariate\", variable = \"tracer\", sigma = 1, length_km = 200";
    assert!(TRACER.contains(smooth));
    TRACER.replace(smooth, "kind = \"white\", variable = \"tracer\", sigma = 2") + SMALL_NETWORKS
}

const SMALL_NETWORKS: &str = r#"[networks.used]
kind = "file"
file = "used.csv"
sigma = 1

[networks.seen]
kind = "file"
file = "seen.csv"
sigma = 1
assimilate = false

[methods.oi]
kind = "optimal_interpolation"
[methods.var]
kind = "3dvar"
tolerance = 1e-12
[methods.kf]
kind = "kf"
"#;

fn folder(scenario: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, contents) in [
        ("s.toml", scenario),
        ("used.csv", "cycle,column,row,value,id\n1,4,5,3,A\n1,9,5,1,B\n"),
        ("seen.csv", "cycle,column,row,value,id\n1,4,5,5,C\n1,14,2,-6,D\n"),
    ] {
        std::fs::write(folder.path().join(name), contents).unwrap();
    }
    folder
}

fn observations(folder: &Path) -> NcFile {
    NcFile::open(folder.join("out/s/observations.nc")).unwrap()
}

const RUN: [&str; 6] = ["run", "s.toml", "--threads", "1", "--no-rerun", "--quiet"];

/// With white B (σ 2) and σ 1 the gain is 4/5: 2.4 at A, 0.8 at B; χ²/n is (3² + 1²)/(4 + 1)/2.
#[test]
fn departures_of_passive_observations_are_those_from_the_analysis_of_the_others() {
    let folder = folder(&small());
    let output = isobar(folder.path(), &RUN);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("O−A passive") && !said.contains("Root-mean-square error"), "{said}");
    let file = observations(folder.path());
    for method in ["oi", "var", "kf"] {
        for (stage, wanted) in [("background", [3.0, 1.0, 5.0, -6.0]), ("analysis", [0.6, 0.2, 2.6, -6.0])] {
            let found = file.read_variable::<f64>(&format!("{stage}_departure_{method}")).unwrap();
            assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{method}: {found:?}");
        }
    }
    assert_eq!(file.read_variable::<i32>("quality_code").unwrap().iter().copied().collect::<Vec<_>>(), [0, 0, 8, 8]);
    let summary = std::fs::read_to_string(folder.path().join("out/s/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    for method in ["oi", "var", "kf"] {
        let own = &summary["methods"][method];
        assert!((own["innovation_chi2"].as_f64().unwrap() - 1.0).abs() < 1e-9, "{method}");
        assert!(own["diagnostics"]["observations"].get("seen/tracer").is_none());
        let passive = &own["diagnostics"]["passive"]["seen/tracer"];
        assert!((passive["analysis_rms"].as_f64().unwrap() - ((2.6 * 2.6 + 36.0) / 2.0_f64).sqrt()).abs() < 1e-9);
        assert!((passive["background_mean"].as_f64().unwrap() + 0.5).abs() < 1e-9);
    }
    let diagnosed = text(&isobar(folder.path(), &["diagnose", "--all", "out/s"]).stdout);
    let row = diagnosed.lines().find(|line| line.starts_with("oi seen/tracer")).unwrap();
    assert!(row.contains("passive") && row.contains("2") && row.contains("4.6"), "{diagnosed}");
}

#[test]
fn a_world_with_nothing_but_passive_networks_says_so_and_compares_them() {
    let folder = folder(&small().replace("file = \"used.csv\"", "file = \"used.csv\"\nassimilate = false"));
    let output = isobar(folder.path(), &RUN);
    let said = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(output.status.success() && said.contains("nothing is assimilated"), "{said}");
    let departures = observations(folder.path()).read_variable::<f64>("analysis_departure_kf").unwrap();
    assert_eq!(departures.iter().copied().collect::<Vec<_>>(), [3.0, 1.0, 5.0, -6.0]);
}

#[test]
fn unknown_biases_of_a_passive_network_are_refused_with_their_line() {
    let bias = "\n[[networks.seen.bias]]\nper = \"group\"\nvariable = \"tracer\"\nsigma = 1\n";
    let folder = folder(&format!("{WORLD}{PASSIVE}{bias}{METHODS}"));
    let output = isobar(folder.path(), &["check", "s.toml"]);
    let said = one_line(&text(&output.stderr));
    assert!(!output.status.success() && said.contains("assimilate = false"), "{said}");
    assert!(said.contains("unknown biases, which only an assimilated network can determine"), "{said}");
}

/// `check` says which stations are withheld, and a run scores them; n of χ²/n is the number of the others.
#[test]
fn withheld_stations_are_named_and_verify_estimates() {
    let observed = "observe = { tracer = 0.1 }\n";
    let scenario = WORLD.replace(observed, &format!("{observed}withhold = 0.25\n"));
    let kf = "[methods.kf]\nkind = \"kf\"\n[methods.free]\nkind = \"free\"\n";
    let folder = folder(&format!("{scenario}{kf}"));
    let output = isobar(folder.path(), &["check", "s.toml"]);
    let said = one_line(&(text(&output.stdout) + &text(&output.stderr)));
    assert!(output.status.success() && said.contains("3 of 12 stations are withheld from all methods: "), "{said}");
    let found = summary(&format!("{scenario}{kf}"));
    let all = summary(&format!("{WORLD}{kf}"));
    let by_type = |summary: &Summary| summary.observations.by_type["fixed/tracer"].used;
    assert_eq!(by_type(&found), found.observations.used);
    assert!(by_type(&found) < by_type(&all) && found.observations.passive > 12, "{:?}", found.observations);
    let passive = |method: &str| found.methods[method].values["passive_departure_analysis.tracer"];
    assert!(passive("kf") < 0.9 * passive("free"), "{} {}", passive("kf"), passive("free"));
}
