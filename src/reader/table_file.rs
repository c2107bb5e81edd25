//! Files that hold tables, of which a scenario names the path.

use crate::text::clean;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The largest file of stations, observations or fields \[bytes\].
pub const LARGEST_FILE: u64 = 100_000_000;

/// The bytes of a file of at most `largest` of them.
///
/// # Errors
/// In words, without the file's name.
pub fn read(path: &Path, largest: u64) -> Result<Vec<u8>, String> {
    // A pipe might never end, nor begin.
    if !std::fs::metadata(path).map_err(|error| error.to_string())?.is_file() {
        return Err("it is not a file".into());
    }
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|error| error.to_string())?;
    file.take(largest + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() as u64 > largest {
        return Err(format!("it is larger than {} MB", largest / 1_000_000));
    }
    Ok(bytes)
}

/// What a message calls a file: its path as the scenario gives it, wherever the scenario is. A run is resumed by its
/// scenario's absolute path, and must find the same.
pub fn called(path: &Path, directory: &Path) -> String {
    clean(&path.strip_prefix(directory).unwrap_or(path).display().to_string())
}
