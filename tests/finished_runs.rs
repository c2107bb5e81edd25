//! What can be done with the directory of a run, and what is said about one that is none.

use crate::common::{isobar, text, without_script};
use crate::synthetic_run::SyntheticRun;
use isobar::output::{Existing, OutputDirectory, Outputs, open_all};
use std::fs;
use std::path::{Path, PathBuf};

/// A run in the directory `name`.
fn run(parent: &Path, name: &str, methods: usize) -> PathBuf {
    let run = SyntheticRun::new(8, 6, 24, methods);
    let directory = OutputDirectory::create(parent.join(name), Existing::Refuse).unwrap();
    run.play(&mut open_all(&run.info, &directory, &Outputs::default()).unwrap()).unwrap();
    directory.complete().unwrap();
    parent.join(name)
}

/// What the program says to standard error as it fails, without line breaks.
fn complaint(directory: &Path, arguments: &[&str]) -> String {
    let output = isobar(directory, arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {}", text(&output.stdout));
    text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_directory_that_is_no_complete_run_is_refused_with_a_reason() {
    let parent = tempfile::tempdir().unwrap();
    let here = parent.path();
    fs::create_dir(here.join("empty")).unwrap();
    fs::write(here.join("file"), "").unwrap();
    run(here, "good", 1);
    for (name, change) in [("old", "\"version\": \"0.0.1\""), ("broken", "\"version\": ")] {
        let path = run(here, name, 1).join("summary.json");
        let own = format!("\"version\": \"{}\"", env!("CARGO_PKG_VERSION"));
        let summary = fs::read_to_string(&path).unwrap();
        assert!(summary.contains("\"version\": \"0.1.0\""));
        fs::write(&path, summary.replace(&own, change)).unwrap();
    }
    for command in ["view", "compare"] {
        for (name, wanted) in [
            ("nowhere", "there is no such directory"),
            ("empty", "not the output of a complete run"),
            ("file", "it is a file"),
            ("old", "written by isobar 0.0.1"),
            ("broken", "not the summary of a run"),
            (".", "good"),
        ] {
            let complaint = complaint(here, &[command, name]);
            assert!(complaint.contains(wanted), "{command} {name}: {complaint}");
        }
    }
    assert!(!here.join("comparison.html").exists());
}

/// A pipe into which nobody ever writes would never end.
#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_a_file_is_refused() {
    let parent = tempfile::tempdir().unwrap();
    let here = parent.path();
    let scores = run(here, "piped", 1).join("scores.csv");
    fs::remove_file(&scores).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&scores).status().unwrap().success());
    let said = complaint(here, &["compare", "piped"]);
    assert!(said.contains("scores.csv") && said.contains("it is not a file"), "{said}");
}

#[test]
fn a_missing_or_broken_recording_is_refused_before_a_viewer_is_sought() {
    let parent = tempfile::tempdir().unwrap();
    let path = run(parent.path(), "run", 1).join("recording.rrd");
    assert!(complaint(parent.path(), &["view", "run"]).contains("the run has no recording"));
    fs::write(&path, "RRF1 of old").unwrap();
    assert!(complaint(parent.path(), &["view", "run"]).contains("not a recording"));
    fs::write(&path, "RRF2 and nothing more").unwrap();
    assert!(complaint(parent.path(), &["view", "run"]).contains("its end is missing"));
}

#[cfg(unix)]
#[test]
fn a_viewer_on_the_path_is_started_and_without_one_there_is_advice() {
    use std::os::unix::fs::PermissionsExt;
    use std::process::Command;
    let parent = tempfile::tempdir().unwrap();
    let directory = run(parent.path(), "run", 1);
    fs::write(directory.join("recording.rrd"), "RRF2, the run, RRF2FOOT....").unwrap();
    let tools = parent.path().join("tools");
    fs::create_dir(&tools).unwrap();
    let view = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
        command.current_dir(parent.path()).args(["view", "run"]).env("PATH", &tools).output().unwrap()
    };
    let absent = view();
    assert_eq!(absent.status.code(), Some(1));
    assert!(text(&absent.stderr).contains("pip install rerun-sdk==0.36.3"), "{}", text(&absent.stderr));
    let script = "#!/bin/sh\nif [ \"$1\" = --version ]; then echo rerun-cli 0.99.0; else echo opened \"$1\"; fi\n";
    fs::write(tools.join("rerun"), script).unwrap();
    fs::set_permissions(tools.join("rerun"), fs::Permissions::from_mode(0o755)).unwrap();
    let present = view();
    assert!(present.status.success(), "{}", text(&present.stderr));
    let opened = text(&present.stdout);
    // From the root: a directory's name may begin with a hyphen.
    assert!(opened.starts_with("opened /") && opened.contains("/run/recording.rrd"), "{opened}");
    assert!(text(&present.stderr).contains("0.99.0"), "another version is worth a warning");
}

#[test]
fn a_comparison_tells_better_from_worse_and_keeps_what_is_there() {
    let parent = tempfile::tempdir().unwrap();
    let here = parent.path();
    let (_, other) = (run(here, "one", 5), run(here, "<b>two", 3));
    // The second run is one tenth better in all cycles.
    let path = other.join("scores.csv");
    let scores = fs::read_to_string(&path).unwrap();
    let mut lines = scores.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let better = lines.map(|line| {
        let cells = line.split(',').zip(&header).map(|(cell, name)| match cell.parse::<f64>() {
            Ok(value) if name.starts_with("rmse_analysis") => (0.9 * value).to_string(),
            _ => cell.to_string(),
        });
        cells.collect::<Vec<_>>().join(",")
    });
    let better: Vec<String> = better.collect();
    fs::write(&path, format!("{}\n{}\n", header.join(","), better.join("\n"))).unwrap();

    let output = isobar(here, &["compare", "one", "<b>two", "--out", "page.html"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.lines().any(|line| line.starts_with("B fast_kalman − A fast_kalman") && line.contains('*')), "{said}");
    let page = fs::read_to_string(here.join("page.html")).unwrap();
    assert!(page.contains("class=\"better\">-") && page.contains("B 3dvar − B") == page.contains("3dvar − B"));
    assert!(page.contains("&lt;b&gt;two") && !page.contains("<b>two") && !without_script(&page).contains("<script"));
    assert!(page.matches("<svg").count() >= 3);

    let complaint = complaint(here, &["compare", "one", "--out", "page.html"]);
    assert!(complaint.contains("page.html exists"), "{complaint}");
    assert_eq!(fs::read_to_string(here.join("page.html")).unwrap(), page);
    assert!(isobar(here, &["compare", "one", "--out", "page.html", "--overwrite"]).status.success());

    fs::write(&path, "cycle,method\n").unwrap();
    assert!(self::complaint(here, &["compare", "one", "<b>two", "--overwrite"]).contains("no column"));
}

#[test]
fn a_run_compared_with_itself_does_not_differ() {
    let parent = tempfile::tempdir().unwrap();
    run(parent.path(), "one", 2);
    let output = isobar(parent.path(), &["compare", "one", "one"]);
    let said = text(&output.stdout);
    let rows: Vec<&str> = said.lines().filter(|line| line.starts_with("B ") && line.contains("− A")).collect();
    assert_eq!(rows.len(), 2, "{said}");
    assert!(rows.iter().all(|row| !row.contains('*') && row.contains(" 0")), "{said}");
    let verdicts = said.lines().filter(|line| line.starts_with("B ") && line.contains(" is "));
    let equal = verdicts.filter(|line| !line.contains("better") && !line.contains("worse"));
    assert_eq!(equal.count(), 2, "{said}");
}
