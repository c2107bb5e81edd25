//! Memory is bounded by what is stated: products of settings that are within their limits one by one are refused before
//! anything of that size is allocated, by `isobar check` as by `isobar run`.

use crate::common::{isobar, text};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::tempdir;

const SCENARIO: &str = r#"
title = "A tracer"
phenomenon = "None"
source = "The tests"
seed = 1
start = "2026-01-15T00:00:00Z"
[grid]
nx = 16
ny = 8
dx_km = 100
boundary = "periodic"
[model]
kind = "exact_shift"
time_step_s = 3600
columns_per_step = 1
[initial]
kind = "cosine_wave"
amplitude = 1
waves_x = 1
[background_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 300 }]
[model_error]
components = [{ kind = "univariate", variable = "tracer", sigma = 0.05, length_km = 300 }]
[cycle]
count = 2
window_hours = 1
[networks.fixed]
kind = "radiosonde"
stations = { random = 20 }
observe = { tracer = 0.1 }
[methods.free]
kind = "free"
"#;

/// The scenario with replacements, and methods of these kinds with their keys.
fn scenario(changes: &[(&str, &str)], methods: &[&str]) -> String {
    let mut text = SCENARIO.to_string();
    for (old, new) in changes {
        assert!(text.contains(old), "{old} is not in the scenario");
        text = text.replacen(old, new, 1);
    }
    for (number, keys) in methods.iter().enumerate() {
        text += &format!("[methods.m{number}]\n{keys}\n");
    }
    text
}

/// Runs the program with at most 4 GB of memory, where the system can see to that: it needs a few hundred MB.
fn confined(directory: &Path, arguments: &str) -> Output {
    if !cfg!(target_os = "linux") {
        return isobar(directory, &arguments.split(' ').collect::<Vec<_>>());
    }
    let mut command = Command::new("sh");
    command.current_dir(directory).env("NO_COLOR", "1").env("LC_ALL", "C.UTF-8");
    command.arg("-c").arg(format!("ulimit -v 4000000; exec {} {arguments}", env!("CARGO_BIN_EXE_isobar")));
    command.output().expect("there is a shell")
}

fn flat(bytes: &[u8]) -> String {
    text(bytes).replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// `isobar check` says all of this, and its exit code is 1.
fn assert_refused(scenario: &str, wanted: &[&str]) {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("t.toml"), scenario).unwrap();
    let output = confined(directory.path(), "check t.toml");
    let message = flat(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}\n{scenario}");
    for part in wanted {
        assert!(message.contains(part), "{part:?} is missing in\n{message}");
    }
}

/// The scenario is checked and run.
fn assert_runs(scenario: &str) -> String {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("t.toml"), scenario).unwrap();
    for arguments in ["check t.toml", "run t.toml -q --no-rerun --no-report"] {
        let output = confined(directory.path(), arguments);
        assert!(output.status.success(), "{arguments}: {}\n{scenario}", flat(&output.stderr));
    }
    fs::read_to_string(directory.path().join("out/t/summary.json")).unwrap()
}

const BIAS: &str =
    "observe = { tracer = 0.1 }\n[[networks.fixed.bias]]\nper = \"station\"\nvariable = \"tracer\"\nsigma = 0.3";

#[test]
fn squares_of_observations_and_biases_are_part_of_a_method() {
    let many = ("random = 20", "random = 20000");
    for kind in [
        "kind = \"kf\"",
        "kind = \"optimal_interpolation\"",
        "kind = \"enkf\"\nmembers = 10",
        "kind = \"enkf\"\nmembers = 10\nlocalization_radius_km = 300",
        "kind = \"kf\"\nmemory_limit_gb = 2.5",
        "kind = \"federated_kf\"",
    ] {
        assert_refused(&scenario(&[many], &[kind]), &["method m0", "20000 observations", "more than the limit of 2"]);
    }
    let biases = ("observe = { tracer = 0.1 }", BIAS);
    let all = ["3dvar", "4dvar", "optimal_interpolation", "kf", "fkf", "letkf", "etkf", "enkf", "banded_kf"];
    for (count, kinds) in [("random = 9000", &all[..]), ("random = 100000", &all[..1])] {
        for kind in kinds {
            let mut keys = format!("kind = \"{kind}\"");
            keys += match *kind {
                "4dvar" => "\nwindow_cycles = 2",
                "letkf" => "\nmembers = 4\nlocalization_radius_km = 300",
                "etkf" | "enkf" => "\nmembers = 4",
                "banded_kf" => "\nhalf_bandwidth = 4",
                _ => "",
            };
            let changes = [("random = 20", count), biases];
            assert_refused(&scenario(&changes, &[&keys]), &["method m0", "biases", "more than the limit of 2000.0 MB"]);
        }
    }
}

/// The first calibration takes the observations box by box.
#[test]
fn squares_of_the_observations_in_a_box_are_part_of_the_first_calibration() {
    let biases = BIAS.replace("per = \"station\"", "per = \"group\"");
    let changes = [("random = 20", "random = 30000"), ("observe = { tracer = 0.1 }", biases.as_str())];
    for (box_km, is_refused) in [(5000, true), (100, false)] {
        let initialise = format!("[initialise]\nmethod = \"high-pass\"\ncycles = 2\nbox_km = {box_km}\n");
        let scenario = scenario(&changes, &["kind = \"serial_kf\""]) + &initialise;
        if is_refused {
            assert_refused(&scenario, &["method m0", "the first calibration of 1 biases from 30000 observations"]);
        } else {
            let directory = tempdir().unwrap();
            fs::write(directory.path().join("t.toml"), &scenario).unwrap();
            let output = confined(directory.path(), "check t.toml");
            assert!(output.status.success(), "{}", flat(&output.stderr));
        }
    }
}

#[test]
fn squares_of_members_are_part_of_a_method() {
    for kind in [
        "kind = \"etkf\"\nmembers = 12000",
        "kind = \"etkf\"\nmembers = 100000",
        "kind = \"letkf\"\nmembers = 12000\nlocalization_radius_km = 400",
        "kind = \"hybrid_3dvar\"\nmembers = 12000\nensemble_weight = 0.5\nlocalization_radius_km = 400",
    ] {
        assert_refused(&scenario(&[], &[kind]), &["method m0", "members", "more than the limit of 2000.0 MB"]);
    }
}

#[test]
fn correlations_longer_than_the_channel_need_no_endless_padding() {
    let model = ("kind = \"exact_shift\"", "kind = \"advection\"\nwind = { kind = \"uniform\", u_m_per_s = 0.1 }");
    let channel = [model, ("columns_per_step = 1\n", ""), ("\"periodic\"", "\"channel\"")];
    let steps = [("time_step_s = 3600", "time_step_s = 36"), ("window_hours = 1", "window_hours = 0.01")];
    let long = [("dx_km = 100", "dx_km = 0.01"), ("length_km = 300", "length_km = 1e5")];
    let tiny = [&channel[..], &steps, &long].concat();
    assert_runs(&scenario(&tiny, &["kind = \"3dvar\""]));
    let components = "{ kind = \"by_distance\", correlation = \"gaussian\",";
    let by_distance = [&[("{ kind = \"univariate\",", components)], &tiny[..]].concat();
    assert_refused(&scenario(&by_distance, &[]), &["a correlation of 100000 km in this channel", "at most", "km fit"]);
    // As wide as no localisation at all: members and static covariance as they are.
    let hybrid = "kind = \"hybrid_3dvar\"\nmembers = 4\nensemble_weight = 0.5\nlocalization_radius_km = 1e9";
    assert_runs(&scenario(&channel, &[hybrid]));
}

#[test]
fn footprints_times_cells_and_networks_times_stations_are_checked() {
    let satellite = "[networks.polar]\nkind = \"satellite\"\nvariable = \"tracer\"\nsigma = 1\nswath_width_km = 1152\n\
                     scan_positions = 300\nalong_track_spacing_km = 4.26667\nfootprint_sigma_km = 211.2\n[methods.free]";
    let fine = [("nx = 16", "nx = 128"), ("ny = 8", "ny = 128"), ("dx_km = 100", "dx_km = 10")];
    let wide = [fine[0], fine[1], fine[2], ("[methods.free]", satellite)];
    assert_refused(&scenario(&wide, &[]), &["polar", "values of the state, of at most 20000000", "smaller footprints"]);
    let networks: String = (0..20)
        .map(|number| {
            format!(
                "[networks.n{number}]\nkind = \"radiosonde\"\nstations = {{ random = 100000 }}\nobserve = {{ tracer = 0.1 }}\n"
            )
        })
        .collect();
    let many = [("[methods.free]", format!("{networks}[methods.free]"))];
    let many: Vec<(&str, &str)> = many.iter().map(|(old, new)| (*old, new.as_str())).collect();
    assert_refused(&scenario(&many, &[]), &["n9", "1000020 observations in a cycle, of at most 1000000"]);
}

/// What needs no square of the observations has none: local analyses, one observation at a time, and the minimisation.
#[test]
fn many_observations_are_no_obstacle_to_methods_without_their_square() {
    let many = ("random = 20", "random = 12000");
    let methods = ["kind = \"serial_kf\"", "kind = \"3dvar\"", "kind = \"etkf\"\nmembers = 10"];
    let summary = assert_runs(&scenario(&[many], &methods));
    assert!(!summary.contains("\"failure\": \""), "{summary}");
}

#[test]
fn what_run_would_refuse_is_refused_by_check() {
    for name in ["truth", "observations", "TRUTH"] {
        let named = format!("[methods.{name}]");
        assert_refused(&scenario(&[("[methods.free]", &named)], &[]), &["cannot be called", "has that name"]);
    }
    let pair = "[methods.a-b]\nkind = \"free\"\n[methods.a_b]";
    assert_refused(&scenario(&[("[methods.free]", pair)], &[]), &["the methods `a-b` and `a_b` differ"]);
    let network = "[networks.Fi-xed]\nkind = \"radiosonde\"\nstations = { random = 2 }\nobserve = { tracer = 1 }\n";
    let networks = format!("{network}{}[methods.free]", network.replace("Fi-xed", "fi_xed"));
    assert_refused(&scenario(&[("[methods.free]", &networks)], &[]), &["the networks `Fi-xed` and `fi_xed` differ"]);
    assert_refused(&scenario(&[], &["kind = \"fkf\"\nfactors = 200"]), &["200 common factors are more than the 128"]);
    let tiny = BIAS.replace("sigma = 0.3", "value = 1e-308");
    let tiny = [("observe = { tracer = 0.1 }", tiny.as_str())];
    assert_refused(&scenario(&tiny, &[]), &["methods cannot take their prior from a bias of 1e-308"]);
    let lonely = SCENARIO.split("[networks.fixed]").next().unwrap();
    let lonely = format!("{lonely}[methods.fed]\nkind = \"federated_kf\"\n");
    assert_refused(&lonely, &["there are no networks"]);
}

#[test]
fn a_long_name_is_refused_with_its_line() {
    let directory = tempdir().unwrap();
    let stations = [("{ random = 20 }", "{ file = \"s.csv\" }")];
    fs::write(directory.path().join("t.toml"), scenario(&stations, &[])).unwrap();
    for (id, name) in [("x".repeat(5000), "one".to_string()), ("a".to_string(), "é".repeat(201))] {
        fs::write(directory.path().join("s.csv"), format!("id,name,x_m,y_m\nb,two,3e5,2e5\n{id},{name},2e5,2e5\n"))
            .unwrap();
        let output = confined(directory.path(), "check t.toml");
        let message = flat(&output.stderr);
        assert_eq!(output.status.code(), Some(1));
        assert!(message.contains("s.csv, line 3:") && message.contains("has at most 200"), "{message}");
    }
}

/// What is read of many files is bounded as well as what is read of each.
#[test]
fn files_are_limited_in_all() {
    let directory = tempdir().unwrap();
    let remarks = format!("# {}\n", "x".repeat(997)).repeat(80_000);
    let rows = format!("{remarks}cycle,x_m,y_m,variable,value,sigma\n1,3e5,2e5,tracer,1,1\n");
    fs::write(directory.path().join("o.csv"), &rows).unwrap();
    let named = |number: usize| format!("[networks.f{number}]\nkind = \"file\"\nfile = \"o.csv\"\n");
    let networks: String = (0..4).map(named).collect();
    let networks = format!("{networks}[methods.free]");
    fs::write(directory.path().join("t.toml"), scenario(&[("[methods.free]", &networks)], &[])).unwrap();
    let output = confined(directory.path(), "check t.toml");
    let message = flat(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("the files of this scenario have more than 300 MB"), "{message}");
}

#[test]
fn numbers_beyond_a_limit_are_told_the_limit() {
    for (number, wanted) in [
        ("1e-300", "must be a number from 1e-18 to 1e18"),
        ("1e300", "must be a number from 1e-18 to 1e18"),
        ("-1", "must be a number greater than 0"),
        ("0", "must be a number greater than 0"),
    ] {
        let sigma = format!("tracer = {number}");
        assert_refused(&scenario(&[("tracer = 0.1", &sigma)], &[]), &[wanted]);
    }
}

#[test]
fn the_environment_asks_for_no_more_threads_than_the_command_line() {
    let directory = tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    let output =
        command.current_dir(directory.path()).args(["list"]).env("RAYON_NUM_THREADS", "100000").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("RAYON_NUM_THREADS asks for too many threads"));
}
