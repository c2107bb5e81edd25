//! `--json`: what the tables show, for other programs, with all digits and with units.

use crate::common::{VALID, isobar, text};
use isobar::output::recorded::SavedRun;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// What a command prints; nothing else is on standard output.
fn json(directory: &Path, arguments: &[&str]) -> Value {
    let output = isobar(directory, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {}", text(&output.stdout)))
}

fn place() -> TempDir {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("small.toml"), VALID).unwrap();
    parent
}

const QUIET: [&str; 4] = ["--json", "--quiet", "--no-rerun", "--no-netcdf"];

#[test]
fn the_scores_of_a_run_are_those_of_its_summary_with_units_and_intervals() {
    let parent = place();
    let printed = json(parent.path(), &[&["run", "small.toml"], &QUIET[..]].concat());
    let run = &printed["runs"][0];
    assert_eq!((run["scenario"].as_str(), run["directory"].as_str()), (Some("small"), Some("out/small")));
    let saved = SavedRun::open(&parent.path().join("out/small")).unwrap().summary;
    let rows = run["scores"].as_array().unwrap();
    let mut count = 0;
    for (method, scores) in &saved.methods {
        for (key, value) in &scores.values {
            let (score, variable) = key.split_once('.').map_or((key.as_str(), Value::Null), |(a, b)| (a, b.into()));
            let is_it =
                |row: &&Value| row["method"] == **method && row["score"] == score && row["variable"] == variable;
            let row = rows.iter().find(is_it).unwrap_or_else(|| panic!("{method} has no {key}"));
            assert_eq!(row["value"].as_f64(), Some(*value), "{method} {key}");
            assert_eq!(row["low"].as_f64(), scores.intervals.get(key).map(|it| it.low), "{method} {key}");
            let unit = match (score, key.rsplit('.').next().unwrap()) {
                ("seconds_per_cycle", _) => Some("s"),
                (name, "h") if name.starts_with("rmse") => Some("m"),
                (name, "u") if name.starts_with("rmse") => Some("m s-1"),
                _ => None,
            };
            assert!(unit.is_none_or(|unit| row["unit"] == unit), "{row}");
            count += 1;
        }
    }
    assert_eq!(rows.len(), count);
}

#[test]
fn seeds_comparisons_and_diagnostics_are_printed_for_programs() {
    let parent = place();
    let here = parent.path();
    let seeds = json(here, &[&["run", "small.toml", "--seeds", "3", "--out", "s"], &QUIET[..]].concat());
    let saved: Value = serde_json::from_str(&fs::read_to_string(here.join("s/small/seeds.json")).unwrap()).unwrap();
    let rows = seeds["runs"][0]["scores"].as_array().unwrap();
    let row =
        rows.iter().find(|row| row["method"] == "fkf" && row["score"] == "rmse_analysis" && row["variable"] == "h");
    let (row, of_file) = (row.unwrap(), &saved["methods"]["fkf"]["rmse_analysis.h"]);
    assert_eq!(row["value"], of_file["mean"]);
    assert_eq!(row["difference"]["value"], of_file["difference"]["mean"]);

    json(here, &[&["run", "small.toml", "--out", "a"], &QUIET[..]].concat());
    json(here, &[&["run", "small.toml", "--out", "b", "--methods", "fkf"], &QUIET[..]].concat());
    let compared = json(here, &["compare", "a/small", "b/small", "--json"]);
    assert_eq!(compared["runs"].as_array().unwrap().len(), 2);
    let differences = compared["differences"].as_array().unwrap();
    let between = differences.iter().filter(|row| row["of"]["run"] == "B" && row["from"]["run"] == "A");
    assert!(between.clone().count() >= 3 && between.clone().all(|row| row["difference"] == 0.0), "{differences:?}");
    assert!(
        differences.iter().any(|row| row["of"]["method"] == "free" && row["unit"] == "m" && row["low"].is_number())
    );
    assert!(here.join("comparison.html").is_file());

    // Another seed, another truth: no difference of scores is one of methods.
    json(here, &[&["run", "small.toml", "--out", "c", "--seed", "2"], &QUIET[..]].concat());
    let other = json(here, &["compare", "a/small", "c/small", "--json", "-f"]);
    let differences = other["differences"].as_array().unwrap();
    let between = || differences.iter().filter(|row| row["of"]["run"] != row["from"]["run"]);
    assert!(between().count() > 3 && between().all(|row| row["significant"].is_null()));
    assert!(differences.iter().any(|row| row["significant"].is_boolean()), "within a run they are judged");
    let said = text(&isobar(here, &["compare", "a/small", "c/small", "-f"]).stdout);
    assert!(said.starts_with("A: a/small, scenario small, seed 1\nB: c/small, scenario small, seed 2\n"), "{said}");
    let starred = said.lines().filter(|line| line.starts_with("B fkf − A fkf") && line.contains('*'));
    assert!(said.contains("have different truths") && starred.count() == 0, "{said}");

    // The same seed in another world, too.
    fs::write(here.join("other.toml"), VALID.replace("drag_per_s = 1e-6", "drag_per_s = 2e-4")).unwrap();
    json(here, &[&["run", "other.toml", "--out", "d"], &QUIET[..]].concat());
    let other = json(here, &["compare", "a/small", "d/other", "--json", "-f"]);
    let differences = other["differences"].as_array().unwrap();
    let between: Vec<&Value> = differences.iter().filter(|row| row["of"]["run"] != row["from"]["run"]).collect();
    assert!(between.len() > 3 && between.iter().all(|row| row["significant"].is_null()), "{between:?}");
    // What methods see of the same truth makes no other truth.
    fs::write(here.join("same.toml"), VALID.replace("sigma_height_m = 12", "sigma_height_m = 13")).unwrap();
    json(here, &[&["run", "same.toml", "--out", "e"], &QUIET[..]].concat());
    let same = json(here, &["compare", "a/small", "e/same", "--json", "-f"]);
    let differences = same["differences"].as_array().unwrap();
    let mut between = differences.iter().filter(|row| row["of"]["run"] != row["from"]["run"]);
    assert!(between.any(|row| row["significant"].is_boolean()), "{differences:?}");

    let diagnosed = json(here, &["diagnose", "a/small", "--json"]);
    let run = &diagnosed["runs"][0];
    assert_eq!((&run["units"]["h"], &run["units"]["u"]), (&"m".into(), &"m s-1".into()));
    let summary: Value = serde_json::from_str(&fs::read_to_string(here.join("a/small/summary.json")).unwrap()).unwrap();
    let fkf = run["methods"].as_array().unwrap().iter().find(|method| method["method"] == "fkf").unwrap();
    assert_eq!(fkf["diagnostics"], summary["methods"]["fkf"]["diagnostics"]);
    assert!(fkf["stability"].is_object());
}

#[test]
fn lists_and_checks_are_printed_for_programs() {
    let parent = place();
    let here = parent.path();
    let listed = json(here, &["list", "--json"]);
    let all = listed["scenarios"].as_array().unwrap();
    let quickstart = all.iter().find(|it| it["scenario"] == "quickstart").unwrap();
    assert_eq!(
        (&quickstart["file"], &quickstart["variables"][0]["unit"]),
        (&"isobar:/quickstart.toml".into(), &"m".into())
    );
    assert!(quickstart["methods"].as_array().unwrap().iter().any(|method| method["kind"] == "fkf"));
    assert!(json(here, &["list", "--methods", "--json"])["kinds"].as_array().unwrap().len() > 10);
    let keys = json(here, &["list", "--methods", "letkf", "--json"]);
    let radius = keys["keys"].as_array().unwrap().iter().find(|key| key["name"] == "localization_radius_km");
    assert_eq!(radius.unwrap()["unit"], "km");

    fs::write(here.join("wrong.toml"), VALID.replace("nx = 8", "nx = 0")).unwrap();
    let output = isobar(here, &["check", "small.toml", "wrong.toml", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let checked: Value = serde_json::from_slice(&output.stdout).unwrap();
    let (right, wrong) = (&checked["scenarios"][0], &checked["scenarios"][1]);
    assert_eq!((&right["valid"], &right["grid"]["nx"], &right["cycles"]), (&true.into(), &8.into(), &10.into()));
    assert_eq!((&wrong["valid"], &wrong["file"]), (&false.into(), &"wrong.toml".into()));
    assert!(wrong["error"].as_str().unwrap().contains("nx"));
    assert!(text(&output.stderr).contains("nx"), "errors are on standard error, too");
}

#[test]
fn the_version_says_what_was_built_and_for_which_viewer() {
    let here = tempfile::tempdir().unwrap();
    let version = text(&isobar(here.path(), &["--version"]).stdout);
    let lines: Vec<&str> = version.lines().collect();
    assert_eq!(lines[0], format!("isobar {}", env!("CARGO_PKG_VERSION")));
    let features = match (cfg!(feature = "mpi"), cfg!(feature = "rerun")) {
        (true, true) => "features: all",
        (true, false) => "features: all but rerun",
        (false, true) => "features: all but mpi",
        (false, false) => "features: all but mpi, rerun",
    };
    assert_eq!(lines[1], features);
    assert!(lines[2].starts_with("rerun viewer: 0."), "{version}");
    assert_eq!(text(&isobar(here.path(), &["-V"]).stdout).lines().count(), 1);
}

#[test]
fn every_shell_has_completions() {
    let here = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = isobar(here.path(), &["completions", shell]);
        assert!(output.status.success(), "{shell}");
        let script = text(&output.stdout);
        assert!(["checkpoint-minutes", "diagnose"].iter().all(|word| script.contains(word)), "{shell}");
    }
    // Bash reads it, and completes a command.
    let script = "source <(\"$ISOBAR\" completions bash); COMP_WORDS=(isobar diag); COMP_CWORD=1; _isobar isobar diag isobar; \
                  echo \"${COMPREPLY[@]}\"";
    let bash =
        std::process::Command::new("bash").args(["-c", script]).env("ISOBAR", env!("CARGO_BIN_EXE_isobar")).output();
    if let Ok(output) = bash {
        assert_eq!(text(&output.stdout).trim(), "diagnose", "{}", text(&output.stderr));
    }
}
