//! What machines do to a run: no space, no directory, no reader, no clock. Nothing that was complete is lost, and the message
//! says what happened and what to do.
#![cfg(unix)]

use crate::common::{VALID, isobar, one_line, text};
use crate::outputs::Outputs;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const CYCLES: &str = "100";

fn place() -> TempDir {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("small.toml"), VALID).unwrap();
    parent
}

/// A shell that does something first and then becomes a run.
fn run_after(parent: &Path, first: &str) -> Command {
    let program = env!("CARGO_BIN_EXE_isobar");
    let run = format!("exec {program} run small.toml --no-rerun --no-report --cycles {CYCLES} --checkpoint-cycles 1");
    let mut command = Command::new("sh");
    command.current_dir(parent).args(["-c", &format!("{first}\n{run} --quiet")]);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// What was said to standard error, on one line.
fn said(output: &Output) -> String {
    one_line(&text(&output.stderr))
}

fn undisturbed() -> Outputs {
    let parent = place();
    let output = run_after(parent.path(), "").output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    Outputs::of(&parent.path().join("out/small"))
}

/// Waits until the run has a checkpoint.
fn wait_for_checkpoint(parent: &Path, child: &mut Child) {
    let has_checkpoint = || {
        let entries = fs::read_dir(parent.join("out/.small.partial")).into_iter().flatten().flatten();
        let names = entries.into_iter().map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.filter(|name| name.starts_with("checkpoint-") && !name.ends_with("new")).count() > 0
    };
    while !has_checkpoint() {
        assert!(child.try_wait().unwrap().is_none(), "the run was too fast");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn no_space_for_a_file_is_said_and_the_run_goes_on_once_there_is() {
    let parent = place();
    // Blocks of 512 bytes; the signal that a limit sends is ignored, so that writing fails as on a full disk.
    let output = run_after(parent.path(), "trap '' XFSZ; ulimit -f 500").output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    let message = said(&output);
    assert!(message.contains("cannot write") && message.contains("File too large"), "{message}");
    assert!(message.contains("`isobar resume out/small` continues it"), "{message}");
    assert!(!parent.path().join("out/small").exists());
    let resumed = isobar(parent.path(), &["resume", "out/small", "--quiet"]);
    assert!(resumed.status.success(), "{}", said(&resumed));
    undisturbed().assert_same(&Outputs::of(&parent.path().join("out/small")), "after want of space");
}

#[test]
fn a_directory_that_vanishes_ends_the_run_with_its_name() {
    let parent = place();
    let mut child = run_after(parent.path(), "").spawn().unwrap();
    wait_for_checkpoint(parent.path(), &mut child);
    fs::rename(parent.path().join("out"), parent.path().join("elsewhere")).unwrap();
    let output = child.wait_with_output().unwrap();
    let message = said(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("out/.small.partial/checkpoint-") && message.contains("No such file"), "{message}");
    // What is somewhere else can be taken up there.
    let resumed = isobar(parent.path(), &["resume", "elsewhere/small", "--quiet"]);
    assert!(resumed.status.success(), "{}", said(&resumed));
    undisturbed().assert_same(&Outputs::of(&parent.path().join("elsewhere/small")), "elsewhere");
}

#[test]
fn a_place_where_nothing_can_be_written_is_named() {
    let parent = place();
    fs::write(parent.path().join("file"), "").unwrap();
    let output = isobar(parent.path(), &["run", "small.toml", "--no-rerun", "--out", "file"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("cannot write file"), "{}", said(&output));
    let locked = parent.path().join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    // Nothing is locked to the superuser.
    if fs::write(locked.join("probe"), "").is_err() {
        let output = isobar(parent.path(), &["run", "small.toml", "--no-rerun", "--out", "locked"]);
        assert_eq!(output.status.code(), Some(1));
        let message = said(&output);
        assert!(message.contains("locked") && message.contains("Permission denied"), "{message}");
    }
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn of_two_runs_in_one_place_one_is_refused() {
    let parent = place();
    let mut first = run_after(parent.path(), "").spawn().unwrap();
    wait_for_checkpoint(parent.path(), &mut first);
    for arguments in [&["run", "small.toml", "--no-rerun", "--overwrite"][..], &["resume", "out/small"]] {
        let second = isobar(parent.path(), arguments);
        assert_eq!(second.status.code(), Some(1));
        assert!(said(&second).contains("another run writes there"), "{}", said(&second));
    }
    let first = first.wait_with_output().unwrap();
    assert!(first.status.success(), "{}", said(&first));
    undisturbed().assert_same(&Outputs::of(&parent.path().join("out/small")), "beside another");
}

#[test]
fn readers_that_have_gone_away_do_not_end_a_run() {
    let parent = place();
    let mut child = run_after(parent.path(), "").spawn().unwrap();
    drop(child.stdout.take());
    drop(child.stderr.take());
    assert!(child.wait().unwrap().success());
    undisturbed().assert_same(&Outputs::of(&parent.path().join("out/small")), "without readers");
}
