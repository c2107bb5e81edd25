//! From the bytes of a file to its text.

use super::error::TableError;

/// The text of a table, which must be in UTF-8. `file` is its name, for messages.
///
/// # Errors
/// What the bytes are instead, with the first line that is not text in UTF-8.
pub fn decode<'a>(bytes: &'a [u8], file: &str) -> Result<&'a str, TableError> {
    let beginning = &bytes[..bytes.len().min(1000)];
    let is_wide = beginning.starts_with(&[0xff, 0xfe]) || beginning.starts_with(&[0xfe, 0xff]);
    let fault = |line, problem: &str| Err(TableError::at(file, line, problem));
    if is_wide || beginning.contains(&0) && !beginning.starts_with(b"CDF") {
        return fault(1, "this is text in UTF-16 or not text at all; save the file as CSV in UTF-8");
    }
    if beginning.starts_with(b"PK\x03\x04") {
        return fault(1, "this is a workbook or archive, not a table in CSV; save it as CSV in UTF-8");
    }
    if [&b"\x1f\x8b"[..], b"CDF", b"\x89HDF"].iter().any(|magic| beginning.starts_with(magic)) {
        return fault(1, "this is a compressed or binary file, not a table in CSV");
    }
    std::str::from_utf8(bytes).or_else(|error| {
        let valid = &bytes[..error.valid_up_to()];
        let ends = |at: &usize| valid[*at] == b'\n' || valid[*at] == b'\r' && valid.get(at + 1) != Some(&b'\n');
        let line = (0..valid.len()).filter(ends).count() + 1;
        let byte = bytes[error.valid_up_to()];
        let problem = format!(
            "the byte {byte:#x} is not UTF-8 (in Latin-1 it would be `{}`); save the file as CSV in UTF-8",
            char::from(byte)
        );
        fault(line, &problem)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_utf8_is_named_with_its_line() {
        assert_eq!(decode("\u{feff}id\né".as_bytes(), "t.csv"), Ok("\u{feff}id\né"));
        for (bytes, expected) in [
            (&b"\xff\xfei\0d\0"[..], "t.csv, line 1: this is text in UTF-16"),
            (b"i\0d\0", "line 1: this is text in UTF-16"),
            (
                b"id,x_m\r\na,1\r\nM\xfcnchen,2\n",
                "t.csv, line 3: the byte 0xfc is not UTF-8 (in Latin-1 it would be `ü`)",
            ),
            (b"id\ra\r\xe9", "line 3: the byte 0xe9"),
            (b"PK\x03\x04", "workbook"),
            (b"CDF\x01\0\0", "binary"),
        ] {
            let message = decode(bytes, "t.csv").unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
