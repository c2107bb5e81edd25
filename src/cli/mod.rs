//! The command line: arguments in, tables and files out.

mod advise;
mod advise_arguments;
mod arguments;
mod check;
mod compare;
mod completions;
mod console;
mod diagnose;
mod exact;
#[cfg(test)]
mod examples;
mod explain;
mod final_state;
mod init;
mod launch;
mod list;
mod long;
mod lookup;
mod members;
mod messages;
mod out_file;
mod outputs;
mod regress;
mod resume;
mod run;
mod seeds;
mod sensors;
mod shown;
mod sweep;
mod threads;
mod view;
mod winds;
mod write_back;

use crate::interrupt;
use crate::ranks;
use crate::text::{is_unprintable, nearest};
use arguments::{Arguments, Command};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory, Parser};
use console::{complain, show};
use messages::Messages;
use miette::Report;
use std::ffi::OsString;
use std::process::ExitCode;

/// Does what the arguments of this process say.
///
/// The exit code is 0 if all went well, 1 if something failed, 2 if the arguments make no sense, and 130 if a signal ended it.
pub fn main() -> ExitCode {
    // A second hook is refused, and the first one stays: then messages look as its owner wants.
    let _ = miette::set_hook(Box::new(|_| Box::new(Messages::new())));
    match ranks::join(launch::run_scenario) {
        Ok(ranks::Part::Command) => {}
        #[cfg(feature = "mpi")]
        Ok(ranks::Part::Done) => return ExitCode::SUCCESS,
        Err(report) => {
            show(&report);
            return ExitCode::FAILURE;
        }
    }
    let code = command();
    ranks::leave();
    code
}

/// Does what the arguments of this process say.
fn command() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return refuse(&error),
    };
    let outcome = threads::check_environment().and_then(|()| obey(arguments.command));
    match outcome {
        Ok(code) => code,
        Err(report) => {
            show(&report);
            if interrupt::requested() { ExitCode::from(interrupt::EXIT_CODE) } else { ExitCode::FAILURE }
        }
    }
}

fn obey(command: Command) -> Result<ExitCode, Report> {
    match command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Check(arguments) => check::check(&arguments),
        Command::List(arguments) => list::list(&arguments),
        Command::Init(arguments) => init::init(&arguments),
        Command::Explain { key } => explain::explain(key.as_deref()),
        Command::Completions { shell } => completions::print(shell),
        Command::Schema => explain::schema(),
        Command::Resume(arguments) => resume::resume(&arguments),
        Command::Regress(arguments) => regress::regress(&arguments),
        Command::View { run } => view::view(&run),
        Command::Sensors { command } => sensors::sensors(&command),
        Command::Compare(arguments) => compare::compare(&arguments),
        Command::Sweep(arguments) => sweep::sweep(&arguments),
        Command::Advise(arguments) => advise::run(&arguments),
        Command::Members(arguments) => members::run(&arguments),
        Command::Winds(arguments) => winds::run(&arguments),
        Command::Exact(arguments) => exact::run(&arguments),
        Command::Diagnose { runs, all, json } => diagnose::diagnose(&runs, all, json),
    }
}

/// The command that a misspelt one may mean, if the crate that reads arguments has no suggestion.
fn meant(error: &clap::Error) -> Option<String> {
    let is_unknown = error.kind() == ErrorKind::InvalidSubcommand;
    let said = |kind| error.get(kind).filter(|_| is_unknown);
    let Some(ContextValue::String(word)) = said(ContextKind::InvalidSubcommand) else { return None };
    if said(ContextKind::SuggestedSubcommand).is_some() {
        return None;
    }
    let command = Arguments::command();
    nearest(word, command.get_subcommands().map(clap::Command::get_name)).map(String::from)
}

/// Shows what is wrong with the arguments, or the help or version that they ask for.
fn refuse(error: &clap::Error) -> ExitCode {
    // It quotes arguments, in which a terminal may find something to obey; its own colours are lost with that.
    let has_unprintable = |argument: OsString| argument.to_string_lossy().chars().any(is_unprintable);
    if error.use_stderr() && std::env::args_os().any(has_unprintable) {
        complain(&error.to_string());
    } else {
        // There is nowhere to report that standard error is closed.
        let _ = error.print();
        if let Some(near) = meant(error) {
            complain(&format!("did you mean `isobar {near}`?"));
        }
    }
    u8::try_from(error.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from)
}
