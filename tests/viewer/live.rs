//! `isobar run --live`: the run does not depend on the viewer that it tells.

use crate::common::text;
use std::fs;
use std::net::TcpListener;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What a run says to standard error, once it is complete with all its files, with a viewer expected on a port.
fn run_live(port: &str) -> String {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("mine.toml"), include_str!("../common/valid.toml")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(parent.path()).args(["run", "mine.toml", "--live", "--quiet"]);
    let output = command.env("ISOBAR_VIEWER_PORT", port).output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    for file in ["summary.json", "scores.csv", "report.html", "truth.nc", "recording.rrd"] {
        assert!(parent.path().join("out/mine").join(file).is_file(), "{file} is missing: {said}");
    }
    said
}

#[test]
fn a_viewer_that_is_not_there_or_goes_away_is_worth_one_warning() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port().to_string();
    // It takes every call, and hangs up.
    listener.set_nonblocking(true).unwrap();
    let over = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&over);
    let viewer = std::thread::spawn(move || {
        let mut calls = 0;
        while !told.load(Ordering::Relaxed) {
            calls += usize::from(listener.accept().is_ok());
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        calls
    });
    let said = run_live(&port);
    over.store(true, Ordering::Relaxed);
    assert!(viewer.join().unwrap() > 0, "nobody called");
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    assert!(said.contains("the rerun viewer has gone away, the run goes on without it"), "{said}");

    let said = run_live(&port);
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    let wanted = format!("no rerun viewer listens on 127.0.0.1:{port}");
    assert!(said.contains(&wanted) && said.contains("`rerun`"), "{said}");

    let said = run_live("door");
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    assert!(said.contains("ISOBAR_VIEWER_PORT is `door`, but must be a port"), "{said}");
}
