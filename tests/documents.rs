//! What the documents show works.

use crate::common::{isobar, text};
use std::path::Path;

/// The blocks of a language in a document of the project.
fn blocks(document: &str, language: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(document);
    let text = std::fs::read_to_string(path).unwrap();
    let parts = text.split("```").skip(1).step_by(2);
    parts.filter_map(|block| Some(block.strip_prefix(language)?.strip_prefix('\n')?.to_string())).collect()
}

/// The scenario of the README is valid, and the commands below it do what they say.
#[test]
fn the_experiment_of_the_readme_runs() {
    let folder = tempfile::tempdir().unwrap();
    let [scenario] = &blocks("README.md", "toml")[..] else { panic!("not one scenario") };
    std::fs::write(folder.path().join("mine.toml"), scenario).unwrap();
    let commands = blocks("README.md", "sh");
    let commands = commands.iter().find(|block| block.contains("isobar check mine.toml")).expect("commands");
    for command in commands.lines() {
        let command = command.split('#').next().unwrap().trim();
        let mut arguments: Vec<&str> = command.strip_prefix("isobar ").expect(command).split_whitespace().collect();
        if arguments[0] == "run" {
            arguments.extend(["--quiet", "--no-rerun"]);
        }
        let output = isobar(folder.path(), &arguments);
        assert!(output.status.success(), "{command}: {}", text(&output.stderr));
    }
}

/// Whether every link within the project leads to a file that is there.
#[test]
fn links_between_documents_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let documents = [
        "README.md",
        "CHANGELOG.md",
        ".github/CONTRIBUTING.md",
        "assim/README.md",
        "model/README.md",
        "obs/README.md",
        "scenarios/README.md",
        "scenarios/RESULTS.md",
        "src/README.md",
        "tests/RELIABILITY.md",
    ];
    let mut links = 0;
    for document in documents {
        let path = root.join(document);
        let text = std::fs::read_to_string(&path).unwrap();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if target.contains("://") || target.starts_with('#') {
                continue;
            }
            let file = target.split('#').next().unwrap();
            assert!(path.parent().unwrap().join(file).exists(), "{document}: {target}");
            links += 1;
        }
    }
    assert!(links > 50, "{links}");
}
