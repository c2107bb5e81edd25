//! `isobar winds`: a flight from its tables, offsets from flight to flight, and tables that are not what they should be.

use crate::common::{isobar, one_line, text};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Output;
use tempfile::tempdir;

const TRACKERS: &str = "isobar:/winds/trackers.csv";
const FLIGHTS: [&str; 2] = ["isobar:/winds/flight_1.csv", "isobar:/winds/flight_2.csv"];

/// The true offsets of `TRACKERS`.
const OFFSETS: [(&str, f64); 8] = [
    ("radar/range", 25.0),
    ("radar/azimuth", 0.17),
    ("radar/elevation", -0.11),
    ("second_radar/range", -40.0),
    ("second_radar/azimuth", -0.06),
    ("second_radar/elevation", 0.09),
    ("theodolite/azimuth", 0.3),
    ("theodolite/elevation", 0.06),
];

fn winds(directory: &Path, arguments: &[&str]) -> Output {
    isobar(directory, &[&["winds"], arguments].concat())
}

fn found(directory: &Path, arguments: &[&str]) -> Value {
    let output = winds(directory, &[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Value and standard deviation of the offsets.
fn offsets(found: &Value) -> Vec<(f64, f64)> {
    let all = found["offsets"].as_array().unwrap();
    let names: Vec<&str> = all.iter().map(|offset| offset["offset"].as_str().unwrap()).collect();
    assert_eq!(names, OFFSETS.map(|(name, _)| name));
    all.iter().map(|offset| (offset["value"].as_f64().unwrap(), offset["sigma"].as_f64().unwrap())).collect()
}

/// The offsets are found within what is claimed, and better with each flight; the winds agree with the steps of the track.
#[test]
fn offsets_become_better_from_flight_to_flight() {
    let directory = tempdir().unwrap();
    let of = |flight: &str, more: &[&str]| {
        found(directory.path(), &[&[flight, "--trackers", TRACKERS, "--wind-change", "1"], more].concat())
    };
    let database = ["--sensors", "trackers.db", "--write-back"];
    let first = of(FLIGHTS[0], &database);
    let (alone, second) = (of(FLIGHTS[1], &[]), of(FLIGHTS[1], &database));
    let again = of(FLIGHTS[1], &database);
    assert_eq!(offsets(&second), offsets(&again), "what a flight has found out is not used for it a second time");
    let (first, alone, second) = (offsets(&first), offsets(&alone), offsets(&second));
    for (i, (name, truth)) in OFFSETS.into_iter().enumerate() {
        for (value, sigma) in [first[i], alone[i], second[i]] {
            assert!((value - truth).abs() < 3.0 * sigma, "{name}: {value} ± {sigma}, but it is {truth}");
        }
        assert!(second[i].1 < 0.85 * alone[i].1.min(first[i].1), "{name}: {} and {}", second[i].1, alone[i].1);
    }
    let listed = isobar(directory.path(), &["sensors", "list", "trackers.db"]);
    let listed = text(&listed.stdout);
    assert!(OFFSETS.iter().all(|(name, _)| listed.contains(name)) && listed.contains("degree"), "{listed}");
}

#[test]
fn a_flight_is_a_table_and_a_page() {
    let directory = tempdir().unwrap();
    let arguments =
        [FLIGHTS[0], "--trackers", TRACKERS, "--wind-change", "1", "--out", "winds.csv", "--page", "winds.html"];
    let output = winds(directory.path(), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let shown = text(&output.stdout);
    assert!(shown.contains("181 fixes by 3 trackers from 2026-06-01T11:30:00Z to 2026-06-01T13:00:00Z"), "{shown}");
    assert!(shown.lines().all(|line| line.chars().count() <= 100), "{shown}");
    let table = fs::read_to_string(directory.path().join("winds.csv")).unwrap();
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let header: Vec<String> = reader.headers().unwrap().iter().map(String::from).collect();
    let column = |name: &str| header.iter().position(|it| it == name).unwrap();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 181);
    let number = |row: usize, name: &str| rows[row][column(name)].parse::<f64>().unwrap();
    for row in 0..180 {
        let step = (number(row + 1, "x_m") - number(row, "x_m")) / 30.0;
        assert!((number(row, "u_m_per_s") - step).abs() < 1e-9);
        assert!((3.0..7.0).contains(&number(row, "w_m_per_s")), "it rises at 5 m/s");
        assert!((0.01..2.0).contains(&number(row, "sigma_u_m_per_s")));
    }
    assert!(rows[180][column("u_m_per_s")].is_empty());
    let page = fs::read_to_string(directory.path().join("winds.html")).unwrap();
    assert!(page.matches("<svg").count() >= 3 && page.contains("second_radar&#x2f;range"));
    // Without a motion neighbours do not help, and the wind is less well known.
    let independent = found(directory.path(), &[FLIGHTS[0], "--trackers", TRACKERS]);
    let sigma = independent["fixes"][90]["sigma_wind_m_per_s"][0].as_f64().unwrap();
    assert!(sigma > 1.5 * number(90, "sigma_u_m_per_s"), "{sigma}");
    // Files of earlier computations are replaced on request, and nothing else ever.
    let refused = winds(directory.path(), &arguments);
    assert!(!refused.status.success() && text(&refused.stderr).contains("winds.csv exists"));
    assert!(winds(directory.path(), &[&arguments[..], &["-f"]].concat()).status.success());
    fs::write(directory.path().join("winds.csv"), "mine\n").unwrap();
    let refused = winds(directory.path(), &[&arguments[..], &["-f"]].concat());
    assert!(!refused.status.success() && text(&refused.stderr).contains("replaces only tables of isobar winds"));
    assert_eq!(fs::read_to_string(directory.path().join("winds.csv")).unwrap(), "mine\n");
}

#[test]
fn tables_that_make_no_sense_are_refused_by_line() {
    let directory = tempdir().unwrap();
    let trackers = "tracker,x_m,y_m,z_m,sigma_range_m,sigma_azimuth_deg,sigma_elevation_deg\na,0,0,0,15,0.05,0.05\n";
    let readings = "time,tracker,range_m,azimuth_deg,elevation_deg\n2026-06-01T11:30:00Z,a,13000,157.5,1.1\n";
    let refused = |trackers: &str, readings: &str, more: &[&str]| {
        fs::write(directory.path().join("trackers.csv"), trackers).unwrap();
        fs::write(directory.path().join("flight.csv"), readings).unwrap();
        let output = winds(directory.path(), &[&["flight.csv", "--trackers", "trackers.csv"], more].concat());
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
        one_line(&text(&output.stderr))
    };
    let with = |line: &str| format!("{readings}{line}\n");
    for (trackers, readings, wanted) in [
        (trackers.replace("z_m", "height"), readings.into(), "unknown column `height`"),
        (trackers.replace(",15,0.05,0.05", ",,,"), readings.into(), "line 2: the tracker measures nothing"),
        (trackers.replace(",15,", ",-15,"), readings.into(), "line 2: `sigma_range_m` is `-15`"),
        (format!("{trackers}a,1,1,1,1,1,1\n"), readings.into(), "line 3: the tracker `a` is there twice"),
        (trackers.replace(",15,", ",,"), readings.into(), "line 2: `range_m` is given, but the tracker has no"),
        (trackers.into(), with("2026-06-01T11:30:10Z,b,1,1,1"), "line 3: `tracker` is `b`, but the trackers are a"),
        (trackers.into(), with("2026-06-01T11:30:00Z,a,1,1,1"), "line 3: `a` has another reading of this time"),
        (trackers.into(), with("2026-06-01T11:30:10Z,a,1,1,91"), "line 3: `elevation_deg` is `91`"),
        (trackers.into(), with("noon,a,1,1,1"), "line 3: `time` is `noon`"),
        (trackers.into(), "time,tracker,range_m\n".into(), "has no readings"),
        // Its offsets and the balloon's places cannot be told apart.
        (trackers.into(), readings.into(), "the flight does not determine"),
    ] {
        let error = refused(&trackers, &readings, &[]);
        assert!(error.contains(wanted), "{wanted}: {error}");
    }
    let error = refused(trackers, readings, &["--sensors", "trackers.db"]);
    assert!(error.contains("needs sigma_range_offset_m"), "{error}");
    let priors =
        trackers.replace("_elevation_deg\n", "_elevation_deg,sigma_range_offset_m\n").replace("0.05\n", "0.05,9\n");
    let error = refused(&priors, readings, &[]);
    assert!(error.contains("standard deviations of some offsets only"), "{error}");
    let all = trackers
        .replace(
            "_elevation_deg\n",
            "_elevation_deg,sigma_range_offset_m,sigma_azimuth_offset_deg,sigma_elevation_offset_deg\n",
        )
        .replace("0.05\n", "0.05,9,0.5,0.5\n");
    let error = refused(&all, readings, &["--sensors", "missing.db"]);
    assert!(error.contains("there is no such database"), "{error}");
    // With priors of the offsets, one tracker and one fix are enough.
    let output = winds(directory.path(), &["flight.csv", "--trackers", "trackers.csv"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}
