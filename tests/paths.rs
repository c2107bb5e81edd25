//! Where files go: no path that a file brings along leads out of the output directory, and nothing complete is lost.
#![cfg(unix)]

use crate::common::{VALID, isobar, text};
use crate::outputs::Outputs;
use isobar::event::Event;
use isobar::options::RunOptions;
use isobar::output::{Sink, SinkError};
use isobar::run::checkpoint::file::read;
use isobar::run::run_then;
use isobar::scenario::Scenario;
use rusqlite::Connection;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const QUIET: [&str; 4] = ["--quiet", "--no-report", "--no-rerun", "--cycles"];

/// The small scenario with a database of sensors into which it writes.
fn with_sensors(database: &str) -> String {
    format!("{VALID}\n[sensors]\ndatabase = \"{database}\"\nwrites = \"fkf\"\n")
}

fn place(scenario: &str) -> TempDir {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("small.toml"), scenario).unwrap();
    parent
}

/// Runs the small scenario for four cycles.
fn run(parent: &Path, more: &[&str]) -> Output {
    isobar(parent, &[&["run", "small.toml"], &QUIET[..], &["4"], more].concat())
}

/// All that a command said, on one line.
fn said(output: &Output) -> String {
    let all = text(&output.stdout) + &text(&output.stderr);
    all.replace(['\n', '│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

fn succeeds(output: Output) -> String {
    assert!(output.status.success(), "{}", said(&output));
    said(&output)
}

fn fails(output: Output) -> String {
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    said(&output)
}

fn pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

struct Nobody;

impl Sink for Nobody {
    fn record(&mut self, _: &Event<'_>) -> Result<(), SinkError> {
        Ok(())
    }
}

/// A run that ends when its outputs are complete, before anything else is done.
fn ended_when_complete(parent: &Path) {
    let scenario = Scenario::load(&parent.join("small.toml")).unwrap();
    let options = RunOptions { cycles: Some(4), ..RunOptions::new(parent.join("out/small")) };
    run_then(&scenario, &options, &mut Nobody, &mut |_| false).unwrap();
    assert_eq!(names(&parent.join("out")), [".small.partial", "small"]);
}

/// How many calibrations a database holds; none where there is no database.
fn calibrations(database: &Path) -> i64 {
    if !database.exists() {
        return 0;
    }
    Connection::open(database).unwrap().query_row("SELECT count(*) FROM calibration", [], |row| row.get(0)).unwrap()
}

#[test]
fn links_that_somebody_has_put_there_are_followed_by_no_run() {
    let parent = place(VALID);
    let parent = parent.path();
    let precious = parent.join("precious");
    fs::create_dir(&precious).unwrap();
    fs::write(precious.join("thesis.txt"), "important").unwrap();
    let working = parent.join("out/.small.partial");
    for (name, target) in [
        ("outputs", precious.clone()),
        ("journal", precious.join("thesis.txt")),
        ("checkpoint-0000000001.new", precious.join("thesis.txt")),
        ("replaced", precious.clone()),
        ("lock", precious.join("thesis.txt")),
    ] {
        for lock in [true, false] {
            fs::create_dir_all(&working).unwrap();
            if lock && name != "lock" {
                fs::write(working.join("lock"), "").unwrap();
            }
            symlink(&target, working.join(name)).unwrap();
            for more in [&["--checkpoint-cycles", "1"][..], &["--overwrite"]] {
                let refused = fails(run(parent, more));
                assert!(refused.contains("stays as it is") && refused.contains("Remove it"), "{name}: {refused}");
            }
            fails(isobar(parent, &["resume", "out/small", "--quiet"]));
            assert_eq!(fs::read_to_string(precious.join("thesis.txt")).unwrap(), "important", "{name}");
            fs::remove_dir_all(parent.join("out")).unwrap();
        }
    }
    // The directory itself, and one into which everybody may write.
    fs::create_dir_all(parent.join("out")).unwrap();
    symlink(&precious, &working).unwrap();
    assert!(fails(run(parent, &[])).contains("it is a link"));
    fs::remove_file(&working).unwrap();
    fs::create_dir(&working).unwrap();
    assert!(Command::new("chmod").arg("777").arg(&working).status().unwrap().success());
    assert!(fails(run(parent, &[])).contains("everybody may write into it"));
    assert_eq!(names(&precious), ["thesis.txt"]);
}

/// Neither waits for a pipe, nor reads a device without end.
#[test]
fn pipes_and_devices_in_the_place_of_a_runs_files_are_refused() {
    let parent = place(VALID);
    let parent = parent.path();
    let working = parent.join("out/.small.partial");
    for name in ["lock", "journal", "batch.json", "complete", "checkpoint-0000000003"] {
        for is_pipe in [true, false] {
            fs::create_dir_all(&working).unwrap();
            fs::write(working.join("lock"), "").unwrap();
            let path = working.join(name);
            let _ = fs::remove_file(&path);
            if is_pipe {
                pipe(&path)
            } else {
                symlink("/dev/zero", &path).unwrap()
            }
            assert!(fails(isobar(parent, &["resume", "out/small"])).contains("stays as it is"), "{name}");
            assert!(fails(run(parent, &[])).contains("stays as it is"), "{name}");
            fs::remove_dir_all(&working).unwrap();
        }
    }
    // A hole of a terabyte.
    fs::create_dir_all(&working).unwrap();
    for (name, beginning) in [("lock", ""), ("journal", "isobar journal 6\n"), ("checkpoint-0000000003", "")] {
        fs::write(working.join(name), beginning).unwrap();
        File::options().write(true).open(working.join(name)).unwrap().set_len(1 << 40).unwrap();
    }
    assert!(fails(isobar(parent, &["resume", "out/small"])).contains("its journal cannot be used"));
    assert_eq!(read(&working.join("checkpoint-0000000003")).err().as_deref(), Some("it is not a checkpoint"));
}

#[test]
fn only_what_a_run_wrote_is_overwritten() {
    let parent = place(VALID);
    let parent = parent.path();
    let out = parent.join("out/small");
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("summary.json"), "{}").unwrap();
    fs::write(out.join("thesis.txt"), "important").unwrap();
    assert!(fails(run(parent, &["--overwrite"])).contains("it will not be deleted"));
    assert_eq!(names(&out), ["summary.json", "thesis.txt"]);
    fs::remove_dir_all(&out).unwrap();
    succeeds(run(parent, &[]));
    fs::write(out.join("NOTES.md"), "mine").unwrap();
    assert!(fails(run(parent, &["--overwrite"])).contains("NOTES.md"));
    fs::remove_file(out.join("NOTES.md")).unwrap();
    succeeds(run(parent, &["--overwrite"]));
    // Nor is a batch by a single run.
    succeeds(isobar(parent, &["run", "small.toml", "--quiet", "--cycles", "2", "--seeds", "3", "--overwrite"]));
    assert!(fails(run(parent, &["--overwrite"])).contains("a batch of 3 runs"));
    assert!(out.join("seed-1/summary.json").is_file());
}

/// A full disk behind standard output, a closed terminal: what the run has found out is in the database all the same.
#[test]
fn sensors_are_written_back_before_anything_is_printed() {
    let parent = place(&with_sensors("known.db"));
    let parent = parent.path();
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(parent).args(["run", "small.toml"]).args(QUIET).arg("4").stdout(full).stderr(Stdio::piped());
    let output = command.output().unwrap();
    assert!(fails(output).contains("cannot write the output"));
    assert!(calibrations(&parent.join("known.db")) > 0);
    assert_eq!(names(&parent.join("out")), ["small"]);
}

#[test]
fn sensors_that_were_not_written_back_are_taken_up_by_resume() {
    let parent = place(&with_sensors("known.db"));
    let parent = parent.path();
    ended_when_complete(parent);
    assert_eq!(calibrations(&parent.join("known.db")), 0);
    // A database that cannot be written: nothing is lost, and it is said what to do.
    fs::write(parent.join("known.db"), "something else").unwrap();
    let failed = fails(isobar(parent, &["resume", "out/small"]));
    assert!(failed.contains("`isobar resume out/small` takes its sensors into the database"), "{failed}");
    fs::remove_file(parent.join("known.db")).unwrap();
    assert!(succeeds(isobar(parent, &["resume", "out/small"])).contains("5 new records"));
    assert!(calibrations(&parent.join("known.db")) > 0);
    assert_eq!(names(&parent.join("out")), ["small"]);
    let again = fails(isobar(parent, &["resume", "out/small"]));
    assert!(
        again.contains("the run is complete") && again.contains("sensors import sensors.db out/small/sensors.csv"),
        "{again}"
    );
}

/// The plan of a run comes from a file as well: it leads to a database only as long as its scenario says so.
#[test]
fn resume_writes_into_no_database_that_only_a_plan_names() {
    let parent = place(&with_sensors("known.db"));
    let parent = parent.path();
    ended_when_complete(parent);
    fs::write(parent.join("small.toml"), VALID).unwrap();
    let refused = fails(isobar(parent, &["resume", "out/small"]));
    assert!(refused.contains("is no longer the scenario of this run") && refused.contains("--sensors"), "{refused}");
    assert!(!parent.join("known.db").exists());
    succeeds(isobar(parent, &["resume", "out/small", "--sensors", "elsewhere.db"]));
    assert!(calibrations(&parent.join("elsewhere.db")) > 0 && !parent.join("known.db").exists());
}

#[test]
fn a_scenario_writes_no_database_outside_its_directory_unless_the_user_names_it() {
    let parent = tempfile::tempdir().unwrap();
    let inner = parent.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let elsewhere = parent.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    symlink(&elsewhere, inner.join("linked")).unwrap();
    symlink(elsewhere.join("x.db"), inner.join("link.db")).unwrap();
    let absolute = elsewhere.join("x.desktop");
    for (database, why) in [
        (absolute.to_str().unwrap(), "not below the scenario's directory"),
        ("../elsewhere/x.db", "not below the scenario's directory"),
        ("linked/x.db", "not below the scenario's directory"),
        ("link.db", "it is a link"),
        ("missing/x.db", "there is no directory"),
    ] {
        fs::write(inner.join("small.toml"), with_sensors(database)).unwrap();
        for refused in [isobar(&inner, &["check", "small.toml"]), run(&inner, &[])] {
            let refused = fails(refused);
            assert!(refused.contains(why) && refused.contains("[sensors]"), "{database}: {refused}");
        }
        assert!(names(&elsewhere).is_empty() && !inner.join("out").exists(), "{database}");
    }
    fs::write(inner.join("small.toml"), with_sensors("../elsewhere/x.db")).unwrap();
    succeeds(isobar(&inner, &["check", "small.toml", "--sensors", "../elsewhere/x.db"]));
    assert!(names(&elsewhere).is_empty());
    assert!(succeeds(run(&inner, &["--sensors", "../elsewhere/x.db"])).contains("5 new records in ../elsewhere/x.db"));
    assert_eq!(names(&elsewhere), ["x.db"]);
    // Below its directory it may.
    fs::create_dir(inner.join("data")).unwrap();
    fs::write(inner.join("small.toml"), with_sensors("data/x.db")).unwrap();
    succeeds(run(&inner, &["--overwrite"]));
    assert_eq!(names(&inner.join("data")), ["x.db"]);
    assert!(fails(run(&inner, &["--sensors", "a.db"])).contains("exists already"));
}

#[test]
fn a_run_with_a_named_database_is_resumed_only_with_it() {
    let parent = place(&with_sensors("known.db"));
    let parent = parent.path();
    let mut scenario = Scenario::load(&parent.join("small.toml")).unwrap();
    let sensors = scenario.sensors.as_mut().unwrap();
    (sensors.database, sensors.within) = (parent.join("named.db"), None);
    let options = RunOptions { cycles: Some(4), ..RunOptions::new(parent.join("out/small")) };
    run_then(&scenario, &options, &mut Nobody, &mut |_| false).unwrap();
    let refused = fails(isobar(parent, &["resume", "out/small"]));
    assert!(refused.contains("named.db") && refused.contains("--sensors"), "{refused}");
    succeeds(isobar(parent, &["resume", "out/small", "--sensors", "named.db"]));
    assert!(calibrations(&parent.join("named.db")) > 0 && !parent.join("known.db").exists());
    fs::write(parent.join("plain.toml"), VALID).unwrap();
    let refused = fails(isobar(parent, &["run", "plain.toml", "--sensors", "named.db"]));
    assert!(refused.contains("plain has no [sensors]"), "{refused}");
}

#[test]
fn a_database_has_the_name_that_the_user_gives_it() {
    let parent = tempfile::tempdir().unwrap();
    let parent = parent.path();
    fs::write(parent.join("t.csv"), "record,sensor,unit\nsensor,a,m\n").unwrap();
    for name in [":memory:", "file:x?mode=memory", "file:y"] {
        succeeds(isobar(parent, &["sensors", "import", name, "t.csv"]));
        assert!(parent.join(name).is_file(), "{name}");
        assert!(succeeds(isobar(parent, &["sensors", "export", name])).contains("sensor,a"), "{name}");
    }
    // Of another program, it is not even opened.
    let other = Connection::open(parent.join("other.db")).unwrap();
    other.execute_batch("PRAGMA journal_mode = WAL; CREATE TABLE a (b);").unwrap();
    drop(other);
    let before = names(parent);
    assert!(fails(isobar(parent, &["sensors", "list", "other.db"])).contains("of another program"));
    symlink("nowhere.db", parent.join("link.db")).unwrap();
    assert!(
        fails(isobar(parent, &["sensors", "import", "link.db", "t.csv"]))
            .contains("a link to a file that is not there")
    );
    assert!(fails(isobar(parent, &["sensors", "import", "no/x.db", "t.csv"])).contains("its directory no:"));
    fs::remove_file(parent.join("link.db")).unwrap();
    assert_eq!(names(parent), before);
}

#[test]
fn what_is_exported_or_begun_replaces_no_file() {
    let parent = place(VALID);
    let parent = parent.path();
    fs::write(parent.join("t.csv"), "record,sensor,unit\nsensor,a,m\n").unwrap();
    succeeds(isobar(parent, &["sensors", "import", "s.db", "t.csv"]));
    let database = fs::read(parent.join("s.db")).unwrap();
    symlink(parent.join("new.csv"), parent.join("link.csv")).unwrap();
    for out in ["s.db", "t.csv", "link.csv", "."] {
        let refused = fails(isobar(parent, &["sensors", "export", "s.db", "--out", out]));
        assert!(refused.contains("exists; nothing was written"), "{refused}");
    }
    assert_eq!(fs::read(parent.join("s.db")).unwrap(), database);
    assert!(!parent.join("new.csv").exists());
    succeeds(isobar(parent, &["sensors", "export", "s.db", "--out", "u.csv"]));
    assert!(fs::read_to_string(parent.join("u.csv")).unwrap().contains("sensor,a"));
    assert!(fails(isobar(parent, &["init", "small.toml"])).contains("exists; nothing was written"));
    // A comparison replaces only files.
    succeeds(run(parent, &[]));
    let compare = |out: &str, more: &[&str]| {
        isobar(parent, &[&["compare", "out/small", "out/small", "--out", out], more].concat())
    };
    succeeds(compare("page.html", &[]));
    assert!(fails(compare("page.html", &[])).contains("--overwrite replaces it"));
    succeeds(compare("page.html", &["--overwrite"]));
    symlink(parent.join("t.csv"), parent.join("page-link.html")).unwrap();
    pipe(&parent.join("pipe.html"));
    for out in ["page-link.html", "pipe.html", "."] {
        assert!(fails(compare(out, &["--overwrite"])).contains("it is not a file"), "{out}");
    }
    assert!(fails(compare("t.csv", &["--overwrite"])).contains("replaces only pages of isobar"));
    assert!(fs::read_to_string(parent.join("t.csv")).unwrap().starts_with("record"));
}

#[test]
fn paths_need_not_be_text() {
    let parent = tempfile::tempdir().unwrap();
    let here = parent.path().join(OsStr::from_bytes(b"caf\xe9 100%"));
    fs::create_dir(&here).unwrap();
    let name = OsStr::from_bytes(b"sm\xff.toml");
    fs::write(here.join(name), VALID).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(&here).arg("run").arg(name).args(QUIET).args(["4", "--checkpoint-cycles", "1"]);
    succeeds(command.output().unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    succeeds(command.current_dir(&here).arg("check").arg(name).output().unwrap());
    // The plan in its journal leads back to the scenario.
    fs::write(here.join("small.toml"), with_sensors("known.db")).unwrap();
    ended_when_complete(&here_out(&here));
    assert!(succeeds(isobar(&here, &["resume", "out/small"])).contains("5 new records"));
    Outputs::of(&here.join("out/small"));
}

/// The directory with an `out` that holds nothing else.
fn here_out(here: &Path) -> std::path::PathBuf {
    fs::remove_dir_all(here.join("out")).unwrap();
    here.to_path_buf()
}

#[test]
fn names_that_lead_to_the_same_files_are_refused() {
    for (old, new, what) in [
        ("[networks.polar]", "[networks.SONDES]", "the networks `sondes` and `SONDES` differ in case only"),
        ("[methods.free]", "[methods.observations]", "a method cannot be called observations"),
        ("[methods.free]", "[methods.TRUTH]", "a method cannot be called TRUTH"),
        ("[methods.free]", "[methods.a-b]\nkind = \"free\"\n[methods.a_B]", "differ only in hyphens and underscores"),
    ] {
        assert!(VALID.contains(old));
        let text = VALID.replace(&old.replace(']', "."), &new.replace(']', ".")).replace(old, new);
        let parent = place(&text);
        let refused = fails(isobar(parent.path(), &["check", "small.toml"]));
        assert!(refused.contains(what), "{refused}");
    }
}

#[test]
fn a_place_where_no_directory_can_be_made_is_refused_with_advice() {
    let parent = place(VALID);
    fs::write(parent.path().join("file"), "").unwrap();
    for out in ["file", "file/below", "/proc/none"] {
        let said = fails(run(parent.path(), &["--out", out]));
        assert!(said.contains("choose another --out"), "{out}: {said}");
    }
}

#[cfg(not(feature = "rerun"))]
#[test]
fn a_switch_that_this_build_does_not_know_is_refused_before_anything_is_made() {
    let parent = place(VALID);
    for command in [&["run", "small.toml", "--live", "--out", "new"][..], &["resume", "new", "--live"]] {
        let said = fails(isobar(parent.path(), command));
        assert!(said.contains("`cargo run --release --features rerun"), "{said}");
    }
    assert_eq!(names(parent.path()), ["small.toml"]);
}
