//! Directories for runs whose outputs nobody asked for.

use crate::text::clean;
use miette::{Report, miette};
use tempfile::TempDir;

/// A directory that is removed with what is in it.
///
/// # Errors
/// Where it cannot be made, and what to do.
pub(crate) fn directory() -> Result<TempDir, Report> {
    tempfile::tempdir().map_err(|error| {
        let place = clean(&std::env::temp_dir().display().to_string());
        let help = "set the environment variable TMPDIR to a directory that can be written to";
        miette!(help = help, "cannot make a temporary directory in {place}: {}", error.kind())
    })
}
