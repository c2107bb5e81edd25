//! Batches and runs that end before their time: what they go on with, and what they refuse.
#![cfg(unix)]

use crate::common::{VALID, isobar, one_line, text};
use isobar::output::destination::complete_runs;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const STATIONS: &str = "id,x_m,y_m,group\n1,210000,220000,A\n2,430000,310000,B\n";

const SENSORS: &str = "record,sensor,unit,time,origin,value,sigma\nsensor,sondes/h/B,m,,,,\n\
                       calibration,sondes/h/B,,2026-01-01T00:00:00Z,bench,4,1\n";

/// A project that reads stations, observations, a state and a database of sensors.
fn project() -> TempDir {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let buoys = "[networks.buoys]\nkind = \"file\"\nfile = \"data/buoys.csv\"\nvariable = \"h\"\nsigma = 5\n\
                 [sensors]\ndatabase = \"data/sensors.db\"\n";
    let jet = "kind = \"jet\"\nmean_depth_m = 1000\nspeed_m_per_s = 10\nwidth_km = 200";
    assert!(VALID.contains(jet));
    let scenario = VALID
        .replace("{ regular = [3, 2] }", "{ file = \"data/stations.csv\" }")
        .replace("groups = [\"A\", \"B\"]\n", "group_by = \"group\"\n")
        .replace("[methods.free]", &format!("{buoys}\n[methods.free]"))
        .replace(jet, "kind = \"file\"\nfile = \"data/state.csv\"");
    fs::create_dir(here.join("data")).unwrap();
    let write = |name: &str, text: &str| fs::write(here.join(name), text).unwrap();
    write("small.toml", &scenario);
    write("data/stations.csv", STATIONS);
    write("data/buoys.csv", &("cycle,x_m,y_m,value\n".to_string() + &rows(40, |c| format!("{c},3e5,2e5,1000\n"))));
    write("data/state.csv", &("h,u,v\n".to_string() + &rows(48, |_| "1000,0,0\n".into())));
    write("sensors.csv", SENSORS);
    let imported = isobar(here, &["sensors", "import", "data/sensors.db", "sensors.csv"]);
    assert!(imported.status.success(), "{}", text(&imported.stderr));
    directory
}

fn rows(count: usize, row: impl Fn(usize) -> String) -> String {
    (1..=count).map(row).collect()
}

/// Starts a batch, and ends it when some of its runs are complete.
fn interrupt(here: &Path, arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(here).args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let partial = fs::canonicalize(here).unwrap().join("out");
    let complete = || {
        let Ok(entries) = fs::read_dir(&partial) else { return 0 };
        entries.map(|entry| complete_runs(&entry.unwrap().path().join("outputs"))).sum::<usize>()
    };
    while complete() < 2 {
        assert!(child.try_wait().unwrap().is_none(), "the batch was too fast");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

/// What is said to standard error, without line breaks; the exit code is this one.
fn said(here: &Path, arguments: &[&str], code: i32) -> String {
    let output = isobar(here, arguments);
    let said = one_line(&text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{said}");
    said
}

const SEEDS: [&str; 8] = ["run", "small.toml", "--quiet", "--seeds", "8", "--cycles", "40", "--no-report"];

#[test]
fn a_batch_goes_on_only_with_what_it_began_with_and_a_remark_is_nothing() {
    let project = project();
    let here = project.path();
    interrupt(here, &SEEDS);
    let plan = here.join("out/.small.partial/batch.json");
    let (before, inode) = (fs::read(&plan).unwrap(), fs::metadata(&plan).unwrap().ino());
    let kept = complete_runs(&here.join("out/.small.partial/outputs"));
    for (name, old, new) in [
        ("data/stations.csv", "430000", "430001"),
        ("data/buoys.csv", "40,3e5,2e5,1000", "40,3e5,2e5,1001"),
        ("data/state.csv", "1000,0,0", "1000,0.1,0"),
    ] {
        let contents = fs::read_to_string(here.join(name)).unwrap();
        assert!(contents.contains(old));
        fs::write(here.join(name), contents.replacen(old, new, 1)).unwrap();
        let refused = said(here, &["resume", "out/small", "--quiet"], 1);
        assert!(refused.contains(&format!("what it reads has changed since: {name}")), "{refused}");
        fs::write(here.join(name), format!("# a remark\n\n{}", contents.replace('\n', "\r\n"))).unwrap();
    }
    let database = fs::read(here.join("data/sensors.db")).unwrap();
    fs::write(here.join("sensors.csv"), SENSORS.replace("01T00:00:00Z,bench,4", "02T00:00:00Z,bench,5")).unwrap();
    assert!(isobar(here, &["sensors", "import", "data/sensors.db", "sensors.csv"]).status.success());
    let refused = said(here, &["resume", "out/small", "--quiet"], 1);
    assert!(refused.contains("what is known of its sensors has changed since, in data/sensors.db"), "{refused}");
    fs::write(here.join("data/sensors.db"), database).unwrap();
    // Nothing was lost meanwhile, and the plan was not written again.
    assert_eq!(complete_runs(&here.join("out/.small.partial/outputs")), kept);
    assert!(fs::read(&plan).unwrap() == before && fs::metadata(&plan).unwrap().ino() == inode);
    said(here, &["resume", "out/small", "--quiet"], 0);
    assert!(here.join("out/small/seeds.json").is_file());
}

/// Whole projects, with all that they read, and a run or a batch in the making.
#[test]
fn what_was_moved_goes_on_and_what_is_missing_is_named() {
    let arguments =
        |more: &[&'static str]| [&["run", "small.toml", "--quiet", "--no-report", "--no-rerun"], more].concat();
    for more in [&["--seeds", "8", "--cycles", "40"][..], &["--cycles", "40", "--checkpoint-cycles", "1"]] {
        let (moved, parent) = (project(), tempfile::tempdir().unwrap());
        if more[0] == "--seeds" {
            interrupt(moved.path(), &arguments(more));
        } else {
            interrupt_run(moved.path(), &arguments(more));
        }
        let place = parent.path().join("elsewhere");
        fs::rename(moved.path(), &place).unwrap();
        fs::rename(place.join("data"), place.join("dates")).unwrap();
        let refused = said(&place, &["resume", "out/small", "--quiet"], 1);
        assert!(refused.contains("elsewhere/data/state.csv does not exist"), "{refused}");
        fs::rename(place.join("dates"), place.join("data")).unwrap();
        said(parent.path(), &["resume", "elsewhere/out/small", "--quiet"], 0);
    }
}

/// Starts a run, and kills it when it has a checkpoint.
fn interrupt_run(here: &Path, arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(here).args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let working = here.join("out/.small.partial");
    let has_checkpoint = || {
        let Ok(entries) = fs::read_dir(&working) else { return false };
        let names = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
        names.into_iter().any(|name| name.starts_with("checkpoint-") && !name.ends_with("new"))
    };
    while !has_checkpoint() {
        assert!(child.try_wait().unwrap().is_none(), "the run was too fast");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_damaged_plan_says_where_the_complete_runs_are() {
    let project = project();
    let here = project.path();
    interrupt(here, &SEEDS);
    fs::write(here.join("out/.small.partial/batch.json"), "").unwrap();
    let refused = said(here, &["resume", "out/small", "--quiet"], 1);
    assert!(refused.contains("its batch cannot be continued: EOF"), "{refused}");
    assert!(refused.contains("what is complete of it is in out/.small.partial"), "{refused}");
    assert!(complete_runs(&here.join("out/.small.partial/outputs")) >= 2);
}

/// Every setting is a scenario that can be used where it stands, also after the whole project has moved.
#[test]
fn the_scenarios_of_a_sweep_can_be_run() {
    let (project, parent) = (project(), tempfile::tempdir().unwrap());
    let here = project.path();
    let scenario = fs::read_to_string(here.join("small.toml")).unwrap();
    let sweep = "\n[sweep]\n[sweep.vary]\n\"networks.polar.sigma\" = [20, 30]\n";
    fs::write(here.join("small.toml"), scenario + sweep).unwrap();
    let output = isobar(here, &["sweep", "small.toml", "--quiet", "--cycles", "2", "--out", "results/of today"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let folder = "results/of today/small-sweep";
    assert!(isobar(here, &["check", &format!("{folder}/setting-0001/scenario.toml")]).status.success());
    let place = parent.path().join("moved");
    fs::rename(here, &place).unwrap();
    let own = place.join(folder).join("setting-0002");
    let run = isobar(&own, &["run", "scenario.toml", "--quiet", "--no-rerun", "--no-report", "--cycles", "2"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let summary = |path: &Path| -> isobar::scores::Summary {
        serde_json::from_str(&fs::read_to_string(path.join("summary.json")).unwrap()).unwrap()
    };
    let (alone, swept) = (summary(&own.join("out/scenario")), summary(&own.join("seed-1")));
    assert_eq!(alone.methods["fkf"].values["rmse_analysis.h"], swept.methods["fkf"].values["rmse_analysis.h"]);
}

/// Who reads only standard error learns of it too.
#[test]
fn what_fails_in_a_batch_is_said_to_standard_error() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let blind = "\n[methods.sinking]\nkind = \"3dvar\"\nbias = \"ignore\"\n";
    let deep = VALID.replace("value = 10", "value = -8000") + blind;
    fs::write(here.join("deep.toml"), &deep).unwrap();
    let failed = said(here, &["run", "deep.toml", "--quiet", "--seeds", "3", "--no-report"], 1);
    assert!(failed.contains("deep: failed: seed 1, method sinking: failed in cycle"), "{failed}");
    let sweep = "\n[sweep]\n[sweep.vary]\n\"networks.polar.sigma\" = [20, 30]\n";
    fs::write(here.join("deep.toml"), deep + sweep).unwrap();
    let failed = said(here, &["sweep", "deep.toml", "--quiet"], 1);
    assert!(failed.contains("deep: failed: setting-0001/seed-1, method sinking: failed in cycle"), "{failed}");
}
