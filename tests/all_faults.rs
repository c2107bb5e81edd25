//! All faults of a scenario file at once, and what `isobar check` says a run will cost.

use crate::common::{VALID, isobar, place_from, text};
use std::fs;
use tempfile::tempdir;

/// What is replaced, by what, and where the fault is: all in one file.
const TOGETHER: &[(&str, &str, &str)] = &[
    ("title = \"A test\"", "title = 3", "3\n"),
    ("nx = 8", "nxx = 8", "nxx"),
    ("dx_km = 100", "dx_km = -1", "-1\n"),
    ("kind = \"jet\"", "kind = \"jett\"", "\"jett\""),
    ("count = 10", "count = 0", "0\n"),
    ("missing_rate = 0.1", "missing_rate = 1.5", "1.5"),
    ("term = \"offset\"\n", "", "[[networks.polar.bias]]"),
    ("[methods.free]\nkind = \"free\"", "[methods.free]\nkind = \"fre\"", "\"fre\""),
];

#[test]
fn all_faults_of_a_file_are_shown_with_their_places() {
    let directory = tempdir().unwrap();
    let mut broken = VALID.to_string();
    for (old, new, _) in TOGETHER {
        assert!(broken.contains(old), "{old} is not in the valid scenario");
        broken = broken.replacen(old, new, 1);
    }
    fs::write(directory.path().join("broken.toml"), &broken).unwrap();
    for command in [&["check", "broken.toml"][..], &["run", "broken.toml", "--quiet"]] {
        let output = isobar(directory.path(), command);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        for (_, new, at) in TOGETHER {
            let from = if new.is_empty() { 0 } else { broken.find(new).unwrap() };
            let place = format!("broken.toml:{}]", place_from(&broken, from, at));
            assert!(message.contains(&place), "{new}: {place} is missing in\n{message}");
        }
        assert_eq!(message.matches("broken.toml:").count(), TOGETHER.len(), "more is said than is wrong:\n{message}");
    }
    let checked = isobar(directory.path(), &["check", "broken.toml", "--json"]);
    let checked: serde_json::Value = serde_json::from_slice(&checked.stdout).unwrap();
    let faults = checked["scenarios"][0]["faults"].as_array().unwrap();
    let lines: Vec<u64> = faults.iter().map(|fault| fault["line"].as_u64().unwrap()).collect();
    assert!(lines.len() == TOGETHER.len() && lines.is_sorted(), "{faults:?}");
    assert!(faults.iter().any(|fault| fault["help"].as_str().is_some_and(|help| help.contains("did you mean `nx`?"))));
}

#[test]
fn methods_that_cannot_be_set_up_are_all_named_before_anything_is_allocated() {
    let directory = tempdir().unwrap();
    let methods =
        "[methods.kf]\nkind = \"kf\"\nmemory_limit_gb = 10000\n[methods.etkf]\nkind = \"etkf\"\nmembers = 90000\n";
    let large = VALID.replace("nx = 8", "nx = 900").replace("ny = 6", "ny = 900");
    let large = large.replace("[methods.free]", &format!("{methods}[methods.free]"));
    fs::write(directory.path().join("large.toml"), large).unwrap();
    for command in [&["check", "large.toml"][..], &["run", "large.toml", "--quiet"]] {
        let output = isobar(directory.path(), command);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        let flat = message.replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(flat.contains("method kf: it would need about") && flat.contains("and this machine has"), "{message}");
        assert!(flat.contains("TB"), "{message}");
        let names_all = command[0] != "check" || flat.contains("method etkf:");
        assert!(names_all, "{message}");
    }
}

#[test]
fn what_a_run_will_cost_is_estimated() {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("small.toml"), VALID).unwrap();
    let said = text(&isobar(directory.path(), &["check", "small.toml"]).stdout);
    assert!(said.contains("Estimated from sizes") && said.contains("All methods, 10 cycles: about"), "{said}");
    let checked = isobar(directory.path(), &["check", "small.toml", "--json"]);
    let checked: serde_json::Value = serde_json::from_slice(&checked.stdout).unwrap();
    let estimates = checked["scenarios"][0]["estimates"].as_array().unwrap();
    assert!(estimates.len() >= 2, "{checked}");
    for it in estimates {
        assert!(it["memory_bytes"].as_f64().unwrap() > 1e3 && it["seconds_per_cycle"].as_f64().unwrap() > 0.0, "{it}");
    }
}
