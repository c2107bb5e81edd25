//! Initial states and true states from netCDF files: what isobar writes, and what others write.
//!
//! `tests/fields/netcdf4.nc` (HDF5, compressed) and `tests/fields/netcdf3_cdf5.nc` were written by netCDF4 1.7.5 for Python: on a
//! grid of 6 × 5 cells of 100 km, with k = 6 row + column, at 00 and 06 UTC (n = 0 and 1), `z500` (standard name
//! geopotential_height, 16-bit integers with scale 0.5 and offset 5000) = 5500 + k/2 + 50 n, `ua` (x_wind, single precision) =
//! k/4 − n and `va` (y_wind) = k/10 + n but 0 in the first row.

use crate::common::{TRACER, isobar, one_line, text};
use netcdf_reader::NcFile;
use std::path::Path;
use tempfile::{TempDir, tempdir};

const WATER: &str = r#"title = "t"
phenomenon = "p"
source = "s"
seed = 1
start = "2026-01-15T00:00:00Z"
[grid]
nx = 6
ny = 5
dx_km = 100
boundary = "channel"
[model]
kind = "linear_shallow_water"
time_step_s = 300
coriolis_per_s = 1.0e-4
mean_depth_m = 5500
[initial]
kind = "netcdf"
file = "state.nc"
KEYS
[truth]
background_error_scale = 0
[background_error]
components = [{ kind = "white", variable = "h", sigma = 5 }]
[cycle]
count = 1
window_hours = 6
[methods.free]
kind = "free"
"#;

fn foreign(name: &str) -> TempDir {
    let folder = tempdir().unwrap();
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fields").join(name),
        folder.path().join("state.nc"),
    )
    .unwrap();
    folder
}

/// Whether a command succeeded, and what it said of faults, as one line.
fn command(folder: &Path, command: &[&str], scenario: &str) -> (bool, String) {
    std::fs::write(folder.join("s.toml"), scenario).unwrap();
    let output = isobar(folder, command);
    (output.status.success(), one_line(&text(&output.stderr)))
}

const RUN: [&str; 5] = ["run", "s.toml", "-q", "--no-rerun", "--no-report"];

fn numbers(folder: &Path, file: &str, variable: &str) -> Vec<f64> {
    let file = NcFile::open(folder.join(file)).unwrap();
    file.read_variable::<f64>(variable).unwrap().iter().copied().collect()
}

#[test]
fn files_of_versions_3_and_4_are_read_by_standard_names() {
    for name in ["netcdf4.nc", "netcdf3_cdf5.nc"] {
        for n in 0..2 {
            let folder = foreign(name);
            let scenario = WATER.replace("KEYS", &format!("time = 2026-01-15T0{}:00:00Z", 6 * n));
            let (ok, said) = command(folder.path(), &RUN, &scenario);
            assert!(ok, "{name}: {said}");
            let k = |number: usize| number as f64;
            let of = |variable: &str| numbers(folder.path(), "out/s/truth.nc", variable)[..30].to_vec();
            assert_eq!(of("h"), (0..30).map(|it| 5500.0 + 0.5 * k(it) + 50.0 * k(n)).collect::<Vec<_>>());
            assert_eq!(of("u"), (0..30).map(|it| 0.25 * k(it) - k(n)).collect::<Vec<_>>());
            let v = |it: usize| if it < 6 { 0.0 } else { 0.1 * k(it) + k(n) };
            assert_eq!(of("v"), (0..30).map(v).collect::<Vec<_>>());
        }
    }
}

/// The states of `truth.nc` and of a method's file, at any time, are those that were written, to the bit.
#[test]
fn what_isobar_writes_it_reads() {
    let folder = tempdir().unwrap();
    let methods = "[networks.sondes]\nkind = \"radiosonde\"\nstations = { regular = [3, 2] }\nobserve = { tracer = 0.1 }\n\
                   [methods.oi]\nkind = \"optimal_interpolation\"\n";
    let world = TRACER.replace("columns_per_step = 0", "columns_per_step = 1").replace("count = 1", "count = 3");
    let first = format!("{world}{methods}");
    let (ok, said) = command(folder.path(), &RUN, &first);
    assert!(ok, "{said}");
    std::fs::rename(folder.path().join("out/s"), folder.path().join("first")).unwrap();
    let times = numbers(folder.path(), "first/truth.nc", "time");
    let truth = numbers(folder.path(), "first/truth.nc", "tracer");
    let analysis = numbers(folder.path(), "first/oi.nc", "tracer_analysis");
    let cells = truth.len() / times.len();
    assert!(times.len() == 4 && truth[..cells] != truth[cells..2 * cells], "{times:?}");
    let table: toml::Table = first.parse().unwrap();
    for cycle in 1..times.len() {
        let time = isobar::calendar::utc(isobar_model::Time::from_seconds(times[cycle] as i64));
        let mut scenario = table.clone();
        let of = |file: &str, names: &str| -> toml::Value {
            format!("kind = \"netcdf\"\nfile = \"{file}\"\ntime = \"{time}\"\n{names}")
                .parse::<toml::Table>()
                .unwrap()
                .into()
        };
        scenario.insert("initial".into(), of("first/oi.nc", "variables = { tracer = \"tracer_analysis\" }"));
        let truth_of: toml::Table = [("initial".to_string(), of("first/truth.nc", ""))].into_iter().collect();
        scenario.insert("truth".into(), truth_of.into());
        let name = format!("run{cycle}");
        let (ok, said) =
            command(folder.path(), &[&RUN[..], &["--out", &name]].concat(), &toml::to_string(&scenario).unwrap());
        assert!(ok, "{said}");
        assert_eq!(
            numbers(folder.path(), &format!("{name}/s/truth.nc"), "tracer")[..cells],
            truth[cycle * cells..][..cells]
        );
        // The first background is the forecast from the state that was read, whose values a shift only moves.
        let background = numbers(folder.path(), &format!("{name}/s/oi.nc"), "tracer_background");
        let sorted = |values: &[f64]| {
            let mut sorted = values.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted
        };
        assert_eq!(sorted(&background[..cells]), sorted(&analysis[(cycle - 1) * cells..][..cells]));
    }
}

#[test]
fn faults_say_what_is_wrong_and_what_would_be_right() {
    let at_six = "time = \"2026-01-15T06:00:00Z\"";
    for (keys, change, wanted) in [
        ("", ("", ""), "the file has states at 2 times, from 2026-01-15T00:00:00Z to 2026-01-15T06:00:00Z"),
        ("time = \"2026-01-15T03:00:00Z\"", ("", ""), "it has no state at 2026-01-15T03:00:00Z; its 2 times are from"),
        ("time = 7", ("", ""), "`initial.time` is not a time"),
        (at_six, ("nx = 6", "nx = 8"), "`z500` is of 6 × 5 points, but the grid of 8 × 5"),
        (
            at_six,
            ("dx_km = 100", "dx_km = 90"),
            "`z500` is not on the grid: `x` is 50000 m at its point 1, and 45000 m",
        ),
        (
            &format!("{at_six}\nvariables = {{ h = \"z\" }}"),
            ("", ""),
            "it has no variable `z`; its fields are z500, ua, va",
        ),
        (&format!("{at_six}\nvariables = {{ h = \"ua\" }}"), ("", ""), "`ua` is in `m/s`, but must be in m"),
        (&format!("{at_six}\nvariables = {{ w = \"ua\" }}"), ("", ""), "unknown key `w`"),
        (at_six, ("state.nc", "s.toml"), "s.toml: invalid NetCDF magic bytes"),
        (at_six, ("state.nc", "none.nc"), "the netCDF file none.nc does not exist"),
    ] {
        let folder = foreign("netcdf4.nc");
        let scenario = WATER.replace("KEYS", keys).replace(change.0, change.1);
        let (ok, said) = command(folder.path(), &["check", "s.toml"], &scenario);
        assert!(!ok && said.contains(wanted), "{wanted}: {said}");
    }
}

/// A file that is cut anywhere, or has a wrong byte, is refused or read, and never a panic.
#[test]
fn spoilt_files_are_no_panic() {
    for name in ["netcdf4.nc", "netcdf3_cdf5.nc"] {
        let folder = foreign(name);
        let whole = std::fs::read(folder.path().join("state.nc")).unwrap();
        let scenario = WATER.replace("KEYS", "time = \"2026-01-15T06:00:00Z\"");
        for step in 0..40 {
            let at = step * whole.len() / 40;
            let mut spoilt = whole.clone();
            spoilt[at] ^= 0xff;
            for bytes in [&whole[..at], &spoilt] {
                std::fs::write(folder.path().join("state.nc"), bytes).unwrap();
                let (_, said) = command(folder.path(), &["check", "s.toml"], &scenario);
                assert!(!said.contains("panicked"), "{name}, byte {at}: {said}");
            }
        }
    }
}
