//! The file that `--out` names: one that exists is replaced only on request, and only if it is of the same kind.

use crate::safe_file;
use crate::text::shown_path;
use miette::{Report, miette};
use std::io::{ErrorKind, Read};
use std::path::Path;

/// What every page of isobar has in its head.
const MARK: &str = "<meta name=\"generator\" content=\"isobar\">";

/// Bytes at the beginning of a file that tell what it is: a page has its mark there, and a table its header.
const HEAD_LENGTH: u64 = 500;

/// Writes the file. With `overwrite` it replaces one of `kinds`, as in `pages of isobar`, for which `is_own` holds.
pub fn write(
    out: &Path,
    overwrite: bool,
    bytes: &[u8],
    kinds: &str,
    is_own: impl Fn(&Path) -> bool,
) -> Result<(), Report> {
    let shown = shown_path(out);
    if overwrite && out.exists() && !is_own(out) {
        let help = "--out writes to another place";
        return Err(miette!(help = help, "{shown} exists, and --overwrite replaces only {kinds}"));
    }
    let write = if overwrite { safe_file::replace } else { safe_file::write_new };
    write(out, bytes).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => exists(out),
        _ => miette!("cannot write {shown}: {error}"),
    })
}

/// The error that there is a file of that name.
pub fn exists(out: &Path) -> Report {
    miette!(help = "--overwrite replaces it, --out writes to another place", "{} exists", shown_path(out))
}

/// Whether a file is a page that isobar wrote. One that cannot be opened cannot be replaced either, and that says why.
pub fn is_page(path: &Path) -> bool {
    head(path).is_none_or(|head| head.contains(MARK))
}

/// Whether a file is a table with this first line, likewise.
pub fn is_table(path: &Path, header: &str) -> bool {
    head(path).is_none_or(|head| head.lines().next() == Some(header))
}

/// Whether a file begins with these characters, likewise.
pub fn begins_with(path: &Path, beginning: &str) -> bool {
    head(path).is_none_or(|head| head.starts_with(beginning))
}

/// The beginning of a file; `None` if it cannot be opened.
fn head(path: &Path) -> Option<String> {
    let mut head = Vec::new();
    let is_read = safe_file::open(path).ok()?.take(HEAD_LENGTH).read_to_end(&mut head).is_ok();
    Some(if is_read { String::from_utf8_lossy(&head).into_owned() } else { String::new() })
}
