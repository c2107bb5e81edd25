//! `isobar members`.

use super::console::print;
use super::final_state::FinalStateArguments;
use super::{launch, lookup, out_file};
use crate::output::netcdf::{coordinates, members};
use crate::run::experiment::Competitor;
use crate::run::{RunError, reopen};
use crate::text::{clean, shown_path};
use clap::Args;
use miette::{IntoDiagnostic, Report, miette};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

pub const MEMBERS_EXAMPLES: &str = "Examples:
  isobar members quickstart --from out/quickstart --method fkf
  isobar members mine.toml --from out/mine --method fkf --out factors.nc";

#[derive(Args, Debug)]
pub struct MembersArguments {
    #[command(flatten)]
    pub end: FinalStateArguments,
    /// The file [default: METHOD_members.nc or METHOD_factors.nc]
    #[arg(long, short, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace a netCDF file
    #[arg(long, short = 'f')]
    pub overwrite: bool,
}

/// Writes the members of an ensemble, or the common factors of a Fast Kalman Filter, at the end of a run.
pub fn run(arguments: &MembersArguments) -> Result<ExitCode, Report> {
    let scenario = lookup::load(&arguments.end.scenario)?;
    launch::check_method(&arguments.end.method, &scenario)?;
    let experiment = reopen(&scenario, &arguments.end.from, &arguments.end.method).map_err(|error| match error {
        RunError::Experiment(error) => error.locate(&scenario).into(),
        error => miette!("{}: {error}", scenario.name),
    })?;
    let name = clean(&arguments.end.method);
    let [Competitor { runner, failure, .. }] = &experiment.methods[..] else {
        return Err(miette!("there is no method {name}"));
    };
    if let Some(failure) = failure {
        return Err(miette!("method {name} failed in cycle {}: {}", failure.cycle, failure.reason));
    }
    let root = runner.method().can().root;
    let root =
        root.ok_or_else(|| miette!("method {name} has neither an ensemble nor common factors of the whole domain"))?;
    let stem = coordinates::safe_name(&arguments.end.method, "_-");
    let own = || PathBuf::from(format!("{stem}_{}.nc", members::names(root.kind()).1));
    let out = arguments.out.clone().unwrap_or_else(own);
    let directory = tempfile::tempdir().into_diagnostic()?;
    let made = directory.path().join("made.nc");
    members::write(&made, &experiment.info, &experiment.info.methods[0], root).into_diagnostic()?;
    let bytes = fs::read(&made).into_diagnostic()?;
    out_file::write(&out, arguments.overwrite, &bytes, "netCDF files", is_netcdf)?;
    let count = root.columns();
    print(&format!("{count} {} of {name}: {}", members::names(root.kind()).1, shown_path(&out)))?;
    Ok(ExitCode::SUCCESS)
}

/// Whether a file is one that this command could have written; what cannot be opened says so itself.
fn is_netcdf(path: &Path) -> bool {
    out_file::begins_with(path, "CDF")
}
