//! Commands that messages propose, written so that they can be pasted into a shell.

use crate::text::is_unprintable;
use std::path::Path;

/// A command, such as `isobar resume`, and the files that it is given as its last words, quoted where that is necessary. A
/// file whose name begins with a hyphen is not taken for an option.
pub(crate) fn command(words: &str, files: &[&Path]) -> String {
    files.iter().fold(words.to_string(), |command, file| command + " " + &word(file))
}

/// A path as one word of a shell, without anything that a terminal would obey, and without the backquotes in which
/// messages set commands.
fn word(path: &Path) -> String {
    let prefix = if path.as_os_str().as_encoded_bytes().starts_with(b"-") { "./" } else { "" };
    let printable = path.to_str().filter(|text| !text.chars().any(|c| is_unprintable(c) || c == '`'));
    match printable.and_then(|text| shlex::try_quote(text).ok()) {
        Some(quoted) => format!("{prefix}{quoted}"),
        None => format!("{prefix}{}", escaped(path)),
    }
}

/// A path in the quotation marks `$'…'`, in which any byte can be written as a number.
fn escaped(path: &Path) -> String {
    let mut word = String::from("$'");
    let put = |word: &mut String, byte: u8| word.push_str(&format!("\\{byte:03o}"));
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        for character in chunk.valid().chars() {
            if is_unprintable(character) || "'`\\".contains(character) {
                character.encode_utf8(&mut [0; 4]).bytes().for_each(|byte| put(&mut word, byte));
            } else {
                word.push(character);
            }
        }
        chunk.invalid().iter().for_each(|&byte| put(&mut word, byte));
    }
    word + "'"
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    use std::process::Command;

    #[test]
    fn plain_names_stay_as_they_are() {
        let command = |name: &str| command("isobar check", &[Path::new(name)]);
        assert_eq!(command("out/a-b_c.toml"), "isobar check out/a-b_c.toml");
        assert_eq!(command("my run.toml"), "isobar check 'my run.toml'");
        assert_eq!(command("-x.toml"), "isobar check ./-x.toml");
        assert_eq!(command("-a b"), "isobar check ./'-a b'");
    }

    /// A shell gives back each name, byte for byte, and no terminal has anything to obey.
    #[test]
    fn a_shell_reads_what_was_meant() {
        let names: [&[u8]; 16] = [
            b"plain.toml",
            b"my run.toml",
            b"it's",
            b"say \"x\"",
            b"-x",
            b"--out=$HOME",
            b"~root/a",
            b"a;b&c|d>e<f(g)h#i*j?k[l]",
            b"wow!^2",
            b"back\\slash",
            b"tick`date`'s",
            b"\x1b[31mred\x07",
            b"two\nlines\tand tab",
            "Z\u{fc}rich \u{202e}".as_bytes(),
            b"latin-1 \xfc7",
            b"{a,b} %3 =x",
        ];
        for name in names {
            let path = Path::new(OsStr::from_bytes(name));
            let line = command("printf %s", &[path]);
            assert!(!line.chars().any(is_unprintable) && !line.contains('`'), "{line:?}");
            let output = Command::new("bash").args(["-c", &line]).output().unwrap();
            let expected = if name.starts_with(b"-") { [b"./", name].concat() } else { name.to_vec() };
            assert_eq!(output.stdout, expected, "{line}");
        }
    }
}
