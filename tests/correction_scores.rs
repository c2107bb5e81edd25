//! How the corrections of a model compare with what they claim, where the truth's model has a right value for them.

use crate::common::{isobar, text};
use serde_json::Value;
use std::fs;
use std::path::Path;

const LAST: usize = 24;
const SCORED_FROM: usize = 21;

fn summary(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join(name).join("summary.json")).unwrap()).unwrap()
}

/// `local_wrong_model` with other text in its place.
fn run(folder: &Path, change: impl Fn(String) -> String, arguments: &[&str]) -> String {
    let scenario = include_str!("../scenarios/local_wrong_model.toml");
    let scenario = change(scenario.split("[expected]").next().unwrap().to_string());
    fs::write(folder.join("s.toml"), scenario).unwrap();
    let output =
        isobar(folder, &[&["run", "s.toml", "--out", "out", "--overwrite", "--methods", "tiles"], arguments].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// The score is the mean of the squares that `parameters.csv` has: of 4 m/s in the tiles of the jet, of 0 elsewhere.
#[test]
fn the_score_of_corrections_is_that_of_the_parameters() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let printed = run(folder, |scenario| scenario, &["--cycles", &LAST.to_string()]);
    assert!(printed.contains("corrections"), "{printed}");
    let score = summary(folder, "out/s")["methods"]["tiles"]["correction_chi2"].as_f64().unwrap();
    let mut squares = Vec::new();
    for row in csv::Reader::from_path(folder.join("out/s/parameters.csv")).unwrap().records().map(Result::unwrap) {
        let (cycle, name): (usize, &str) = (row[0].parse().unwrap(), &row[3]);
        if let (true, Ok(sigma)) = (cycle >= SCORED_FROM, row[6].parse::<f64>()) {
            let truth = if name.ends_with("y1") { 4.0 } else { 0.0 };
            squares.push(((row[5].parse::<f64>().unwrap() - truth) / sigma).powi(2));
        }
    }
    assert!(squares.len() >= 4 * (LAST + 1 - SCORED_FROM), "{} squares", squares.len());
    let expected = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((score / expected - 1.0).abs() < 1e-9, "{score}, not {expected}");
}

/// There is no such score where no value would be right.
#[test]
fn no_score_without_a_right_value() {
    let folder = tempfile::tempdir().unwrap();
    let score = |change: fn(String) -> String| {
        run(folder.path(), change, &["--cycles", "21"]);
        summary(folder.path(), "out/s")["methods"]["tiles"].get("correction_chi2").cloned()
    };
    // A jet that is no sum of tiles, and a truth of another kind.
    assert_eq!(score(|scenario| scenario.replace("center_y_km = 300", "center_y_km = 250")), None);
    let of_another_kind = |scenario: String| {
        let shift = "[truth.model]\nkind = \"exact_shift\"\ncolumns_per_step = 0\n";
        let begin = scenario.find("[truth.model]").unwrap();
        let end = begin + scenario[begin..].find("[initial]").unwrap();
        format!("{}{shift}{}", &scenario[..begin], &scenario[end..])
    };
    assert_eq!(score(of_another_kind), None);
}

/// It is in the table over seeds.
#[test]
fn seeds_show_it() {
    let folder = tempfile::tempdir().unwrap();
    let printed = run(folder.path(), |scenario| scenario, &["--cycles", "22", "--seeds", "3"]);
    assert!(printed.contains("corrections"), "{printed}");
    let seeds: Value =
        serde_json::from_str(&fs::read_to_string(folder.path().join("out/s/seeds.json")).unwrap()).unwrap();
    assert!(seeds.to_string().contains("correction_chi2"), "{seeds}");
}
