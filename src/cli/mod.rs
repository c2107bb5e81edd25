//! The command line: arguments in, tables and files out.

mod arguments;
mod check;
mod compare;
mod console;
mod diagnose;
mod exact;
mod init;
mod launch;
mod list;
mod lookup;
mod outputs;
mod regress;
mod resume;
mod run;
mod seeds;
mod sensors;
mod sweep;
mod view;
mod write_back;

use crate::interrupt;
use arguments::{Arguments, Command};
use clap::Parser;
use console::show;
use miette::MietteHandlerOpts;
use std::process::ExitCode;

/// Does what the arguments of this process say.
///
/// The exit code is 0 if all went well, 1 if something failed, 2 if the arguments make no sense, and 130 if a signal ended it.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    // A second hook is refused, and the first one stays: then messages look as its owner wants.
    let _ = miette::set_hook(Box::new(|_| {
        Box::new(MietteHandlerOpts::new().width(100).context_lines(1).terminal_links(false).build())
    }));
    let outcome = match arguments.command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Check(arguments) => check::check(&arguments.scenarios),
        Command::List(arguments) => list::list(&arguments),
        Command::Init { path } => init::init(&path),
        Command::Resume(arguments) => resume::resume(&arguments),
        Command::Regress(arguments) => regress::regress(&arguments),
        Command::View { run } => view::view(&run),
        Command::Sensors { command } => sensors::sensors(&command),
        Command::Compare(arguments) => compare::compare(&arguments),
        Command::Sweep(arguments) => sweep::sweep(&arguments),
        Command::Exact(arguments) => exact::run(&arguments),
        Command::Diagnose { runs } => diagnose::diagnose(&runs),
    };
    match outcome {
        Ok(code) => code,
        Err(report) => {
            show(&report);
            if interrupt::requested() { ExitCode::from(interrupt::EXIT_CODE) } else { ExitCode::FAILURE }
        }
    }
}
