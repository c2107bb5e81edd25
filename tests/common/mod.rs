//! What the tests of the program have in common.

use std::path::Path;
use std::process::{Command, Output};

/// A small scenario that uses most keys.
#[allow(dead_code, reason = "not every test needs it")]
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
