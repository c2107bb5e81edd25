//! Commands that messages propose: pasted into a shell, they do what the message says, whatever the files are called.
#![cfg(unix)]

use crate::common::{VALID, isobar, text};
use std::fs;
use std::path::Path;
use std::process::Command;

const NAMES: [&str; 7] =
    ["my run", "it's", "-x", "a$(touch hacked)b;c", "tick`touch hacked`", "tab\there", "red\u{1b}[31m"];

/// Runs a line in a shell in which `isobar` is a command.
fn paste(here: &Path, line: &str) {
    let bin = Path::new(env!("CARGO_BIN_EXE_isobar")).parent().unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
    let output = Command::new("bash").current_dir(here).args(["-c", line]).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{line}: {}", text(&output.stderr));
}

/// The command between backquotes that begins so.
fn proposed(message: &str, beginning: &str) -> String {
    let start = message.find(&format!("`{beginning}")).unwrap_or_else(|| panic!("{message}")) + 1;
    message[start..].split('`').next().unwrap().to_string()
}

/// The files and directories of a directory.
fn entries(here: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(here).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_new_scenario_is_checked_by_the_command_that_init_proposes() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    for name in NAMES {
        let file = format!("{name}.toml");
        let output = isobar(here, &["init", "--", &file]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let message = text(&output.stdout);
        assert!(!message.contains('\u{1b}'), "{message:?}");
        let commands = message.trim_end().split("now: ").nth(1).unwrap();
        let (check, run) = commands.split_once(" && ").unwrap();
        paste(here, check);
        // As it is proposed, but for the length of the run.
        paste(here, &format!("{run} --quiet --methods free --cycles 6 --no-report --no-rerun"));
        fs::remove_dir_all(here.join("out")).unwrap();
        fs::remove_file(here.join(file)).unwrap();
    }
    assert!(entries(here).is_empty(), "{:?}", entries(here));
}

#[test]
fn what_was_interrupted_is_resumed_by_the_command_that_is_proposed() {
    for name in ["my run", "-x", "it's a `touch hacked`"] {
        let directory = tempfile::tempdir().unwrap();
        let here = directory.path();
        fs::write(here.join(format!("{name}.toml")), VALID).unwrap();
        let (file, out) =
            (format!("./{name}.toml"), format!("--out={name} with-a-hyphen and many words {}", "x ".repeat(50)));
        let run =
            ["run", &file, &out, "--quiet", "--no-report", "--no-rerun", "--cycles", "40", "--checkpoint-cycles", "1"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
        let mut child = command.current_dir(here).args(run).stderr(std::process::Stdio::piped()).spawn().unwrap();
        let partial = here.join(&out["--out=".len()..]).join(format!(".{name}.partial"));
        while !partial.is_dir() || !entries(&partial).iter().any(|file| file.starts_with("checkpoint-")) {
            assert!(child.try_wait().unwrap().is_none(), "the run was too fast");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let said = text(&child.wait_with_output().unwrap().stderr);
        let resume = proposed(&said, "isobar resume");
        // A new run is refused with the same words.
        assert_eq!(proposed(&text(&isobar(here, &run).stderr), "isobar resume"), resume);
        paste(here, &format!("{resume} --quiet"));
        assert!(here.join(&out["--out=".len()..]).join(name).join("summary.json").is_file());
        assert!(!here.join("hacked").exists());
    }
}
