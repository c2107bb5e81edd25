//! `isobar init`.

use super::console::print;
use crate::safe_file;
use crate::shell::command;
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::ErrorKind;
use std::path::Path;
use std::process::ExitCode;

/// A small scenario with a comment on every section.
const TEMPLATE: &str = include_str!("template.toml");

/// Writes the template to a file that does not exist yet.
pub fn init(path: &Path) -> Result<ExitCode, Report> {
    let shown = shown_path(path);
    match safe_file::write_new(path, TEMPLATE.as_bytes()) {
        Ok(()) => {
            let [check, run] = ["isobar check", "isobar run"].map(|words| command(words, &[path]));
            print(&format!("wrote {shown}; now: {check} && {run}"))?;
            Ok(ExitCode::SUCCESS)
        }
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            Err(miette!(help = "give another path, or remove the file first", "{shown} exists; nothing was written"))
        }
        Err(error) => Err(miette!("cannot write {shown}: {error}")),
    }
}
