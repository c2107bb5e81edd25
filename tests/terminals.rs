//! What is printed of real runs on terminals of several widths: no line is too long, and no word is broken.

use crate::runs::run_options;
use crate::{common, passive, without_truth};
use isobar::options::RunOptions;
use isobar::output::Sink;
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar::tables::{diagnostics, scores};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// A terminal on which nothing is broken.
const ENDLESS: usize = 10_000;

/// What is printed after a run, and its diagnostics.
fn printed(summary: &Summary, variables: &[(&str, &str)], width: usize) -> Vec<String> {
    let tables = diagnostics::all(summary).into_iter();
    let tables = tables.flat_map(|it| [it.table.terminal(width), it.table.terminal_with_notes(width)]);
    std::iter::once(scores::on_terminal(summary, variables, width)).chain(tables).collect()
}

fn words(text: &str) -> BTreeSet<&str> {
    text.split([' ', '\n']).filter(|word| !word.is_empty()).collect()
}

#[test]
fn no_line_is_too_long_and_no_word_is_broken() {
    let quickstart = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/quickstart.toml");
    let recorded = without_truth::folder(without_truth::SCENARIO);
    for (path, methods, cycles) in [
        (quickstart, Some(["free", "var", "fkf"].map(String::from).to_vec()), Some(10)),
        (recorded.path().join("s.toml"), None, None),
        (recorded.path().join("passive.toml"), None, None),
    ] {
        if path.ends_with("passive.toml") {
            std::fs::write(&path, [passive::WORLD, passive::PASSIVE, passive::METHODS].concat()).unwrap();
        }
        let scenario = Scenario::load(&path).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let cycles = cycles.unwrap_or(scenario.cycle.count);
        let options = RunOptions { methods, ..run_options(folder.path(), cycles) };
        let mut nobody: Vec<Box<dyn Sink>> = Vec::new();
        let summary = run(&scenario, &options, &mut nobody).unwrap();
        let variables = scenario.model.variables();
        let whole = printed(&summary, variables, ENDLESS);
        for width in [60, 80, 100, 120, 200] {
            for (text, whole) in printed(&summary, variables, width).iter().zip(&whole) {
                let longest = text.lines().map(|line| line.chars().count()).max().unwrap();
                assert!(longest <= width, "{} at {width} has a line of {longest}:\n{text}", scenario.name);
                assert_eq!(words(text), words(whole), "{} at {width}:\n{text}", scenario.name);
                let lines = whole.lines().map(|line| line.chars().count()).max().unwrap();
                assert!(lines > width || text == whole, "{} at {width} is broken for nothing:\n{text}", scenario.name);
            }
        }
    }
}

#[test]
fn the_environment_says_how_wide_the_terminal_is() {
    let list = |columns: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
        let output = command.args(["list", "--methods"]).env("COLUMNS", columns).output().unwrap();
        common::text(&output.stdout)
    };
    let longest = |text: &str| text.lines().map(|line| line.chars().count()).max().unwrap();
    let usual = list("");
    assert!((80..=100).contains(&longest(&usual)), "{usual}");
    // In a table that nobody can read there is nothing to be seen.
    for (columns, most) in [("60", 60), ("20", 60), ("80", 80)] {
        let text = list(columns);
        assert!(longest(&text) <= most && text.lines().count() > usual.lines().count(), "{columns}:\n{text}");
        assert_eq!(words(&text), words(&usual), "{columns}:\n{text}");
    }
    assert_eq!([list("0"), list("wide"), list("-3")], [&usual[..]; 3]);
}
