//! Observations before the end of a cycle: compared with the background of their times, or as if they were of the analysis.

use crate::common::{self, isobar, text};
use netcdf_reader::NcFile;
use std::fs;
use std::path::Path;
use std::process::Output;
use tempfile::{TempDir, tempdir};

/// A wave that is carried by a column in an hour, exactly, without any error of the model.
fn carried() -> String {
    common::TRACER
        .replace("columns_per_step = 0", "columns_per_step = 1")
        .replace("amplitude = 0", "amplitude = 1\nwaves_x = 2")
        .replace("count = 1", "count = 3")
}

const FREE: &str = "[methods.free]\nkind = \"free\"\n";

/// A directory with `s.toml` and `obs.csv`, in which the program has run with these arguments, and what it said.
fn command(arguments: &[&str], scenario: &str, csv: &str) -> (TempDir, Output) {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("s.toml"), scenario).unwrap();
    fs::write(directory.path().join("obs.csv"), csv).unwrap();
    let output = isobar(directory.path(), arguments);
    (directory, output)
}

const RUN: [&str; 5] = ["run", "s.toml", "-q", "--no-rerun", "--no-report"];

/// What standard error says, as one line.
fn said(output: &Output) -> String {
    text(&output.stderr).replace(['\n', '│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

#[track_caller]
fn run(scenario: &str, csv: &str) -> TempDir {
    let (directory, output) = command(&RUN, scenario, csv);
    assert!(output.status.success(), "{}", said(&output));
    directory
}

fn numbers(directory: &Path, file: &str, variable: &str) -> Vec<f64> {
    let file = NcFile::open(directory.join("out/s").join(file)).unwrap();
    match file.read_variable::<f64>(variable) {
        Ok(values) => values.iter().copied().collect(),
        Err(_) => file.read_variable::<f32>(variable).unwrap().iter().map(|&value| value.into()).collect(),
    }
}

/// The wave at a column after so many hours.
fn wave(column: f64, hours: f64) -> f64 {
    (std::f64::consts::TAU * 2.0 * (column - 1.0 + 0.5 - hours) / 16.0).cos()
}

/// y − H M x, where M is exact: at time steps to rounding, between them with the values of the steps around.
#[test]
fn departures_of_recorded_observations_are_those_at_their_times() {
    let csv = "time,column,row,value,sigma,id\n\
        2026-01-15T02:00:00Z,5,3,0,0.1,a\n2026-01-15T02:30:00Z,9,3,0,0.1,b\n2026-01-15T06:00:00Z,5,3,0,0.1,a\n\
        2026-01-15T07:00:00Z,5,3,0,0.1,a\n2026-01-16T12:00:00Z,5,3,0,0.1,a\n";
    let network = "[networks.obs]\nkind = \"file\"\nfile = \"obs.csv\"\nobservation_times = \"window\"\n";
    let directory = run(&[&*carried(), network, FREE].concat(), csv);
    let found = numbers(directory.path(), "observations.nc", "background_departure_free");
    let expected =
        [wave(5.0, 2.0), 0.5 * (wave(9.0, 2.0) + wave(9.0, 3.0)), wave(5.0, 6.0), wave(5.0, 7.0)].map(|it| -it);
    assert_eq!(found.len(), 4, "the last one is after the run");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{found}, not {expected}");
    }
}

const STATIONS: &str =
    "[networks.net]\nkind = \"radiosonde\"\nstations = { regular = [4, 3] }\nobserve = { tracer = 0.1 }\n";

const METHODS: &str = r#"[methods]
kf = { kind = "kf" }
late = { kind = "kf", first_guess = "analysis_time" }
etkf = { kind = "etkf", members = 30 }
four = { kind = "4dvar", window_cycles = 2 }
"#;

/// What a run wrote is what another reads, with the times.
#[test]
fn observations_of_a_run_are_read_back_at_their_times() {
    let scenario = |network: &str| [&*carried(), network, METHODS].concat();
    let first = run(&scenario(&format!("{STATIONS}times_per_window = 3\n")), "");
    let written = first.path().join("out/s/observations.nc");
    let network =
        format!("[networks.net]\nkind = \"file\"\nfile = \"{}\"\nobservation_times = \"window\"\n", written.display());
    let second = run(&scenario(&network), "");
    for method in ["kf", "late", "etkf", "four"] {
        let [a, b] = [&first, &second].map(|it| numbers(it.path(), &format!("{method}.nc"), "tracer_analysis"));
        let largest = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(largest < 1e-9, "{method}: {largest:e}");
    }
    let [kf, late] = ["kf.nc", "late.nc"].map(|file| numbers(first.path(), file, "tracer_analysis"));
    assert!(kf.iter().zip(&late).any(|(a, b)| (a - b).abs() > 0.01));
}

/// A key that changes nothing changes nothing, to the bit; where nothing moves, times are the same.
#[test]
fn one_time_and_a_state_that_stands_still_are_as_before() {
    let analysed = |scenario: String| {
        let directory = run(&scenario, "");
        ["kf", "etkf", "four"].map(|method| numbers(directory.path(), &format!("{method}.nc"), "tracer_analysis"))
    };
    let with = |keys: &str| analysed([&*carried(), STATIONS, keys, METHODS].concat());
    assert_eq!(with(""), with("times_per_window = 1\n"));
    let still = |keys: &str| analysed([&*carried().replace("step = 1", "step = 0"), STATIONS, keys, METHODS].concat());
    let (at_end, within) = (still(""), still("times_per_window = 6\n"));
    for (a, b) in at_end.iter().flatten().zip(within.iter().flatten()) {
        assert!((a - b).abs() < 1e-9, "{a}, {b}");
    }
}

#[test]
fn what_cannot_be_observed_in_time_is_refused_by_name() {
    let kf = "[methods.kf]\nkind = \"kf\"\n";
    let file = "[networks.net]\nkind = \"file\"\nfile = \"obs.csv\"\nsigma = 1\n";
    let csv = "time,column,row,value\n2026-01-15T02:00:00Z,5,3,0\n";
    for (keys, expected) in [
        (format!("{STATIONS}times_per_window = 4\n{kf}"), "a cycle has 6 time steps of the truth"),
        (format!("{STATIONS}times_per_window = 4\n{kf}"), "it must be one of 1, 2, 3, 6"),
        (format!("{STATIONS}times_per_window = 0\n{kf}"), "times_per_window"),
        (format!("{file}times_per_window = 2\n{kf}"), "times_per_window"),
        (
            format!("{file}observation_times = \"window\"\ntime_tolerance_minutes = 10\n{kf}"),
            "all observations are used at their times",
        ),
        (format!("{file}observation_times = \"late\"\n{kf}"), "valid values: analysis, window"),
        (format!("{STATIONS}{kf}first_guess = \"late\"\n"), "valid values: appropriate_time, analysis_time"),
        (format!("{STATIONS}[methods.free]\nkind = \"free\"\nfirst_guess = \"analysis_time\"\n"), "first_guess"),
    ] {
        let (_directory, output) = command(&["check", "s.toml"], &format!("{}{keys}", carried()), csv);
        let message = said(&output);
        assert!(!output.status.success() && message.contains(expected), "{keys}: {message}");
        assert!(message.contains("s.toml:"), "the place is named: {message}");
    }
    let one_step = carried().replace("time_step_s = 3600", "time_step_s = 21600");
    let scenario = format!("{one_step}{STATIONS}times_per_window = 2\n{kf}");
    let (_directory, output) = command(&["check", "s.toml"], &scenario, "");
    let expected = "the true states are known at the ends of the cycles only";
    assert!(!output.status.success() && said(&output).contains(expected), "{}", said(&output));
    let scenario = format!("{}{STATIONS}times_per_window = 2\n{kf}", carried());
    let (_directory, output) = command(&["exact", "s.toml"], &scenario, "");
    assert!(!output.status.success() && said(&output).contains("network net observes them within the window"));
    // Before the start and after the end.
    let csv =
        "time,column,row,value\n2026-01-15T00:00:00Z,5,3,0\n2026-01-15T18:00:01Z,5,3,0\n2026-01-15T18:00:00Z,5,3,0\n";
    let scenario = format!("{}{file}observation_times = \"window\"\n{kf}", carried());
    let (_directory, output) = command(&["check", "s.toml"], &scenario, csv);
    let expected = "1 of 3 observations can be used: 2 not valid in any cycle";
    assert!(output.status.success() && text(&output.stdout).contains(expected), "{}", text(&output.stdout));
}
