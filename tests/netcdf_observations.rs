//! Recorded observations in netCDF files: what isobar writes, and what others write.

use crate::ahead::Listener;
use crate::common::{isobar, one_line, text};
use crate::written::{Values, Variable, written};
use isobar::options::RunOptions;
use isobar::output::Outputs;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar_obs::Report;
use netcdf_reader::NcFile;
use std::fmt::Write;
use std::path::Path;

/// A jet over Europe with stations, a scanner, bad reports and late ones.
const WORLD: &str = r#"
title = "t"
phenomenon = "p"
source = "s"
seed = 5
start = "2026-01-15T00:00:00Z"
[grid]
nx = 14
ny = 10
dx_km = 200
boundary = "channel"
center_latitude_deg = 50
center_longitude_deg = 10
[model]
kind = "linear_shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4
mean_depth_m = 2000
[initial]
kind = "rest"
[background_error]
components = [{ kind = "balanced", sigma_height_m = 20, length_km = 800 }]
[cycle]
count = 4
window_hours = 6
[methods.oi]
kind = "optimal_interpolation"
[methods.kf]
kind = "kf"
"#;

const SYNTHETIC: &str = r#"
[networks.sondes]
kind = "radiosonde"
stations = { regular = [4, 3] }
groups = ["A", "B"]
reference_groups = ["A"]
sigma_height_m = 12
sigma_wind_m_per_s = 2.2
missing_rate = 0.1
faults = { late_rate = 0.1, not_finite_rate = 0.1, misplaced_rate = 0.1, duplicate_rate = 0.1 }
bias = [{ per = "group", variable = "h", sigma = 15 }]
[networks.others]
kind = "radiosonde"
stations = { random = 5 }
sigma_height_m = 9
"#;

fn recorded(file: &str, more: &str) -> String {
    format!("{WORLD}[networks.read]\nkind = \"file\"\nfile = \"{file}\"\n{more}")
}

/// A run of a scenario in a folder, and all that it says.
fn heard(folder: &Path, scenario: &str, name: &str) -> Listener {
    let scenario = Scenario::parse(&folder.join("s.toml"), scenario).unwrap();
    let outputs = Outputs::of(["netcdf"]);
    let options = RunOptions { threads: Some(1), outputs, ..RunOptions::new(folder.join(name)) };
    let mut listener = Listener::default();
    run(&scenario, &options, &mut listener).unwrap();
    listener
}

fn numbers(file: &NcFile, name: &str) -> Vec<f64> {
    file.read_variable_as_f64(name).unwrap().iter().copied().collect()
}

/// The observations of a run as a table, by somebody who knows netCDF.
fn table(run: &Path, network: Option<&str>) -> String {
    let file = NcFile::open(run.join("observations.nc")).unwrap();
    let [times, xs, ys, values, sigmas] = ["time", "x", "y", "value", "sigma"].map(|name| numbers(&file, name));
    let texts = |name: &str| file.read_variable_as_strings(name).unwrap();
    let (networks, platforms, variables) = (texts("network"), texts("platform"), texts("variable"));
    let mut table = String::from("time,x_m,y_m,variable,value,sigma,id\n");
    for row in 0..times.len() {
        if network.is_some_and(|network| network != networks[row]) {
            continue;
        }
        let time = isobar::calendar::utc(isobar_model::Time::from_seconds(times[row] as i64));
        let value = if values[row] > 1e30 { "NaN".to_string() } else { values[row].to_string() };
        let (x, y, sigma) = (xs[row], ys[row], sigmas[row]);
        writeln!(table, "{time},{x},{y},{},{value},{sigma},{}", variables[row], platforms[row]).unwrap();
    }
    table
}

/// The same records, and so the same innovations and estimates, to the bit.
#[test]
fn observations_of_a_run_are_those_of_the_same_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    heard(folder, &format!("{WORLD}{SYNTHETIC}"), "first");
    std::fs::copy(folder.join("first/observations.nc"), folder.join("o.nc")).unwrap();
    for (number, network) in [None, Some("sondes"), Some("others")].into_iter().enumerate() {
        std::fs::write(folder.join("o.csv"), table(&folder.join("first"), network)).unwrap();
        let only = network.map_or(String::new(), |network| format!("only_network = \"{network}\"\n"));
        let of_netcdf = heard(folder, &recorded("o.nc", &only), &format!("netcdf{number}"));
        let of_table = heard(folder, &recorded("o.csv", ""), &format!("table{number}"));
        let bits = |it: &Listener| postcard::to_stdvec(&it.observed).unwrap();
        assert_eq!(of_netcdf.observed.len(), 4);
        assert!(of_netcdf.observed.values().all(|window| window.values.len() > 3), "{network:?}");
        assert!(bits(&of_netcdf) == bits(&of_table) && of_netcdf.analysed == of_table.analysed, "{network:?}");
        let files = [format!("netcdf{number}"), format!("table{number}")].map(|name| {
            let file = NcFile::open(folder.join(name).join("observations.nc")).unwrap();
            ["background_departure_kf", "analysis_departure_oi"].map(|name| numbers(&file, name))
        });
        assert!(files[0] == files[1] && files[0][0].iter().any(|departure| departure.abs() > 1.0));
    }
    let table = table(&folder.join("first"), None);
    assert!(table.contains("NaN") && table.lines().count() > 100, "{table}");
}

/// Those that quality control has rejected are read as well.
#[test]
fn what_was_used_in_a_run_is_used_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let first = heard(folder, &format!("{WORLD}{SYNTHETIC}"), "first");
    std::fs::copy(folder.join("first/observations.nc"), folder.join("o.nc")).unwrap();
    let again = heard(folder, &recorded("o.nc", "only_network = \"others\"\n"), "again");
    for (cycle, window) in &first.observed {
        let of_others: Vec<usize> =
            (0..window.values.len()).filter(|&row| &*window.reports[row].network == "others").collect();
        let again = &again.observed[cycle];
        assert!(of_others.len() >= 3 && again.values.len() == 5);
        for &row in &of_others {
            let report = &window.reports[row];
            let is_same = |own: &Report| own.platform == report.platform && own.variable == report.variable;
            let own = again.reports.iter().position(is_same).unwrap();
            assert_eq!((window.values[row], window.sigma[row]), (again.values[own], again.sigma[own]));
            assert_eq!((report.x_m, report.y_m), (again.reports[own].x_m, again.reports[own].y_m));
        }
    }
}

/// Three rows as others may write them, with the names of variables, and with a change to one of them.
fn write(path: &Path, change: impl Fn(&mut Vec<Variable<'_>>)) {
    let hours = [("units", "hours since 2026-01-15 00:00:00"), ("calendar", "standard")];
    let dimension: &[&str] = &["observation"];
    let mut variables: Vec<Variable<'_>> = vec![
        ("time", dimension, &hours, Values::Integers(vec![6, 6, 12])),
        ("lat", dimension, &[("units", "degrees_north")], Values::Single(vec![50.5, 47.25, 55.0])),
        ("lon", dimension, &[("units", "degrees_east")], Values::Single(vec![5.0, 15.5, 12.0])),
        ("variable", &["observation", "letters"], &[], Values::Text(b"h\0h h ".to_vec())),
        ("value", dimension, &[("units", "gpm")], Values::Double(vec![1990.25, 2010.0, 1995.0])),
        ("sigma", dimension, &[], Values::Double(vec![12.0, 12.0, 9.0])),
        ("platform", &["observation", "letters"], &[], Values::Text(b"A\0B C\0".to_vec())),
        ("note", &["letters"], &[], Values::Integers(vec![1, 2])),
    ];
    change(&mut variables);
    written(path, &[("observation", 3), ("letters", 2)], &variables);
}

#[test]
fn files_of_others_are_read_with_units_and_fill_values() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let csv = "time,lat,lon,variable,value,sigma,id\n2026-01-15T06:00:00Z,50.5,5,h,1990.25,12,A\n\
               2026-01-15T06:00:00Z,47.25,15.5,h,2010,12,B\n2026-01-15T12:00:00Z,55,12,h,1995,9,C\n";
    std::fs::write(folder.join("o.csv"), csv).unwrap();
    write(&folder.join("o.nc"), |_| ());
    let (of_table, of_netcdf) =
        (heard(folder, &recorded("o.csv", ""), "table"), heard(folder, &recorded("o.nc", ""), "netcdf"));
    let bits = |it: &Listener| postcard::to_stdvec(&it.observed).unwrap();
    assert!(bits(&of_table) == bits(&of_netcdf) && of_table.analysed == of_netcdf.analysed);
    assert_eq!(of_netcdf.observed[&1].values, [1990.25, 2010.0]);
    // A fill value is a missing one, and a column may be given for the network.
    write(&folder.join("o.nc"), |variables| {
        variables[4].3 = Values::Double(vec![1990.25, 9.96921e36, 1995.0]);
        variables.remove(5);
    });
    std::fs::write(folder.join("s.toml"), recorded("o.nc", "sigma = 9")).unwrap();
    let output = isobar(folder, &["check", "s.toml"]);
    let said = one_line(&(text(&output.stdout) + &text(&output.stderr)));
    assert!(output.status.success() && said.contains("1 missing"), "{said}");
}

#[test]
fn faults_are_those_of_a_table_with_numbers_of_rows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let check = |more: &str| {
        std::fs::write(folder.join("s.toml"), recorded("o.nc", more)).unwrap();
        let output = isobar(folder, &["check", "s.toml"]);
        assert!(!output.status.success());
        one_line(&text(&output.stderr))
    };
    type Change = fn(&mut Vec<Variable<'_>>);
    let cases: [(&str, Change, &str); 15] = [
        (
            "",
            |it| it[5].3 = Values::Double(vec![1.0, 0.0, -1.0]),
            "row 2: `sigma` is `0`, but must be a finite number above 0",
        ),
        ("", |it| it[5].3 = Values::Double(vec![1.0, 0.0, -1.0]), "o.nc has 2 faults"),
        (
            "",
            |it| it[4].3 = Values::Double(vec![1.0, 2.0, -9999.0]),
            "o.nc, row 3: `value` is -9999, which usually marks",
        ),
        ("", |it| it[1].3 = Values::Single(vec![50.0, 95.0, 1.0]), "o.nc, row 2: `latitude_deg` is `95`"),
        ("", |it| it[3].3 = Values::Text(b"h\0q\0h\0".to_vec()), "o.nc, row 2: `variable` is `q`, but must be one of"),
        ("", |it| it[6].3 = Values::Text(b"\0\0B C\0".to_vec()), "row 1: the column `id` is empty, but must be a name"),
        ("", |it| it[0].3 = Values::Double(vec![6.0, 6.0001, 12.0]), "row 2: `time` is `6.0001 hours since"),
        ("", |it| it[0].2 = &[("units", "fortnights since 2026-01-15")], "`time` is in `fortnights since 2026-01-15`"),
        ("", |it| it[4].2 = &[("units", "km")], "row 1: `value` is in `km`, but h must be in m"),
        ("", |it| drop(it.remove(4)), "it has no variable `value`; its variables are time, lat, lon"),
        ("", |it| drop(it.remove(2)), "o.nc has no column `longitude_deg`; it has"),
        ("", |it| it[1].2 = &[("units", "radians")], "`lat` is in `radians`, but must be in degrees"),
        ("group_by = \"country\"\nreference_groups = [\"A\"]", |_| (), "o.nc has no column `country`"),
        ("only_network = \"sondes\"", |_| (), "o.nc has no column `network`"),
        ("", |it| it[4].1 = &["observation", "letters"], "`value` has 2 dimensions, but must have one"),
    ];
    for (more, change, wanted) in cases {
        write(&folder.join("o.nc"), |it| {
            change(it);
            if it.get(4).is_some_and(|it| it.1.len() == 2)
                && let Values::Double(values) = &mut it[4].3
            {
                values.extend([0.0; 3]);
            }
        });
        let said = check(more);
        assert!(said.contains(wanted), "{wanted}: {said}");
    }
    std::fs::write(folder.join("o.nc"), "time,value\n").unwrap();
    let said = check("");
    assert!(said.contains("o.nc: invalid NetCDF magic bytes"), "{said}");
    std::fs::remove_file(folder.join("o.nc")).unwrap();
    let said = check("");
    assert!(said.contains("the file of observations o.nc does not exist"), "{said}");
}

/// Places on the plane are only read where it is the same plane; else those on the Earth, if they are all that there is.
#[test]
fn places_on_another_plane_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    heard(folder, &format!("{WORLD}{SYNTHETIC}"), "first");
    std::fs::copy(folder.join("first/observations.nc"), folder.join("o.nc")).unwrap();
    let check = |scenario: &str| {
        std::fs::write(folder.join("s.toml"), scenario).unwrap();
        let output = isobar(folder, &["check", "s.toml"]);
        (output.status.success(), one_line(&text(&output.stderr)))
    };
    let (ok, said) = check(&recorded("o.nc", ""));
    assert!(ok, "{said}");
    let (ok, said) = check(&recorded("o.nc", "").replace("_latitude_deg = 50", "_latitude_deg = 52"));
    assert!(!ok && said.contains("its x and y are on another plane than that of the scenario"), "{said}");
    let along: &[&str] = &["observation"];
    write(&folder.join("o.nc"), |variables| {
        variables.push(("x", along, &[("units", "km")], Values::Single(vec![1400.0, 1500.0, 1600.0])));
        variables.push(("y", along, &[("units", "km")], Values::Single(vec![1000.0, 1100.0, 1200.0])));
    });
    let on_earth = heard(folder, &recorded("o.nc", ""), "on_earth");
    let places = |it: &Listener| it.observed[&1].reports.iter().map(|report| report.x_m.round()).collect::<Vec<_>>();
    assert!(places(&on_earth) != [1.4e6, 1.5e6], "{:?}", places(&on_earth));
    write(&folder.join("o.nc"), |variables| {
        variables.drain(1..3);
        variables.push(("x", along, &[("units", "km")], Values::Single(vec![1400.0, 1500.0, 1600.0])));
        variables.push(("y", along, &[("units", "km")], Values::Single(vec![1000.0, 1100.0, 1200.0])));
    });
    assert_eq!(places(&heard(folder, &recorded("o.nc", ""), "on_plane")), [1.4e6, 1.5e6]);
}

/// A file that is cut anywhere, or has a wrong byte, is refused or read, and never a panic.
#[test]
fn spoilt_files_are_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(&folder.join("o.nc"), |_| ());
    std::fs::write(folder.join("s.toml"), recorded("o.nc", "")).unwrap();
    let whole = std::fs::read(folder.join("o.nc")).unwrap();
    for step in 0..60 {
        let at = step * whole.len() / 60;
        let mut spoilt = whole.clone();
        spoilt[at] ^= 0xff;
        for bytes in [&whole[..at], &spoilt] {
            std::fs::write(folder.join("o.nc"), bytes).unwrap();
            let output = isobar(folder, &["check", "s.toml"]);
            let said = text(&output.stderr);
            assert!(!said.contains("panicked") && output.status.code().is_some(), "byte {at}: {said}");
        }
    }
}
