//! `isobar run --live`: the run does not depend on the viewer that it tells.
#![cfg(feature = "rerun")]

use crate::common::{isobar, text};
use std::fs;
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Where a viewer listens.
const VIEWER: &str = "127.0.0.1:9876";

/// What a run says to standard error, once it is complete with all its files.
fn run_live() -> String {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("mine.toml"), include_str!("common/valid.toml")).unwrap();
    let output = isobar(parent.path(), &["run", "mine.toml", "--live", "--quiet"]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    for file in ["summary.json", "scores.csv", "report.html", "truth.nc", "recording.rrd"] {
        assert!(parent.path().join("out/mine").join(file).is_file(), "{file} is missing: {said}");
    }
    said
}

#[test]
fn a_viewer_that_is_not_there_or_goes_away_is_worth_one_warning() {
    let Ok(listener) = TcpListener::bind(VIEWER) else {
        eprintln!("not tested: something listens on {VIEWER}");
        return;
    };
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
    let said = run_live();
    over.store(true, Ordering::Relaxed);
    assert!(viewer.join().unwrap() > 0, "nobody called");
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    assert!(said.contains("the rerun viewer has gone away, the run goes on without it"), "{said}");

    let said = run_live();
    assert_eq!(said.matches("warning").count(), 1, "{said}");
    assert!(said.contains("no rerun viewer listens on 127.0.0.1:9876") && said.contains("`rerun`"), "{said}");
}
