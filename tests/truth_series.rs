//! A truth whose states are in a netCDF file, `truth.kind = "series"`.

use crate::ahead::{Listener, TRACER};
use crate::common::{isobar, one_line, text};
use crate::written::{Values, written};
use isobar::options::{CheckpointPolicy, RunOptions};
use isobar::output::{Outputs, STATE};
use isobar::run::run;
use isobar::scenario::Scenario;
use netcdf_reader::NcFile;
use std::path::Path;

const METHODS: &str = "[forecast]\nlead_hours = 12\n[methods]\nfree = { kind = \"free\" }\nkf = { kind = \"kf\", smoother_lag_cycles = 2 }\n\
                       letkf = { kind = \"letkf\", members = 6, localization_radius_km = 400 }\n";

const SERIES: &str = "[truth]\nkind = \"series\"\nfile = \"nature.nc\"\n";

const CYCLES: usize = 14;

/// The values of the tracer's cells at the start and after every cycle.
type States = Vec<Vec<f64>>;

fn parse(folder: &Path, parts: &[&str]) -> Scenario {
    Scenario::parse(&folder.join("s.toml"), &parts.concat()).unwrap()
}

fn options(folder: &Path, name: &str, cycles: usize) -> RunOptions {
    RunOptions {
        cycles: Some(cycles),
        threads: Some(1),
        outputs: Outputs::of(["netcdf", STATE]),
        ..RunOptions::new(folder.join(name))
    }
}

fn heard(scenario: &Scenario, options: &RunOptions) -> Listener {
    let mut listener = Listener::default();
    run(scenario, options, &mut listener).unwrap();
    listener
}

/// A run of a model as truth, whose `truth.nc` becomes `nature.nc`.
fn twin(folder: &Path) -> Listener {
    let twin = heard(&parse(folder, &[TRACER, METHODS]), &options(folder, "twin", CYCLES));
    std::fs::copy(folder.join("twin/truth.nc"), folder.join("nature.nc")).unwrap();
    twin
}

fn states(listener: &Listener) -> States {
    listener.truth.values().map(|state| state.values().to_vec()).collect()
}

/// Writes states, from the start or a later number of cycles on, as somebody else would, in single precision and hours.
fn write(path: &Path, states: &States, from: usize) {
    let hours: Vec<f64> = (0..states.len()).map(|number| (6 * (number + from)) as f64).collect();
    let values: Vec<f32> = states.iter().flatten().map(|&value| value as f32).collect();
    write_with(path, "tracer", "1", &hours, values);
}

fn write_with(path: &Path, name: &str, unit: &str, hours: &[f64], values: Vec<f32>) {
    let dimensions = [("time", hours.len()), ("y", 6), ("x", 9)];
    written(
        path,
        &dimensions,
        &[
            ("time", &["time"], &[("units", "hours since 2026-01-15 00:00:00")], Values::Double(hours.to_vec())),
            (name, &["time", "y", "x"], &[("units", unit)], Values::Single(values)),
        ],
    );
}

/// `truth.nc` is in double precision, so that all that follows from the truth is the same to the bit.
#[test]
fn the_truth_of_a_run_gives_the_same_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let twin = twin(folder);
    let series = heard(&parse(folder, &[TRACER, METHODS, SERIES]), &options(folder, "series", CYCLES));
    assert!(twin.analysed.len() == 3 * CYCLES && twin.forecasts.len() > 3 * CYCLES && twin.truth.len() == CYCLES + 1);
    assert!(twin.truth == series.truth && twin.observed.len() == CYCLES);
    let bits = |it: &Listener| postcard::to_stdvec(&it.observed).unwrap();
    assert!(bits(&twin) == bits(&series), "other observations");
    assert!(twin.analysed == series.analysed && twin.forecasts == series.forecasts, "other estimates or scores");
    let file = NcFile::open(folder.join("series/truth.nc")).unwrap();
    let source = file.global_attribute("source").unwrap().value.as_string().unwrap();
    assert!(source.ends_with("testbed; truth: the states of nature.nc"), "{source}");
    // Another seed has other observations of the same truth.
    let other = RunOptions { seed: Some(99), ..options(folder, "other", CYCLES) };
    let other = heard(&parse(folder, &[TRACER, METHODS, SERIES]), &other);
    assert!(other.truth == twin.truth && bits(&other) != bits(&twin));
}

/// In single precision the truth is that of the file, and all else is as near as that.
#[test]
fn a_file_in_single_precision_is_as_near_as_that() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let twin = twin(folder);
    write(&folder.join("nature.nc"), &states(&twin), 0);
    let series = heard(&parse(folder, &[TRACER, METHODS, SERIES]), &options(folder, "series", CYCLES));
    let (double, single) = (states(&twin), states(&series));
    for (double, single) in double.iter().flatten().zip(single.iter().flatten()) {
        assert_eq!(f64::from(*double as f32), *single);
    }
    assert!(twin.truth != series.truth);
    let nearest = 6e-8 * double.iter().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
    for (twin, series) in twin.observed.values().zip(series.observed.values()) {
        assert_eq!(twin.values.len(), series.values.len());
        for (twin, series) in twin.values.iter().zip(&series.values) {
            assert!((twin - series).abs() < 3.0 * nearest, "{twin}, {series}");
        }
    }
    for (key, (_, _, scores)) in &twin.analysed {
        let other = &series.analysed[key].2;
        for (name, score) in scores.iter() {
            assert!(
                (score - other[name]).abs() < 1e-4 * (1.0 + score.abs()),
                "{key:?} {name}: {score}, {}",
                other[name]
            );
        }
    }
}

/// Runs of some days, each with a file of its own, are one run; a truth that does not go on from the last is refused.
#[test]
fn a_run_goes_on_with_the_next_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let states = states(&twin(folder));
    write(&folder.join("nature.nc"), &states, 0);
    let scenario = parse(folder, &[TRACER, METHODS, SERIES]);
    let whole = heard(&scenario, &options(folder, "whole", CYCLES));
    write(&folder.join("first.nc"), &states[..=6].to_vec(), 0);
    let first = SERIES.replace("nature", "first");
    let first = heard(&parse(folder, &[TRACER, METHODS, &first]), &options(folder, "first", 6));
    let from = |name: &str| RunOptions { from: Some(folder.join("first")), ..options(folder, name, CYCLES - 6) };
    let second = |file: &str| {
        let mut scenario = parse(folder, &[TRACER, METHODS, &SERIES.replace("nature", file)]);
        scenario.start = scenario.start + scenario.cycle.window * 6;
        scenario
    };
    write(&folder.join("second.nc"), &states[6..].to_vec(), 6);
    let rest = heard(&second("second"), &from("second"));
    let keys = |it: &Listener| it.observed.keys().copied().collect::<Vec<_>>();
    assert_eq!((keys(&first), keys(&rest)), ((1..=6).collect(), (7..=CYCLES).collect()));
    assert!(rest.analysed.iter().all(|(key, own)| *own == whole.analysed[key]) && rest.analysed.len() == 3 * 8);
    assert!(rest.truth.iter().all(|(cycle, state)| *state == whole.truth[cycle]) && rest.truth.len() == 9);
    let mut other = states[6..].to_vec();
    other[0][4] += 1.0;
    write(&folder.join("other.nc"), &other, 6);
    let refusal = |file: &str| {
        let error = run(&second(file), &from("refused"), &mut Listener::default()).unwrap_err();
        assert!(!folder.join("refused").exists());
        error.to_string()
    };
    let said = refusal("other");
    assert!(said.contains("truth.file: at 2026-01-16T12:00:00Z other.nc has another truth"), "{said}");
    write(&folder.join("short.nc"), &states[6..CYCLES].to_vec(), 6);
    let said = refusal("short");
    assert!(said.contains("short.nc: it has no state at 2026-01-18T12:00:00Z; its 8 times are from"), "{said}");
    // What comes next is asked at the end of the last file.
    std::fs::write(folder.join("s.toml"), [TRACER, METHODS, SERIES].concat()).unwrap();
    let output = isobar(folder, &["advise", "s.toml", "--from", "whole", "--method", "kf", "--mean", "tracer"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[test]
fn an_interrupted_run_goes_on_with_the_same_file_only() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let states = states(&twin(folder));
    write(&folder.join("nature.nc"), &states, 0);
    let scenario = || parse(folder, &[TRACER, METHODS, SERIES]);
    let whole = heard(&scenario(), &options(folder, "whole", CYCLES));
    let checkpoints = Some(CheckpointPolicy { minutes: None, cycles: Some(2) });
    let options = RunOptions { checkpoints, ..options(folder, "part", CYCLES) };
    run(&scenario(), &options, &mut Listener { end: Some(6), ..Listener::default() }).unwrap_err();
    let options = RunOptions { resume: true, ..options };
    let mut other = states.clone();
    other[9][4] += 1.0;
    write(&folder.join("nature.nc"), &other, 0);
    let said = run(&scenario(), &options, &mut Listener::default()).unwrap_err().to_string();
    assert!(said.contains("what it reads has changed since: nature.nc"), "{said}");
    write(&folder.join("nature.nc"), &states, 0);
    let resumed = heard(&scenario(), &options);
    assert!(resumed.analysed == whole.analysed && resumed.truth == whole.truth);
}

#[test]
fn seeds_share_the_truth_and_exact_errors_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    twin(folder);
    std::fs::write(folder.join("s.toml"), [TRACER, METHODS, SERIES].concat()).unwrap();
    let command = ["run", "s.toml", "--seeds", "3", "--cycles", "4", "-q", "--methods", "kf", "--out", "seeds"];
    let output = isobar(folder, &command);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let summaries: Vec<serde_json::Value> = std::fs::read_dir(folder.join("seeds/s"))
        .unwrap()
        .map(|entry| entry.unwrap().path().join("summary.json"))
        .filter(|path| path.is_file())
        .map(|path| serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap())
        .collect();
    let [first, second, _] = &summaries[..] else { panic!("{} summaries", summaries.len()) };
    assert!(first["truth_checksum"].is_number() && first["truth_checksum"] == second["truth_checksum"]);
    assert_ne!(first["methods"], second["methods"]);
    let output = isobar(folder, &["exact", "s.toml"]);
    let said = one_line(&text(&output.stderr));
    assert!(!output.status.success() && said.contains("not of the states of nature.nc"), "{said}");
}

#[test]
fn faults_name_variable_time_and_cell() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let states = states(&twin(folder));
    let world = [TRACER, METHODS, SERIES].concat();
    let check = |change: (&str, &str)| {
        std::fs::write(folder.join("s.toml"), world.replace(change.0, change.1)).unwrap();
        let output = isobar(folder, &["check", "s.toml"]);
        (output.status.success(), one_line(&text(&output.stderr)))
    };
    let (ok, said) = check(("", ""));
    assert!(ok, "{said}");
    for (change, wanted) in [
        (("count = 14", "count = 15"), "nature.nc: it has no state at 2026-01-18T18:00:00Z; its 15 times are from"),
        (("start = \"2026-01-15T00", "start = \"2026-01-14T18"), "it has no state at 2026-01-14T18:00:00Z"),
        (("window_hours = 6", "window_hours = 3"), "it has no state at 2026-01-15T03:00:00Z"),
        (("nx = 9", "nx = 8"), "`tracer` is of 9 × 6 points, but the grid of 8 × 6"),
        (("dx_km = 100", "dx_km = 90"), "`tracer` is not on the grid: `x` is 50000 m at its point 1"),
        (("nature.nc", "none.nc"), "the netCDF file none.nc does not exist"),
        (("file = \"nature.nc\"", ""), "`file` is missing in [truth]"),
        (("nature.nc\"", "nature.nc\"\nvariables = { tracer = \"q\" }"), "it has no variable `q`; its fields are"),
        (
            ("nature.nc\"", "nature.nc\"\nmodel_error_scale = 2"),
            "`truth.model_error_scale` is of a truth that is a model run",
        ),
        (("kind = \"series\"", ""), "`truth.file` goes with `kind = \"series\"` of the truth"),
        (("\"series\"", "\"none\""), "there is no truth that network fixed could observe"),
        (("\"series\"", "\"serie\""), "series"),
    ] {
        let (ok, said) = check(change);
        assert!(!ok && said.contains(wanted), "{wanted}: {said}");
    }
    let hours: Vec<f64> = (0..states.len()).map(|number| 6.0 * number as f64).collect();
    let values: Vec<f32> = states.iter().flatten().map(|&value| value as f32).collect();
    let with = |cell: usize, value: f32| {
        let mut values = values.clone();
        values[3 * 54 + cell] = value;
        values
    };
    let swapped: Vec<f64> = [0.0, 12.0, 6.0].into_iter().chain(hours[3..].iter().copied()).collect();
    let tenth: Vec<f64> = hours.iter().map(|hour| hour + 0.1001).collect();
    for (name, unit, hours, values, wanted) in [
        (
            "tracer",
            "1",
            &hours,
            with(20, f32::NAN),
            "`tracer` has no value at 2026-01-15T18:00:00Z in column 3, row 3 of the grid",
        ),
        (
            "tracer",
            "1",
            &hours,
            with(0, 9.96921e36),
            "`tracer` has no value at 2026-01-15T18:00:00Z in column 1, row 1 of",
        ),
        ("tracer", "kg", &hours, values.clone(), "`tracer` is in `kg`, but must be in 1"),
        ("q", "1", &hours, values.clone(), "it has no variable `tracer`"),
        ("tracer", "1", &swapped, values.clone(), "the times of `time` do not ascend at 2026-01-15T06:00:00Z"),
        ("tracer", "1", &tenth, values.clone(), "`time` has the value 0.1001, which is not a whole number of seconds"),
    ] {
        write_with(&folder.join("nature.nc"), name, unit, hours, values);
        let (ok, said) = check(("", ""));
        assert!(!ok && said.contains(wanted), "{wanted}: {said}");
    }
    let dimensions = [("y", 6), ("x", 9)];
    let field = Values::Single(values[..54].to_vec());
    written(&folder.join("nature.nc"), &dimensions, &[("tracer", &["y", "x"], &[("units", "1")], field)]);
    let (ok, said) = check(("", ""));
    assert!(!ok && said.contains("nature.nc does not say of what times its states are"), "{said}");
}
