//! Files that a scenario names.

use super::{Field, Read};
use crate::text::clean;
use std::io::Read as _;

/// The largest file \[bytes\].
const LARGEST_FILE: u64 = 100_000_000;

/// The text of the file that a key names, relative to the scenario; the results depend on its contents. `what` it is, for
/// messages.
pub(crate) fn read(field: &Field<'_>, what: &str) -> Read<String> {
    let path = field.file.input(&field.text()?);
    let shown = clean(&path.display().to_string());
    // Neither a directory nor a pipe, which might never end, nor begin.
    if !path.is_file() {
        return Err(field.invalid(format!("the {what} {shown} does not exist"), "a path relative to this scenario"));
    }
    let fault = |reason: String| field.invalid(format!("{shown}: {reason}"), "cannot be used");
    let file = std::fs::File::open(&path).map_err(|error| fault(error.to_string()))?;
    let mut text = String::new();
    file.take(LARGEST_FILE + 1).read_to_string(&mut text).map_err(|error| fault(error.to_string()))?;
    if text.len() as u64 > LARGEST_FILE {
        return Err(fault(format!("it is larger than {} MB", LARGEST_FILE / 1_000_000)));
    }
    Ok(text)
}
