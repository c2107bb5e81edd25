//! `isobar run --from`, as the user of the program sees it: which earlier runs another may go on from, and what is refused.
#![cfg(unix)]

use crate::common::{VALID, isobar, text};
use crate::outputs::Outputs;
use crate::without_truth;
use netcdf_reader::NcFile;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const STATE: &str = "out/first/final_state.bin";

/// Where four cycles from the start of the small scenario end.
const END: &str = "2026-01-16T00:00:00Z";

fn quiet<'a>(scenario: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["run", scenario, "--quiet", "--no-report", "--no-rerun"], more].concat()
}

/// A directory with the small scenario as `first.toml`, and as `next.toml` what starts where four cycles of it end.
fn place() -> TempDir {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("first.toml"), VALID).unwrap();
    fs::write(parent.path().join("next.toml"), next(VALID)).unwrap();
    parent
}

/// The scenario with its start after four cycles.
fn next(scenario: &str) -> String {
    scenario.replace("2026-01-15T00:00:00Z", END)
}

/// The same with the first four cycles done.
fn begun() -> TempDir {
    let parent = place();
    succeeds(parent.path(), &quiet("first.toml", &["--cycles", "4"]));
    parent
}

fn succeeds(parent: &Path, arguments: &[&str]) -> String {
    let output = isobar(parent, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// What the program says as it refuses, on one line; nothing is where its files would be.
fn refused(parent: &Path, arguments: &[&str]) -> String {
    let output = isobar(parent, arguments);
    assert!([Some(1), Some(2)].contains(&output.status.code()), "{arguments:?}: {}", text(&output.stdout));
    assert!(!parent.join("out/next").exists() && !parent.join("out/.next.partial").exists());
    in_one_line(&output)
}

/// What a program says on standard error, without the frame around it.
fn in_one_line(output: &Output) -> String {
    text(&output.stderr).split_whitespace().filter(|word| !["│", "×"].contains(word)).collect::<Vec<_>>().join(" ")
}

/// The values of all variables of a netCDF file from a record on, by name: bits, so that a missing value is equal to itself.
fn records(path: &Path, from: usize) -> Vec<(String, Vec<u64>)> {
    let file = NcFile::open(path).unwrap();
    let has_time = |it: &&netcdf_reader::NcVariable| it.dimensions().first().is_some_and(|it| it.name == "time");
    let names = file.variables().unwrap().iter().filter(has_time).map(|it| it.name().to_string());
    let bits = |name: String| {
        let values = file.read_variable_as_f64(&name).unwrap();
        let records = values.shape()[0];
        let values: Vec<u64> = values.iter().map(|value| value.to_bits()).collect();
        let size = values.len() / records;
        (name, values[from * size..].to_vec())
    };
    names.map(bits).collect()
}

#[test]
fn files_of_a_run_that_goes_on_are_the_rest_of_those_of_one_run() {
    let parent = begun();
    let parent = parent.path();
    let said = succeeds(parent, &quiet("next.toml", &["--from", "out/first", "--cycles", "6"]));
    assert!(said.contains("cycles 5 to 10"), "{said}");
    succeeds(parent, &quiet("first.toml", &["--out", "whole"]));
    let (whole, last) = (parent.join("whole/first"), parent.join("out/next"));
    for file in ["truth", "free", "fkf"] {
        let file = format!("{file}.nc");
        let own = records(&last.join(&file), 0);
        assert!(own.len() >= 4, "{own:?}");
        // The truth is known before the first cycle, too.
        assert!(own == records(&whole.join(&file), 4), "{file}");
    }
    assert_eq!(fs::read(last.join("final_state.bin")).unwrap(), fs::read(whole.join("final_state.bin")).unwrap());
    assert_eq!([rows(&parent.join("out/first")), rows(&last)].concat(), rows(&whole));
}

/// The scores of every cycle of a run, line by line.
fn rows(run: &Path) -> Vec<String> {
    fs::read_to_string(run.join("scores.csv")).unwrap().lines().skip(1).map(str::to_string).collect()
}

#[test]
fn without_a_truth_the_new_observations_are_read_from_another_file() {
    let scenario = without_truth::SCENARIO.replace("count = 3", "count = 6") + "[methods.kf]\nkind = \"kf\"\n";
    let folder = without_truth::folder(&scenario);
    let folder = folder.path();
    let header = "cycle,latitude_deg,longitude_deg,variable,value,sigma,id\n";
    let tomorrow = "4,50.0,5.0,h,5410,12,A\n5,55.0,12.0,h,5290,12,C\n6,49.0,8.0,h,5480,20,Ship\n";
    let today = fs::read_to_string(folder.join("observations.csv")).unwrap();
    fs::write(folder.join("observations.csv"), today.clone() + tomorrow).unwrap();
    fs::write(folder.join("tomorrow.csv"), header.to_string() + tomorrow).unwrap();
    succeeds(folder, &quiet("s.toml", &["--out", "whole"]));
    fs::write(folder.join("observations.csv"), today).unwrap();
    succeeds(folder, &quiet("s.toml", &["--cycles", "3"]));
    let next =
        scenario.replace("2026-01-15T00:00:00Z", "2026-01-15T18:00:00Z").replace("observations.csv", "tomorrow.csv");
    fs::write(folder.join("next.toml"), next).unwrap();
    let output = isobar(folder, &quiet("next.toml", &["--from", "out/s", "--cycles", "3"]));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let (whole, last) = (folder.join("whole/s"), folder.join("out/next"));
    assert!(fs::read(whole.join("final_state.bin")).unwrap() == fs::read(last.join("final_state.bin")).unwrap());
    assert_eq!(rows(&whole)[9..], rows(&last));
    assert!(records(&last.join("etkf.nc"), 0) == records(&whole.join("etkf.nc"), 3));
    // All that the file has is of this run.
    let page = isobar(folder, &["run", "next.toml", "--from", "out/s", "--cycles", "3", "--no-rerun", "--out", "page"]);
    assert!(!text(&page.stderr).contains("observations can be used"), "{}", text(&page.stderr));
    let page = fs::read_to_string(folder.join("page/next/report.html")).unwrap();
    assert!(page.contains("3 of 3 observations can be used") && page.contains("from 3 cycles of earlier runs"));
}

#[test]
fn what_a_database_of_sensors_knows_of_the_past_is_used_once_and_recalibrations_come_when_they_come() {
    let parent = tempfile::tempdir().unwrap();
    let parent = parent.path();
    let header = "record,sensor,time,value,sigma,reference,other_sensor,unit,x_m,y_m,origin,note\n";
    let sensor = "sensor,sondes/h/B,,,,,,m,,,,\n";
    let calibration = "calibration,sondes/h/B,2026-01-01T00:00:00Z,3.25,4,,,,,,laboratory,\n";
    let step = |time: &str| format!("recalibration,sondes/h/B,{time},5,0.5,,,,,,,\n");
    let import = |database: &str, records: String| {
        fs::write(parent.join("records.csv"), header.to_string() + sensor + &records).unwrap();
        succeeds(parent, &["sensors", "import", database, "records.csv"]);
    };
    let scenario = format!("{VALID}\n[sensors]\ndatabase = \"known.db\"\nwrites = \"fkf\"\n");
    fs::write(parent.join("first.toml"), &scenario).unwrap();
    fs::write(parent.join("next.toml"), next(&scenario)).unwrap();
    // All is known from the start.
    import("all.db", calibration.to_string() + &step("2026-01-16T06:00:00Z"));
    succeeds(parent, &quiet("first.toml", &["--out", "whole", "--sensors", "all.db"]));
    // The recalibration is announced between two runs; what the first has written back is of its end.
    import("known.db", calibration.into());
    succeeds(parent, &quiet("first.toml", &["--cycles", "4"]));
    import("known.db", step("2026-01-16T06:00:00Z") + &step("2026-01-15T12:00:00Z"));
    let output =
        isobar(parent, &["run", "next.toml", "--from", "out/first", "--cycles", "6", "--no-rerun", "--no-report"]);
    let said = text(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("1 recalibrations came to be known after the cycle"), "{said}");
    for method in ["free.nc", "fkf.nc"] {
        assert!(
            records(&parent.join("out/next").join(method), 0) == records(&parent.join("whole/first").join(method), 4)
        );
    }
    assert!(
        fs::read(parent.join("out/next/final_state.bin")).unwrap()
            == fs::read(parent.join("whole/first/final_state.bin")).unwrap()
    );
    let last = |database: &str| {
        let exported = succeeds(parent, &["sensors", "export", database]);
        let is_last = |line: &&str| line.starts_with("calibration,sondes/h/B,2026-01-17T12:00:00Z");
        exported.lines().find(is_last).map(|line| line.split(',').take(5).collect::<Vec<_>>().join(",")).unwrap()
    };
    assert_eq!(last("all.db"), last("known.db"));
}

#[test]
fn a_method_that_has_failed_stays_failed_and_the_others_go_on() {
    let parent = tempfile::tempdir().unwrap();
    let parent = parent.path();
    let astray = "\n[methods.astray]\nkind = \"3dvar\"\nbias = \"ignore\"\ncovariance_scale = 1e-9\n";
    let scenario = VALID.replace("value = 10", "value = -8000") + astray;
    fs::write(parent.join("first.toml"), &scenario).unwrap();
    fs::write(parent.join("next.toml"), scenario.replace("2026-01-15T00:00:00Z", "2026-01-16T12:00:00Z")).unwrap();
    let fails = |arguments: &[&str]| {
        let output = isobar(parent, arguments);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        text(&output.stdout) + &text(&output.stderr)
    };
    fails(&quiet("first.toml", &["--out", "whole"]));
    fails(&quiet("first.toml", &["--cycles", "6"]));
    let said = fails(&["run", "next.toml", "--from", "out/first", "--cycles", "4", "--no-rerun"]);
    assert!(said.contains("astray: failed in cycle 5: the filter has diverged"), "{said}");
    let (whole, last) = (parent.join("whole/first"), parent.join("out/next"));
    for file in ["astray.nc", "fkf.nc"] {
        assert!(records(&last.join(file), 0) == records(&whole.join(file), 6), "{file}");
    }
    assert!(fs::read(whole.join("final_state.bin")).unwrap() == fs::read(last.join("final_state.bin")).unwrap());
    // It can be left behind.
    let others = ["--from", "out/first", "--cycles", "4", "--methods", "free,fkf", "--out", "others"];
    succeeds(parent, &quiet("next.toml", &others));
}

#[test]
fn what_does_not_fit_is_listed_with_key_before_and_now() {
    let parent = begun();
    let parent = parent.path();
    let from = |name: &str| refused(parent, &quiet("next.toml", &["--from", name]));
    // The same scenario again.
    fs::write(parent.join("next.toml"), VALID).unwrap();
    let said = from("out/first");
    assert!(said.contains("cannot go on from out/first") && said.contains(&format!("`start = \"{END}\"`")), "{said}");
    // What is another in everything.
    let mut scenario = next(VALID);
    for (old, new) in [
        ("seed = 1\n", "seed = 2\n"),
        ("dx_km = 100", "dx_km = 110"),
        ("time_step_s = 600", "time_step_s = 300"),
        ("sigma_height_m = 10,", "sigma_height_m = 11,"),
        ("swath_width_km = 300", "swath_width_km = 330"),
        ("blocks = \"cell\"", "blocks = \"domain\""),
        ("[methods.free]", "[methods.other]"),
        ("variable = \"h\"\nsigma = 20", "variable = \"h\"\nsigma = 21"),
    ] {
        assert_eq!(scenario.matches(old).count(), 1, "{old}");
        scenario = scenario.replace(old, new);
    }
    fs::write(parent.join("next.toml"), scenario).unwrap();
    let said = from("out/first");
    for line in [
        "seed: 1 before, 2 now",
        "methods: that run has no state of other, but of free, fkf",
        "background_error.components[0].sigma_height_m: 10 before, 11 now",
        "grid.dx_km: 100 before, 110 now",
        "model.time_step_s: 600 before, 300 now",
        "methods.fkf.blocks: \"cell\" before, \"domain\" now",
        "networks.polar.swath_width_km: 300 before, 330 now",
        "networks.sondes.bias[0].sigma: 20 before, 21 now",
    ] {
        assert!(said.contains(line), "{line}: {said}");
    }
    // What may differ, and a method that is left out.
    let free = next(VALID).replace("title = \"A test\"", "title = \"Another\"").replace("count = 10", "count = 3");
    fs::write(parent.join("next.toml"), free.replace("[methods.free]\nkind = \"free\"\n", "")).unwrap();
    succeeds(parent, &quiet("next.toml", &["--from", "out/first"]));
    fs::remove_dir_all(parent.join("out/next")).unwrap();
    // What has come to be left out has no state any more.
    succeeds(parent, &quiet("next.toml", &["--from", "out/first", "--out", "one"]));
    let third = free.replace(END, "2026-01-16T18:00:00Z");
    fs::write(parent.join("next.toml"), third).unwrap();
    assert!(from("one/next").contains("that run has no state of free, but of fkf"));
    succeeds(parent, &quiet("next.toml", &["--from", "one/next", "--methods", "fkf"]));
}

#[test]
fn only_the_state_of_a_complete_run_of_this_version_is_gone_on_from() {
    let parent = begun();
    let parent = parent.path();
    let from = |name: &str| refused(parent, &quiet("next.toml", &["--from", name]));
    assert!(from("out/nothing").contains("out/nothing: there is no such directory"));
    assert!(from("out").contains("it is not the directory of a run: it has no summary.json"));
    assert!(from("first.toml").contains("there is no such directory"));
    succeeds(parent, &quiet("first.toml", &["--cycles", "4", "--no-state", "--out", "bare"]));
    assert!(from("bare/first").contains("it has no final_state.bin: the run was made with --no-state"));
    succeeds(parent, &["run", "first.toml", "--seeds", "3", "--quiet", "--all-files", "--out", "seeds"]);
    assert!(from("seeds/first").contains("it holds a batch of runs"));

    let good = fs::read(parent.join(STATE)).unwrap();
    type Spoil<'a> = &'a dyn Fn(&[u8]) -> Vec<u8>;
    let first_line = good.iter().position(|&byte| byte == b'\n').unwrap();
    let spoilt: [(Spoil<'_>, &str); 7] = [
        (&|bytes| bytes[..bytes.len() - 9].to_vec(), "final_state.bin: it is damaged"),
        (&|bytes| bytes[..first_line + 3].to_vec(), "final_state.bin: it is damaged"),
        (&|_| Vec::new(), "final_state.bin: it is not a final state"),
        (&|bytes| bytes.iter().rev().copied().collect(), "final_state.bin: it is not a final state"),
        (&|bytes| [b"isobar final state 0", &bytes[20..]].concat(), "it is a final state of another format"),
        (
            &|bytes| [b"isobar final state 4, version 0.0.1", &bytes[first_line..]].concat(),
            "written by isobar 0.0.1, and",
        ),
        (
            &|bytes| {
                let mut changed = bytes.to_vec();
                changed[bytes.len() / 2] ^= 1;
                changed
            },
            "final_state.bin: it is damaged",
        ),
    ];
    for (spoil, expected) in spoilt {
        fs::write(parent.join(STATE), spoil(&good)).unwrap();
        let said = from("out/first");
        assert!(said.contains(expected), "{expected}: {said}");
    }
    // A pipe, a link and a hole of a terabyte.
    fs::remove_file(parent.join(STATE)).unwrap();
    assert!(Command::new("mkfifo").arg(parent.join(STATE)).status().unwrap().success());
    assert!(from("out/first").contains("final_state.bin: "));
    fs::remove_file(parent.join(STATE)).unwrap();
    std::os::unix::fs::symlink("/dev/zero", parent.join(STATE)).unwrap();
    assert!(from("out/first").contains("final_state.bin: "));
    fs::remove_file(parent.join(STATE)).unwrap();
    fs::File::create(parent.join(STATE)).unwrap().set_len(1 << 40).unwrap();
    assert!(from("out/first").contains("it is not a final state"));
    fs::write(parent.join(STATE), good).unwrap();
    succeeds(parent, &quiet("next.toml", &["--from", "out/first"]));
}

#[test]
fn what_cannot_be_combined_is_refused_and_nothing_is_lost() {
    let parent = begun();
    let parent = parent.path();
    let before = fs::read(parent.join(STATE)).unwrap();
    let run = |more: &[&str]| refused(parent, &[&["run"], more, &["--quiet", "--from", "out/first"]].concat());
    assert!(run(&["next.toml", "--seeds", "3"]).contains("--seeds"));
    assert!(run(&["next.toml", "first.toml"]).contains("next and first cannot both go on from out/first"));
    // Over itself, under whatever name.
    fs::write(parent.join("first.toml"), next(VALID)).unwrap();
    for out in ["out", "./out/../out"] {
        let said = run(&["first.toml", "--out", out, "--overwrite"]);
        assert!(said.contains("that is where this run's files are to go: choose another --out"), "{said}");
    }
    assert_eq!(fs::read(parent.join(STATE)).unwrap(), before);
    // No cycle would count.
    let late = next(VALID).replace("score_from_cycle = 2", "score_from_cycle = 9");
    fs::write(parent.join("next.toml"), late).unwrap();
    assert!(run(&["next.toml", "--cycles", "3"]).contains("cycles go on and 7 is the last; now 9"));
    // An interrupted run that is to be replaced is there until the new one can begin.
    fs::write(parent.join("next.toml"), next(VALID)).unwrap();
    interrupt(parent);
    let output = isobar(parent, &quiet("next.toml", &["--from", "out/nothing", "--overwrite"]));
    assert_eq!(output.status.code(), Some(1));
    succeeds(parent, &["resume", "out/next", "--quiet"]);
}

/// Starts `next.toml` from the state of the first run, and kills it once it has a checkpoint.
fn interrupt(parent: &Path) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    let more = ["--from", "out/first", "--cycles", "60", "--checkpoint-cycles", "1"];
    command.current_dir(parent).args(quiet("next.toml", &more)).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let has_checkpoint = || {
        let entries = fs::read_dir(parent.join("out/.next.partial")).into_iter().flatten();
        let mut names = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
        names.any(|name| name.starts_with("checkpoint-") && !name.ends_with("new"))
    };
    while !has_checkpoint() {
        assert!(child.try_wait().unwrap().is_none(), "the run was too fast");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_that_goes_on_is_resumed_without_the_earlier_one() {
    let parent = begun();
    let parent = parent.path();
    interrupt(parent);
    fs::write(parent.join("third.toml"), next(VALID)).unwrap();
    let output = isobar(parent, &quiet("third.toml", &["--from", "out/next"]));
    assert_eq!(output.status.code(), Some(1));
    let said = in_one_line(&output);
    assert!(said.contains("that run is not complete: `isobar resume out/next` goes on with it"), "{said}");
    fs::rename(parent.join("out/first"), parent.join("gone")).unwrap();
    succeeds(parent, &["resume", "out/next", "--quiet"]);
    let undisturbed = ["--from", "gone", "--cycles", "60", "--out", "again"];
    succeeds(parent, &quiet("next.toml", &undisturbed));
    let (own, other) = (Outputs::of(&parent.join("out/next")), Outputs::of(&parent.join("again/next")));
    assert!(own.files.contains_key("final_state.bin"));
    other.assert_same(&own, "after an interruption");
}

#[test]
#[cfg(target_os = "linux")]
fn a_daily_system_that_is_killed_at_random_ends_as_one_run() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/examples/daily.sh");
    let output = Command::new("sh").arg(script).args([env!("CARGO_BIN_EXE_isobar"), "3"]).output().unwrap();
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(output.status.success(), "{said}");
    println!("{said}");
    assert!(said.contains("3 days, ") && !said.contains(", 0 runs were killed"), "{said}");
}
