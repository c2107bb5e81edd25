//! Runs of the shipped scenarios within a test.

use isobar::options::RunOptions;
use isobar::scenario::Scenario;
use std::path::Path;

/// All shipped scenarios but those that are too expensive to run.
pub fn scenarios() -> Vec<Scenario> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        files.filter(|path| path.extension().is_some_and(|extension| extension == "toml")).collect();
    files.sort();
    assert!(files.len() >= 5);
    let scenarios = files.iter().map(|path| Scenario::load(path).unwrap());
    scenarios.filter(|scenario| scenario.regression).collect()
}

/// The scenario with these methods instead of its own, and without the sections that name methods.
pub fn with_methods(scenario: &Scenario, methods: &str) -> Scenario {
    let mut file: toml::Table = scenario.text.parse().unwrap();
    for section in ["initialise", "sensors", "sweep", "expected"] {
        file.remove(section);
    }
    file.insert("methods".into(), toml::Value::Table(methods.parse().unwrap()));
    Scenario::parse(&scenario.path, &toml::to_string(&file).unwrap()).unwrap()
}

/// A run of some cycles into a folder, without files but the summary.
pub fn run_options(folder: &Path, cycles: usize) -> RunOptions {
    RunOptions { cycles: Some(cycles), ..RunOptions::new(folder.join("run")) }
}
