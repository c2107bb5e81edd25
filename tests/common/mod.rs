//! What the tests of the program have in common.

use std::path::Path;
use std::process::{Command, Output};

/// A small scenario that uses most keys.
pub const VALID: &str = include_str!("valid.toml");

/// Runs the program in a directory.
pub fn isobar(directory: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(directory).args(arguments).env("NO_COLOR", "1").env("LC_ALL", "C.UTF-8");
    command.output().expect("the program can be started")
}

/// Output of the program.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// Line and column, from 1, of `part` in `text`.
pub fn place(text: &str, part: &str) -> String {
    let start = text.find(part).unwrap_or_else(|| panic!("{part} is not in the scenario"));
    let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
    format!("{}:{}", text[..start].matches('\n').count() + 1, start - line_start + 1)
}
