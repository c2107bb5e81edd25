//! Files that are replaced as a whole or not at all.

use super::directory::sync_directory;
use crate::place::parent_of;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Writes a file beside its place, makes it durable, and gives it its name: whatever happens, one finds the old contents or
/// the new ones.
///
/// # Errors
/// Those of the file system; the file is then as it was.
pub fn write(path: &Path, contents: &[u8]) -> io::Result<()> {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    let temporary = Path::new(&name);
    // That of an attempt which was killed. A link is not followed, but removed.
    match fs::remove_file(temporary) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let written = File::options().write(true).create_new(true).open(temporary).and_then(|mut file| {
        file.write_all(contents)?;
        file.sync_all()
    });
    let renamed = written.and_then(|()| fs::rename(temporary, path));
    if renamed.is_err() {
        // If it stays, the next attempt removes it.
        let _ = fs::remove_file(temporary);
    }
    renamed.and_then(|()| sync_directory(parent_of(path)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_earlier_attempt_left_is_in_nobodys_way() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("batch.json");
        fs::write(place.path().join("batch.json.new"), "half of it").unwrap();
        for contents in ["first", "second, and longer"] {
            write(&path, contents.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), contents);
        }
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    #[cfg(unix)]
    fn what_cannot_be_replaced_stays_as_it_was() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("batch.json");
        fs::create_dir(&path).unwrap();
        assert!(write(&path, b"x").is_err());
        assert!(path.is_dir() && fs::read_dir(place.path()).unwrap().count() == 1);
        // A planted link leads nowhere.
        let thesis = place.path().join("thesis");
        fs::write(&thesis, "precious").unwrap();
        std::os::unix::fs::symlink(&thesis, place.path().join("plan.json.new")).unwrap();
        write(&place.path().join("plan.json"), b"x").unwrap();
        assert_eq!(fs::read_to_string(&thesis).unwrap(), "precious");
    }
}
