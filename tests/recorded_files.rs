//! Observations and stations of files, as people have them: read rightly, or refused, and never dropped without a word.

use crate::common::{self, isobar, text};
use netcdf_reader::NcFile;
use std::fs;
use std::path::Path;
use std::process::Output;
use tempfile::{TempDir, tempdir};

const WATER: &str = r#"title = "t"
phenomenon = "p"
source = "s"
seed = 1
start = "2026-01-15T00:00:00Z"
[grid]
nx = 40
ny = 30
dx_km = 200
boundary = "channel"
center_latitude_deg = 40
center_longitude_deg = -100
[model]
kind = "linear_shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4
mean_depth_m = 5500
[initial]
kind = "rest"
[background_error]
components = [{ kind = "white", variable = "u", sigma = 5 }, { kind = "white", variable = "v", sigma = 5 }]
[cycle]
count = 1
window_hours = 6
[methods.oi]
kind = "optimal_interpolation"
"#;

fn tracer() -> String {
    format!("{}[methods.oi]\nkind = \"optimal_interpolation\"\n", common::TRACER)
}

/// A file network, with further keys.
fn network(keys: &str) -> String {
    format!("[networks.buoys]\nkind = \"file\"\nfile = \"buoys.csv\"\n{keys}\n")
}

/// A directory in which `isobar COMMAND s.toml` has run, and what it said.
fn command(command: &str, scenario: &str, network: &str, csv: &str) -> (TempDir, Output) {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("s.toml"), format!("{scenario}{network}")).unwrap();
    fs::write(directory.path().join("buoys.csv"), csv).unwrap();
    let arguments: &[&str] =
        if command == "run" { &["run", "s.toml", "-q", "--no-rerun", "--no-report"] } else { &["check", "s.toml"] };
    let output = isobar(directory.path(), arguments);
    (directory, output)
}

/// What standard error says, as one line.
fn said(output: &Output) -> String {
    text(&output.stderr).replace(['\n', '│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

fn numbers(directory: &Path, variable: &str) -> Vec<f64> {
    let file = NcFile::open(directory.join("out/s/observations.nc")).unwrap();
    match file.read_variable::<f64>(variable) {
        Ok(values) => values.iter().copied().collect(),
        Err(_) => file.read_variable::<i32>(variable).unwrap().iter().map(|&value| value.into()).collect(),
    }
}

/// The numbers of `variable` after a run that must succeed.
#[track_caller]
fn run(scenario: &str, keys: &str, csv: &str, variable: &str) -> Vec<f64> {
    let (directory, output) = command("run", scenario, &network(keys), csv);
    assert!(output.status.success(), "{}", said(&output));
    numbers(directory.path(), variable)
}

#[test]
fn places_on_a_periodic_plane_go_round() {
    let analysed = |csv: &str| run(&tracer(), "sigma = 1", csv, "analysis_departure_oi");
    let seam = analysed("cycle,x_m,y_m,value\n1,1600000,550000,1\n1,-50000,1450000,2\n");
    let first = analysed("cycle,x_m,y_m,value\n1,0,550000,1\n1,1550000,250000,2\n");
    assert_eq!(seam, first);
    // A place without a name has several observations unless they are equal.
    let twice = "cycle,x_m,y_m,value\n1,0,550000,1\n1,1600000,550000,3\n1,0,550000,3\n";
    assert_eq!(run(&tracer(), "sigma = 1", twice, "quality_code"), [0.0, 0.0, 4.0]);
}

#[test]
fn a_leap_second_is_used_and_another_second_60_is_refused() {
    let scenario = tracer().replace("2026-01-15T00:00:00Z", "2016-12-31T18:00:00Z");
    let csv =
        "time,x_m,y_m,value,id\n2016-12-31T23:59:60Z,150000,250000,0.4,A\n2017-01-01T00:00:00,850000,650000,-0.7,B\n";
    assert_eq!(run(&scenario, "sigma = 0.5", csv, "quality_code"), [0.0, 0.0]);
    for (scenario, csv, expected) in [
        (&*scenario, csv.replace("23:59:60", "22:59:60"), "buoys.csv, line 2: `time` is `2016-12-31T22:59:60Z`"),
        (&scenario.replace("18:00:00Z", "18:00:60Z"), csv.to_string(), "there was no second 60 then"),
    ] {
        let (_directory, output) = command("check", scenario, &network("sigma = 0.5"), &csv);
        assert!(!output.status.success() && said(&output).contains(expected), "{}", said(&output));
    }
    let midnight = "time,x_m,y_m,value\n2016-12-31T24:00:00Z,150000,250000,0.4\n";
    assert_eq!(run(&scenario, "sigma = 0.5", midnight, "quality_code"), [0.0]);
    let without_zone = tracer().replace("00:00:00Z", "00:00:00");
    assert_eq!(run(&without_zone, "sigma = 1", "cycle,column,row,value\n1,2,3,4\n", "quality_code"), [0.0]);
}

#[test]
fn missing_values_are_counted_and_their_markers_are_named() {
    let csv = "cycle,column,row,variable,value,sigma,id\n1,9,13,h,5480,12,A\n1,21,17,h,-9999,12,B\n1,31,15,h,,12,C\n";
    let scenario = WATER.replace("\"white\", variable = \"u\"", "\"white\", variable = \"h\"");
    let (_directory, output) = command("run", &scenario, &network(""), csv);
    assert!(!output.status.success());
    let message = said(&output);
    assert!(
        message.contains("buoys.csv, line 3: `value` is -9999") && message.contains("missing = [-9999]"),
        "{message}"
    );
    let (directory, output) = command("run", &scenario, &network("missing = [-9999]"), csv);
    assert!(output.status.success(), "{}", said(&output));
    assert!(said(&output).contains("networks.buoys: 1 of 3 observations can be used: 2 missing"), "{}", said(&output));
    assert_eq!(numbers(directory.path(), "value"), [5480.0]);
}

#[test]
fn what_cannot_be_used_is_said_before_the_run() {
    let csv = "time,x_m,y_m,value,sigma,id\n2026-01-15T05:15:00Z,900000,300000,1,1,A\n2026-01-15T05:58:00Z,100000,1700000,2,1,B\n";
    let (_directory, output) = command("check", &tracer(), &network(""), csv);
    let late = "networks.buoys: 0 of 2 observations can be used: 2 not valid at the end of a cycle";
    assert!(output.status.success() && said(&output).contains(&format!("warning: {late}")), "{}", said(&output));
    assert!(text(&output.stdout).contains(late), "{}", text(&output.stdout));
    let (directory, output) = command("run", &tracer(), &network(""), csv);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains(late) && said(&output).contains("no observation was used"), "{}", said(&output));
    let valid = numbers(directory.path(), "time");
    assert_eq!(valid[1] - valid[0], 43.0 * 60.0, "the times are those of the file");
    assert_eq!(run(&tracer(), "time_tolerance_minutes = 5", csv, "quality_code"), [0.0, 3.0]);
    assert_eq!(run(&tracer(), "time_tolerance_minutes = 45", csv, "time"), valid);
    let outside = "cycle,latitude_deg,longitude_deg,variable,value,sigma\n1,40,100,u,1,1\n";
    let (_directory, output) = command("run", WATER, &network(""), outside);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("1 outside of the domain; latitudes are positive"), "{}", said(&output));
}

/// The right values are those of finite differences of the projection of a sphere: γ = -32.889° at 47 N 53 W.
#[test]
fn winds_on_the_earth_are_turned_to_the_axes_of_the_plane() {
    let csv = "cycle,latitude_deg,longitude_deg,variable,value,sigma,id\n1,47.0,-53.0,u,50,2,east\n\
               1,47.0,-53.0,v,-20,2,east\n1,40.0,-100.0,u,30,2,middle\n1,40.0,-100.0,v,10,2,middle\n";
    let departures = run(WATER, "", csv, "background_departure_oi");
    for (departure, expected) in departures.iter().zip([52.846, 10.356, 30.0, 10.0]) {
        assert!((departure - expected).abs() < 2e-3, "{departures:?}");
    }
    assert_eq!(run(WATER, "winds = \"grid\"", csv, "background_departure_oi"), [50.0, -20.0, 30.0, 10.0]);
    // White B and one component: H B Hᵀ = 25 whatever the direction if both components have the weights of one point, and
    // the departure is that of the component to the east.
    let single = "cycle,latitude_deg,longitude_deg,variable,value,sigma\n1,47.0,-53.0,u,50,2\n";
    assert_eq!(run(WATER, "", single, "background_departure_oi"), [50.0]);
    let other_sigma = csv.replacen("-20,2", "-20,3", 1);
    assert_eq!(run(WATER, "", &other_sigma, "background_departure_oi")[..2], [50.0, -20.0]);
    let on_the_plane = "cycle,x_m,y_m,variable,value,sigma\n1,1e6,1e6,u,50,2\n";
    let (_directory, output) = command("check", WATER, &network("winds = \"earth\""), on_the_plane);
    assert!(!output.status.success() && said(&output).contains("no latitudes and longitudes"), "{}", said(&output));
}

#[test]
fn the_other_hemisphere_and_stations_outside_are_warned_of() {
    let (_directory, output) = command("check", &WATER.replace("1.0e-4", "-1.0e-4"), "", "");
    assert!(said(&output).contains("has not the sign of grid.center_latitude_deg = 40"), "{}", said(&output));
    let sondes = "[networks.sondes]\nkind = \"radiosonde\"\nstations = { file = \"buoys.csv\" }\nobserve = { h = 5 }\n";
    let (_directory, output) = command("check", WATER, sondes, "ID,Lat,lon\nA,40,-100\nB,-40,100\n");
    let expected = "networks.sondes: 1 of 2 stations lie outside of the domain: B (line 3)";
    assert!(output.status.success() && said(&output).contains(expected), "{}", said(&output));
}

/// A list of stations may cover more than the domain, and a margin is what the scenario wants.
#[test]
fn a_few_stations_beyond_the_edges_are_information_and_no_warning() {
    let sondes = "[networks.sondes]\nkind = \"radiosonde\"\nstations = { file = \"buoys.csv\" }\nobserve = { h = 5 }\n\
                  edge_margin_km = 300\n";
    let stations = "id,lat,lon\nA,40,-100\nC,42,-100\nD,38,-100\nE,14,-100\nB,-40,100\n";
    let (_directory, output) = command("check", WATER, sondes, stations);
    let information = text(&output.stdout);
    for expected in [
        "networks.sondes: 1 of 5 stations lie outside of the domain: B (line 6)",
        "networks.sondes: 1 of 5 stations are left out, nearer than edge_margin_km to the edges: E (line 5)",
    ] {
        assert!(information.contains(expected), "{information}");
    }
    assert!(output.status.success() && said(&output).is_empty(), "{}", said(&output));
}

#[test]
fn what_a_spreadsheet_leaves_behind_changes_nothing() {
    let clean = "cycle,x_m,y_m,value,sigma,id\n1,150000,250000,0.4,0.5,A\n1,850000,650000,-0.7,0.5,B\n";
    let expected = run(&tracer(), "", clean, "analysis_departure_oi");
    let messy = "\u{feff}\"cycle\",\"X_M\",y_m,value,sigma,id,,\r1.0,150000,250000,0.4,0.5,A,,\r\r1,850000,650000,-0.7,0.5,B,,\r,,,,,,,\r";
    assert_eq!(run(&tracer(), "", messy, "analysis_departure_oi"), expected);
    let stations =
        "[networks.sondes]\nkind = \"radiosonde\"\nstations = { file = \"buoys.csv\" }\nobserve = { tracer = 0.5 }\n";
    let reports = |csv: &str| {
        let (directory, output) = command("run", &tracer(), stations, csv);
        assert!(output.status.success(), "{}", said(&output));
        ["x", "y", "value"].map(|name| numbers(directory.path(), name))
    };
    let clean = reports("id,x_m,y_m\nA,150000,250000\nB,850000,650000\n");
    assert_eq!(reports("\n\"id\",\"x_m\",\"y_m\",,\n\"A\",150000,250000,,\n,,,,\n\"B\",-750000,650000,,\n"), clean);
}

#[test]
fn every_key_of_a_network_that_is_read_has_an_effect() {
    let polar = "[networks.polar]\nkind = \"satellite\"\nvariable = \"tracer\"\nsigma = 1\nswath_width_km = 600\n\
                 scan_positions = 8\nalong_track_spacing_km = 100\nfootprint_sigma_km = 60\n";
    let sondes =
        "[networks.sondes]\nkind = \"radiosonde\"\nstations = { regular = [4, 3] }\nobserve = { tracer = 1 }\n";
    let scenario = tracer().replace("count = 1", "count = 3");
    let observed = |network: &str| {
        let (directory, output) = command("run", &scenario, network, "");
        assert!(output.status.success(), "{network}: {}", said(&output));
        let all: Vec<f64> = ["value", "time", "x", "y", "quality_code"]
            .iter()
            .flat_map(|name| numbers(directory.path(), name))
            .collect();
        all
    };
    for network in [polar, sondes] {
        let plain = observed(network);
        let own: &[&str] = if network == polar {
            &["start_x_fraction = 0.3", "shift_per_cycle_km = 150", "heading = \"southward\"", "track_angle_deg = 10"]
        } else {
            &["edge_margin_km = 200", "stations = { regular = [3, 3] }"]
        };
        let common = [
            "interval_cycles = 2",
            "interval_cycles = 3\nfirst_cycle = 2",
            "missing_rate = 0.5",
            "faults = { gross_error_rate = 0.5 }",
            "faults = { not_finite_rate = 0.5 }",
            "faults = { duplicate_rate = 0.5 }",
            "faults = { misplaced_rate = 0.5 }",
            "faults = { late_rate = 0.5 }",
        ];
        for key in own.iter().chain(&common) {
            let replaced = if key.starts_with("stations") { "stations = { regular = [4, 3] }\n" } else { "" };
            let without = network.replacen(replaced, "", 1);
            assert_ne!(observed(&format!("{without}{key}\n")), plain, "{key} has no effect on\n{network}");
        }
    }
    let rows: Vec<f64> = observed(&format!("{polar}missing_rate = 0.9\n"));
    let n = observed(polar).len() as f64;
    let expected = 0.1 * n;
    assert!((rows.len() as f64 - expected).abs() < 5.0 * 3.0 * (n / 5.0 * 0.09).sqrt(), "{} of {n}", rows.len());
    for key in ["missing_rate = 0.5", "interval_cycles = 2", "first_cycle = 1", "faults = { late_rate = 0.5 }"] {
        let (_directory, output) =
            command("check", &tracer(), &network(&format!("sigma = 1\n{key}")), "cycle,column,row,value\n1,1,1,1\n");
        assert!(!output.status.success() && said(&output).contains("unknown key"), "{key}: {}", said(&output));
    }
}
