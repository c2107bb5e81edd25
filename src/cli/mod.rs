//! The command line: arguments in, tables and files out.

mod arguments;
mod check;
mod compare;
mod diagnose;
mod exact;
mod init;
mod list;
mod lookup;
mod regress;
mod resume;
mod run;
mod seeds;
mod sensors;
mod sweep;
mod view;

use crate::checkpoint::Policy;
use crate::interrupt;
use crate::scenario::Scenario;
use crate::sink::Sink;
use crate::summary::Summary;
use crate::text::printable;
use arguments::{Arguments, Command};
use clap::Parser;
use miette::{MietteHandlerOpts, Report};
use std::path::PathBuf;
use std::process::ExitCode;

/// What the command line changes in a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunOptions {
    /// The directory of this run's files: the scenario's own, below the one that was asked for.
    pub out: PathBuf,
    /// The methods to run; `None`: all of the scenario. Each is one of the scenario's.
    pub methods: Option<Vec<String>>,
    /// Number of cycles instead of the scenario's.
    pub cycles: Option<usize>,
    /// Seed instead of the scenario's.
    pub seed: Option<u64>,
    /// Number of threads; `None`: one for each core.
    pub threads: Option<usize>,
    /// Whether files of an earlier run are replaced.
    pub overwrite: bool,
    /// Whether netCDF files are written.
    pub netcdf: bool,
    /// Whether a recording for the rerun viewer is written.
    pub rerun: bool,
    /// Whether the page is written.
    pub report: bool,
    /// Whether a running viewer is sent the recording while it comes to be.
    pub live: bool,
    /// Whether other runs go on in this process, so that nobody can tell whose memory is whose.
    pub concurrent: bool,
    /// When checkpoints are written; `None`: never.
    pub checkpoints: Option<Policy>,
    /// Whether an interrupted run goes on from its last checkpoint.
    pub resume: bool,
}

impl RunOptions {
    /// A run as the scenario says, on all cores, which writes nothing but its scores.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            out: out.into(),
            methods: None,
            cycles: None,
            seed: None,
            threads: None,
            overwrite: false,
            netcdf: false,
            rerun: false,
            report: false,
            live: false,
            concurrent: false,
            checkpoints: None,
            resume: false,
        }
    }
}

/// What runs an experiment: it sends a listener the run's events, and gives back the scores.
pub type Runner = dyn Fn(&Scenario, &RunOptions, &mut dyn Sink) -> Result<Summary, Report> + Sync;

/// Does what the arguments of this process say.
///
/// The exit code is 0 if all went well, 1 if something failed, 2 if the arguments make no sense, and 130 if a signal ended it.
pub fn main(runner: &Runner) -> ExitCode {
    let arguments = Arguments::parse();
    // A second hook is refused, and the first one stays: then messages look as its owner wants.
    let _ = miette::set_hook(Box::new(|_| {
        Box::new(MietteHandlerOpts::new().width(100).context_lines(1).terminal_links(false).build())
    }));
    let outcome = match arguments.command {
        Command::Run(arguments) => run::run(&arguments, runner),
        Command::Check(arguments) => check::check(&arguments.scenarios),
        Command::List(arguments) => list::list(&arguments),
        Command::Init { path } => init::init(&path),
        Command::Resume(arguments) => resume::resume(&arguments, runner),
        Command::Regress(arguments) => regress::regress(&arguments, runner),
        Command::View { run } => view::view(&run),
        Command::Sensors { command } => sensors::sensors(&command),
        Command::Compare(arguments) => compare::compare(&arguments),
        Command::Sweep(arguments) => sweep::sweep(&arguments, runner),
        Command::Exact(arguments) => exact::run(&arguments),
        Command::Diagnose { runs } => diagnose::diagnose(&runs),
    };
    match outcome {
        Ok(code) => code,
        Err(report) => {
            show(&report);
            match interrupt::requested() {
                true => ExitCode::from(interrupt::EXIT_CODE),
                false => ExitCode::FAILURE,
            }
        }
    }
}

/// Shows why something failed.
fn show(report: &Report) {
    use std::io::Write;
    // Nobody is left to be told if standard error is closed.
    let _ = writeln!(std::io::stderr(), "{report:?}");
}

/// Prints text to standard output. A reader that has seen enough, as `head` has, is no failure.
fn print(text: &str) -> Result<(), Report> {
    use std::io::{ErrorKind, Write};
    // Names in it may come from files.
    match writeln!(std::io::stdout(), "{}", printable(text)) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(miette::miette!("cannot write the output: {error}")),
        _ => Ok(()),
    }
}
