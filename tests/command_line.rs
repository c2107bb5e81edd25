//! The program as its user meets it: listing, checking, beginning.

use crate::common::{VALID, isobar, text};
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// The directory in which ./scenarios lies.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn every_scenario_of_the_repository_is_valid_and_listed() {
    let list = isobar(root(), &["list"]);
    assert!(list.status.success(), "{}", text(&list.stderr));
    let mut names = Vec::new();
    for entry in fs::read_dir(root().join("scenarios")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            names.push(path.file_stem().unwrap().to_str().unwrap().to_string());
        }
    }
    assert!(names.len() >= 5, "{names:?}");
    for name in names {
        let check = isobar(root(), &["check", &name]);
        assert!(check.status.success(), "{}", text(&check.stderr));
        assert!(text(&list.stdout).lines().any(|line| line.starts_with(&name)), "{name} is not listed");
    }
}

#[test]
fn init_writes_a_valid_scenario_and_never_replaces_a_file() {
    let directory = tempdir().unwrap();
    let path = directory.path().join("mine.toml");
    assert!(isobar(directory.path(), &["init", "mine.toml"]).status.success());
    let check = isobar(directory.path(), &["check", "mine.toml"]);
    assert!(check.status.success(), "{}", text(&check.stderr));
    fs::write(&path, "mine").unwrap();
    let again = isobar(directory.path(), &["init", "mine.toml"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(text(&again.stderr).contains("mine.toml exists"), "{}", text(&again.stderr));
    assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
}

#[test]
fn a_misspelt_scenario_is_recognised() {
    for (argument, wanted) in
        [("quikstart", "did you mean `quickstart`?"), ("scenarios/quickstar.toml", "`quickstart`")]
    {
        let output = isobar(root(), &["check", argument]);
        assert_eq!(output.status.code(), Some(1));
        assert!(text(&output.stderr).contains(wanted), "{}", text(&output.stderr));
    }
}

#[test]
fn a_misspelt_method_is_recognised_before_anything_runs() {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("small.toml"), VALID).unwrap();
    let output = isobar(directory.path(), &["run", "small.toml", "--methods", "free,fkv"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(message.contains("small has no method `fkv`") && message.contains("did you mean `fkf`?"), "{message}");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1, "something was written");
}

#[test]
fn arguments_that_make_no_sense_are_refused() {
    for arguments in
        [&["run"][..], &["run", "quickstart", "--cycles", "0"], &["run", "quickstart", "--threads", "-1"], &["rum"]]
    {
        assert_eq!(isobar(root(), arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn the_help_has_examples() {
    for arguments in [&["--help"][..], &["run", "--help"]] {
        let output = isobar(root(), arguments);
        assert!(output.status.success() && text(&output.stdout).contains("isobar run quickstart"));
    }
}

#[test]
fn a_misspelt_command_gets_a_suggestion() {
    let here = tempfile::tempdir().unwrap();
    for (word, meant) in [("rnu", "run"), ("chekc", "check"), ("diagnos", "diagnose")] {
        let output = isobar(here.path(), &[word]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(&format!("`isobar {meant}`")) || said.contains(&format!("'{meant}'")), "{word}: {said}");
    }
    let nothing = text(&isobar(here.path(), &["zzzzqq"]).stderr);
    assert!(!nothing.contains("did you mean"), "{nothing}");
}
