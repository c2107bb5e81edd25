//! Standard output and standard error.

use crate::tables;
use crate::text::printable;
use miette::Report;

/// The narrowest and the widest terminal for which tables are laid out.
const WIDTHS: [usize; 2] = [60, 1000];

/// The width of standard output \[characters\]: that which the environment variable `COLUMNS` says, or else that of the
/// terminal, or else the usual one.
pub fn width() -> usize {
    let said = std::env::var("COLUMNS").ok().and_then(|text| text.parse().ok()).filter(|&width: &usize| width > 0);
    let own = || terminal_size::terminal_size_of(std::io::stdout()).map(|(width, _)| usize::from(width.0));
    let width = said.or_else(own).filter(|&width| width > 0).unwrap_or(tables::WIDTH);
    width.clamp(WIDTHS[0], WIDTHS[1])
}

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
    // Names in it may come from files.
    write(format!("{}\n", printable(text)).as_bytes())
}

/// Prints a value as JSON.
pub fn print_json(value: &serde_json::Value) -> Result<(), Report> {
    write(format!("{value:#}\n").as_bytes())
}

/// Prints what is for a program, to the letter.
pub fn write(bytes: &[u8]) -> Result<(), Report> {
    use std::io::{ErrorKind, Write};
    let mut output = std::io::stdout();
    match output.write_all(bytes).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(miette::miette!("cannot write the output: {error}")),
        _ => Ok(()),
    }
}
