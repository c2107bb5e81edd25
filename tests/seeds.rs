//! `isobar run --seeds`: the same experiment over several seeds.

use crate::common::{VALID, isobar, text, without_script};
use isobar::scores::Summary;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// What is said to standard error as the program fails, without line breaks.
fn complaint(directory: &Path, arguments: &[&str], code: i32) -> String {
    let output = isobar(directory, arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A directory with the small scenario, without files that it does not need.
fn workplace() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("small.toml"), VALID).unwrap();
    directory
}

/// The scores of a run without its costs.
fn summary(directory: &Path) -> Summary {
    let mut summary: Summary =
        serde_json::from_str(&fs::read_to_string(directory.join("summary.json")).unwrap()).unwrap();
    for scores in summary.methods.values_mut() {
        scores.values.retain(|key, _| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()));
    }
    summary
}

#[test]
fn every_seed_has_the_scores_of_its_own_run_however_many_run_at_a_time() {
    let directory = workplace();
    let here = directory.path();
    let run = |arguments: &[&str]| {
        let output = isobar(here, &[&["run", "small.toml", "--quiet"], arguments].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let said = run(&["--seeds", "4", "--seed", "11", "--threads", "3", "--out", "parallel"]);
    run(&["--seeds", "4", "--seed", "11", "--threads", "1", "--out", "serial"]);
    run(&["--seed", "13", "--no-rerun", "--out", "single"]);
    let seed = |out: &str, seed: u64| summary(&here.join(out).join("small").join(format!("seed-{seed}")));
    assert_eq!(seed("parallel", 13), summary(&here.join("single/small")));
    for number in 11..15 {
        assert_eq!(seed("parallel", number), seed("serial", number));
    }
    assert_ne!(seed("serial", 11).methods, seed("serial", 12).methods);

    let folder = here.join("parallel/small");
    let mut files: Vec<String> =
        fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    files.sort();
    assert_eq!(
        files,
        ["files.txt", "report.html", "seed-11", "seed-12", "seed-13", "seed-14", "seeds.csv", "seeds.json"]
    );
    assert_eq!(
        fs::read_dir(folder.join("seed-11")).unwrap().count(),
        5,
        "only the summary, two files of scores, verdicts.csv and files.txt"
    );

    // The mean and the paired difference are those of the summaries.
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.join("seeds.json")).unwrap()).unwrap();
    let h = |method: &str| -> Vec<f64> {
        (11..15).map(|number| seed("serial", number).methods[method].values["rmse_analysis.h"]).collect()
    };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let methods: Vec<String> = json["methods"].as_object().unwrap().keys().cloned().collect();
    assert!(methods.len() >= 2 && json["against"] == methods[0].as_str());
    for method in &methods {
        let score = &json["methods"][method]["rmse_analysis.h"];
        assert!((score["mean"].as_f64().unwrap() / mean(&h(method)) - 1.0).abs() < 1e-12);
        let interval = [&score["interval"]["low"], &score["interval"]["high"]].map(|end| end.as_f64().unwrap());
        assert!(interval[0] < mean(&h(method)) && mean(&h(method)) < interval[1]);
        if *method != methods[0] {
            let expected = mean(&h(method)) - mean(&h(&methods[0]));
            assert!((score["difference"]["mean"].as_f64().unwrap() - expected).abs() < 1e-9);
        }
    }
    assert!(said.contains("Mean over 4 seeds") && said.contains(&format!("Difference from {}", methods[0])), "{said}");
    assert!(said.lines().all(|line| line.chars().count() <= 100), "{said}");

    // As many rows as scores, each with as many fields as the header.
    let table = fs::read_to_string(folder.join("seeds.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let scores: usize = methods.iter().map(|method| json["methods"][method].as_object().unwrap().len()).sum();
    assert_eq!(rows.records().map(Result::unwrap).count(), scores);
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(!page.contains("Smoothed:"));
    assert!(
        page.contains("11, 12, 13, 14")
            && page.matches("<svg").count() >= 3
            && !without_script(&page).contains("<script")
    );
}

#[test]
fn another_method_can_be_the_reference_and_all_files_can_be_had() {
    let directory = workplace();
    let arguments = ["run", "small.toml", "--quiet", "--no-rerun", "--seeds", "3", "--cycles", "4"];
    let more = ["--methods", "free,fkf", "--against", "fkf", "--all-files", "--no-report"];
    let output = isobar(directory.path(), &[&arguments[..], &more].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    let difference = said.split("Difference from fkf").nth(1).unwrap();
    assert!(difference.lines().any(|line| line.starts_with("free ")), "{said}");
    assert!(!difference.lines().any(|line| line.starts_with("fkf ")), "{said}");
    let folder = directory.path().join("out/small");
    assert!(folder.join("seed-2/fkf.nc").exists() && !folder.join("report.html").exists());
}

#[test]
fn smoothed_estimates_have_a_table_of_the_methods_that_have_them() {
    let directory = workplace();
    let methods = "[methods]\nkf = { kind = \"kf\", smoother_lag_cycles = 2 }\nfree = { kind = \"free\" }\n\
                   etkf = { kind = \"etkf\", members = 20, smoother_lag_cycles = 2 }\n";
    let scenario = VALID.split("[methods.free]").next().unwrap().to_string() + methods;
    fs::write(directory.path().join("small.toml"), scenario).unwrap();
    let output = isobar(directory.path(), &["run", "small.toml", "--quiet", "--seeds", "3", "--cycles", "5"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.lines().all(|line| line.chars().count() <= 100), "{said}");
    let folder = directory.path().join("out/small");
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.join("seeds.json")).unwrap()).unwrap();
    let runs: Vec<Summary> = (1..=3).map(|seed| summary(&folder.join(format!("seed-{seed}")))).collect();
    let mean = |score: &str| runs.iter().map(|run| run.methods["etkf"].values[score]).sum::<f64>() / 3.0;
    let etkf = &json["methods"]["etkf"];
    for score in ["rmse_smoothed.h", "bias_rmse_smoothed", "bias_spread_smoothed"] {
        assert!((etkf[score]["mean"].as_f64().unwrap() / mean(score) - 1.0).abs() < 1e-12, "{score}");
    }
    // Means of both, and of etkf the difference from kf.
    let tables: Vec<&str> = said.split("\n\n").filter(|part| part.contains("smoothed")).collect();
    let rows = |table: &str| -> Vec<String> {
        let rows = table.lines().filter(|line| line.contains('±'));
        rows.map(|line| line.split_whitespace().next().unwrap().to_string()).collect()
    };
    assert_eq!(
        tables.iter().map(|table| rows(table)).collect::<Vec<_>>(),
        [vec!["kf", "etkf"], vec!["etkf"]],
        "{said}"
    );
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains("Smoothed: the estimates"));
    assert_eq!(page.matches("smoothed</th>").count(), 6, "three variables in two tables");
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_runs() {
    let directory = workplace();
    let here = directory.path();
    let run = |arguments: &[&str], code| complaint(here, &[&["run", "small.toml"], arguments].concat(), code);
    assert!(run(&["--seeds", "3", "--live"], 2).contains("cannot be used with"));
    assert!(run(&["--seeds", "2"], 2).contains("3..=10000"));
    assert!(run(&["--against", "free"], 2).contains("--seeds"));
    assert!(run(&["--all-files"], 2).contains("--seeds"));
    assert!(run(&["--seeds", "3", "--against", "fkv"], 1).contains("did you mean `fkf`?"));
    let message = run(&["--seeds", "3", "--methods", "free", "--against", "fkf"], 1);
    assert!(message.contains("--against fkf is not among the methods of --methods"), "{message}");
    let last = u64::MAX.to_string();
    assert!(run(&["--seeds", "3", "--seed", &last], 1).contains("no 3 seeds from"));
    assert_eq!(fs::read_dir(here).unwrap().count(), 1, "something was written");
}

#[test]
fn scores_that_are_there_are_replaced_only_if_that_is_asked_for() {
    let directory = workplace();
    let here = directory.path();
    let arguments = ["run", "small.toml", "--quiet", "--seeds", "3", "--cycles", "2", "--methods", "free"];
    assert!(isobar(here, &arguments).status.success());
    let marker = here.join("out/small/marker");
    fs::write(&marker, "").unwrap();
    assert!(complaint(here, &arguments, 1).contains("it exists already"));
    assert!(marker.exists());
    let view = complaint(here, &["compare", "out/small"], 1);
    assert!(view.contains("seed-1"), "it says where the runs are: {view}");
    let overwrite = [&arguments[..], &["--overwrite"]].concat();
    assert!(complaint(here, &overwrite, 1).contains("marker"), "what no run wrote is not deleted");
    fs::rename(&marker, here.join("out/small/seed-1/scores.csv")).unwrap();
    assert!(isobar(here, &overwrite).status.success());
    assert!(!fs::read(here.join("out/small/seed-1/scores.csv")).unwrap().is_empty());
}
