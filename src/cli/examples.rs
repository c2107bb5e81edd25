//! Every command that the help or a document shows makes sense.

use super::arguments::{Arguments, Command, PartArguments};
use super::{launch, run, seeds};
use crate::scenario::Scenario;
use crate::shipped;
use clap::{CommandFactory, Parser};
use std::ffi::OsStr;
use std::fs;
use std::path::Path;

const DOCUMENTS: [&str; 8] = [
    "README.md",
    "src/README.md",
    "scenarios/README.md",
    "obs/README.md",
    "assim/README.md",
    "model/README.md",
    "tests/RELIABILITY.md",
    ".github/CONTRIBUTING.md",
];

/// The commands in the examples of the help, of the program and of each of its commands.
fn of_help(command: &clap::Command) -> Vec<String> {
    let help = command.get_after_help().map_or(String::new(), ToString::to_string);
    let mut lines: Vec<String> = help
        .lines()
        .filter_map(|line| line.strip_prefix("  "))
        .filter(|line| line.starts_with("isobar "))
        // What it does stands behind it.
        .map(|line| line.split("  ").next().unwrap_or_default().to_string())
        .collect();
    lines.extend(command.get_subcommands().flat_map(of_help));
    lines
}

/// The commands in a document's blocks for the shell.
fn of_document(document: &str) -> Vec<String> {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(document)).unwrap();
    let blocks = text.split("```").skip(1).step_by(2).filter_map(|block| block.strip_prefix("sh\n"));
    let commands = blocks.flat_map(str::lines).map(|line| line.split(" #").next().unwrap_or_default());
    let commands = commands.map(|line| line.replacen("cargo run --release -- ", "isobar ", 1));
    commands.filter(|line| line.starts_with("isobar ")).collect()
}

/// The scenario of an example: one inside the program, or the template.
fn scenario(argument: &OsStr) -> Scenario {
    let known = shipped::scenarios().find(|path| path.file_stem() == Some(argument));
    match known {
        Some(path) => Scenario::load(&path).unwrap(),
        None => {
            let path = Path::new(argument);
            assert!(path.extension().is_some_and(|end| end == "toml"), "there is no scenario {argument:?}");
            Scenario::parse(path, include_str!("template.toml")).unwrap()
        }
    }
}

/// Whether a command can be understood, and fits the scenario that it names.
fn check(command: &str) -> Result<(), String> {
    let words = shlex::split(command.split(" > ").next().unwrap_or_default()).ok_or("it cannot be split")?;
    let shown = |error: miette::Report| format!("{error:?}");
    let fits = |scenario: &Scenario, part: &PartArguments| {
        part.methods.iter().flatten().try_for_each(|method| launch::check_method(method, scenario))?;
        launch::check_cycles(part.cycles.map(|cycles| cycles as usize), scenario)
    };
    match Arguments::try_parse_from(words).map_err(|error| error.to_string())?.command {
        Command::Run(arguments) => {
            arguments.scenarios.iter().map(|argument| scenario(argument)).try_for_each(|scenario| {
                let options = run::options(&arguments, &scenario).map_err(shown)?;
                seeds::options(&arguments, &scenario, &options).map(drop).map_err(shown)
            })
        }
        Command::Sweep(arguments) => fits(&scenario(&arguments.scenario), &arguments.part).map_err(shown),
        Command::Exact(arguments) => fits(&scenario(&arguments.scenario), &arguments.part).map_err(shown),
        Command::Advise(arguments) => {
            launch::check_method(&arguments.end.method, &scenario(&arguments.end.scenario)).map_err(shown)
        }
        Command::Members(arguments) => {
            launch::check_method(&arguments.end.method, &scenario(&arguments.end.scenario)).map_err(shown)
        }
        Command::Explain { key: Some(key) } => crate::reference::explain(&key).map(drop).map_err(|it| it.to_string()),
        _ => Ok(()),
    }
}

#[test]
fn every_command_of_the_help_and_of_the_documents_makes_sense() {
    let of_documents = DOCUMENTS.iter().flat_map(|document| of_document(document)).collect::<Vec<_>>();
    assert!(of_documents.len() > 15, "{of_documents:?}");
    let of_help = of_help(&Arguments::command());
    assert!(of_help.len() > 25, "{of_help:?}");
    for line in of_help.into_iter().chain(of_documents) {
        for command in line.split(" && ").flat_map(|line| line.split(" || ")).filter(|it| it.starts_with("isobar ")) {
            check(command).unwrap_or_else(|error| panic!("{command}: {error}"));
        }
    }
}

#[test]
fn the_arguments_contradict_each_other_nowhere() {
    Arguments::command().debug_assert();
}
