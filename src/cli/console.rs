//! Standard output and standard error.

use crate::text::printable;
use miette::Report;

/// Shows why something failed.
pub fn show(report: &Report) {
    use std::io::Write;
    // There is nowhere to report that standard error is closed.
    let _ = writeln!(std::io::stderr(), "{report:?}");
}

/// Writes a warning to standard error.
pub fn warn(text: &str) {
    complain(&format!("warning: {text}"));
}

/// Writes text to standard error.
pub fn complain(text: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{}", printable(text.trim_end()));
}

/// Prints text to standard output. A reader that has seen enough, as `head` has, is no failure.
pub fn print(text: &str) -> Result<(), Report> {
    use std::io::{ErrorKind, Write};
    // Names in it may come from files.
    match writeln!(std::io::stdout(), "{}", printable(text)) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(miette::miette!("cannot write the output: {error}")),
        _ => Ok(()),
    }
}
