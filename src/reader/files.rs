//! Files that a scenario names.

use super::{Field, Read};
use crate::safe_file;
use crate::text::clean;
use isobar_obs::table::decode;
use std::io::Read as _;
use std::path::Path;

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
    let bytes = bytes(&path, LARGEST_FILE).map_err(fault)?;
    let text = decode(&bytes, &field.text()?).map_err(|error| field.invalid(clean(&error.to_string()), "this file"))?;
    Ok(text.to_owned())
}

/// The bytes of a file of at most `largest` of them.
///
/// # Errors
/// In words, without the file's name.
pub(crate) fn bytes(path: &Path, largest: u64) -> Result<Vec<u8>, String> {
    // A pipe might never end, nor begin.
    let mut bytes = Vec::new();
    let file = safe_file::open_named(path).map_err(|error| error.to_string())?;
    file.take(largest + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() as u64 > largest {
        return Err(format!("it is larger than {} MB", largest / 1_000_000));
    }
    Ok(bytes)
}
