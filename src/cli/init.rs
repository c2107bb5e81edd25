//! `isobar init`.

use super::console::print;
use crate::safe_file;
use crate::text::clean;
use miette::{Report, miette};
use std::io::ErrorKind;
use std::path::Path;
use std::process::ExitCode;

/// A small scenario with a comment on every section.
const TEMPLATE: &str = include_str!("template.toml");

/// Writes the template to a file that does not exist yet.
pub fn init(path: &Path) -> Result<ExitCode, Report> {
    let shown = clean(&path.display().to_string());
    match safe_file::write_new(path, TEMPLATE.as_bytes()) {
        Ok(()) => {
            print(&format!("wrote {shown}; now: isobar check {shown} && isobar run {shown}"))?;
            Ok(ExitCode::SUCCESS)
        }
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            Err(miette!(help = "give another path, or remove the file first", "{shown} exists; nothing was written"))
        }
        Err(error) => Err(miette!("cannot write {shown}: {error}")),
    }
}
