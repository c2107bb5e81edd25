//! `isobar completions`.

use super::arguments::Arguments;
use super::console;
use clap::CommandFactory;
use clap_complete::{Shell, generate};
use miette::Report;
use std::process::ExitCode;

/// Prints what makes a shell complete the program's arguments.
pub fn print(shell: Shell) -> Result<ExitCode, Report> {
    let mut script = Vec::new();
    generate(shell, &mut Arguments::command(), "isobar", &mut script);
    console::write(&script)?;
    Ok(ExitCode::SUCCESS)
}
