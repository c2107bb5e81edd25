//! Files that a scenario names.

use super::{Field, Read};
use crate::safe_file;
use crate::shipped;
use crate::text::{clean, shown_path};
use isobar_obs::table::{decode, rows};
use std::io;

/// The largest file \[bytes\].
const LARGEST_FILE: u64 = 100_000_000;

/// The most bytes of all files of a scenario, each counted as often as it is named: what is read of them takes some four
/// times as much.
const MOST_BYTES: u64 = 300_000_000;

/// The text of the file that a key names, relative to the scenario; the results depend on its contents. `what` it is, for
/// messages.
pub(crate) fn read(field: &Field<'_>, what: &str) -> Read<String> {
    let bytes = bytes(field, what)?;
    let text = decode(&bytes, &field.text()?).map_err(|error| field.invalid(clean(&error.to_string()), "this file"))?;
    field.file.has_read(&field.text()?, checksum(text));
    Ok(text.to_owned())
}

/// The bytes of a file that is not text, likewise.
pub(crate) fn read_bytes(field: &Field<'_>, what: &str) -> Read<Vec<u8>> {
    let bytes = bytes(field, what)?;
    field.file.has_read(&field.text()?, crc32fast::hash(&bytes));
    Ok(bytes)
}

fn bytes(field: &Field<'_>, what: &str) -> Read<Vec<u8>> {
    let path = field.path()?;
    let shown = shown_path(&path);
    // Neither a directory nor a pipe, which might never end, nor begin.
    if !shipped::is_file(&path) {
        return Err(field.invalid(format!("the {what} {shown} does not exist"), "a path relative to this scenario"));
    }
    let fault = |error: io::Error| field.invalid(format!("{shown}: {error}"), "cannot be used");
    let bytes = safe_file::read_named(&path, LARGEST_FILE).map_err(fault)?;
    if field.file.count(bytes.len() as u64) > MOST_BYTES {
        let message = format!("with {shown} the files of this scenario have more than {} MB", MOST_BYTES / 1_000_000);
        return Err(field.invalid(message, "too much in all"));
    }
    Ok(bytes)
}

/// A checksum of what a table says: remarks, empty lines, line ends and quotation marks do not count.
fn checksum(text: &str) -> u32 {
    let mut checksum = crc32fast::Hasher::new();
    for row in rows(text) {
        for field in &row {
            checksum.update(&(field.len() as u64).to_le_bytes());
            checksum.update(field.as_bytes());
        }
        checksum.update(&u64::MAX.to_le_bytes());
    }
    checksum.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_what_a_table_says() {
        let of = |text: &str| checksum(text);
        let plain = of("a,b\n1,2\n");
        for same in ["# by hand\n\na,b\n1,2", "\u{feff}a,b\r\n1,2\r\n\r\n", " a , \"b\"\n\"1\",2,,\n,,\n#1,3\n"] {
            assert_eq!(of(same), plain, "{same:?}");
        }
        for other in ["a,b\n1,3\n", "a,b\n1,2\n1,2\n", "a,b\n12\n", "a,b\n12,\n", "a,b,1\n2\n", "a,b\n,1,2\n", ""] {
            assert_ne!(of(other), plain, "{other:?}");
        }
    }
}
