//! Files that are opened without following a link or waiting for a pipe, and files that are written as a whole or not at
//! all.
//!
//! What stands in a directory need not be what a run left there: an archive can bring links and pipes, and in a directory
//! such as `/tmp` anyone can make them.

use crate::place::parent_of;
use crate::shipped;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

/// The flag that refuses links.
#[cfg(unix)]
const NO_LINKS: i32 = libc::O_NOFOLLOW;
#[cfg(not(unix))]
const NO_LINKS: i32 = 0;

/// Opens a file for reading.
///
/// # Errors
/// Those of the file system; a link, a pipe, a device or a directory.
pub fn open(path: &Path) -> io::Result<File> {
    regular(guarded(OpenOptions::new().read(true), NO_LINKS).open(path)?)
}

/// The bytes of a file of at most `largest` of them.
///
/// # Errors
/// As [`open`]; a larger file.
pub fn read(path: &Path, largest: u64) -> io::Result<Vec<u8>> {
    whole(open(path)?, largest)
}

/// The same of a file that the user or a scenario has named: it may be a link to a file, or inside the program.
///
/// # Errors
/// Those of the file system; a pipe, a device, a directory or a larger file.
pub fn read_named(path: &Path, largest: u64) -> io::Result<Vec<u8>> {
    if let Some(bytes) = shipped::bytes(path) {
        return Ok(bytes.to_vec());
    }
    whole(regular(guarded(OpenOptions::new().read(true), 0).open(path)?)?, largest)
}

fn whole(file: File, largest: u64) -> io::Result<Vec<u8>> {
    let (length, mut bytes) = (file.metadata()?.len(), Vec::new());
    // It may have grown since.
    if length <= largest {
        file.take(largest + 1).read_to_end(&mut bytes)?;
    }
    if length.max(bytes.len() as u64) > largest {
        let (most, unit) = if largest < 10_000_000 { (largest / 1000, "kB") } else { (largest / 1_000_000, "MB") };
        return Err(io::Error::other(format!("it is larger than {most} {unit}")));
    }
    Ok(bytes)
}

/// Opens a file that is there for writing, without a change to what it holds.
///
/// # Errors
/// As [`open`].
pub fn open_to_change(path: &Path) -> io::Result<File> {
    regular(guarded(OpenOptions::new().read(true).write(true), NO_LINKS).open(path)?)
}

/// Makes an empty file. One that is there is removed first, and never written through: it may be a link, or have another
/// name elsewhere.
///
/// # Errors
/// Those of the file system.
pub fn create(path: &Path) -> io::Result<File> {
    match create_new(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            fs::remove_file(path)?;
            create_new(path)
        }
        made => made,
    }
}

/// Makes an empty file where there is nothing, not even a link.
///
/// # Errors
/// Those of the file system.
pub fn create_new(path: &Path) -> io::Result<File> {
    guarded(OpenOptions::new().write(true).create_new(true), NO_LINKS).open(path)
}

/// Makes a file with these contents, complete or not at all.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`] if there is anything of that name, which stays as it is; those of the file system.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // The system would say so as well, but only after the work.
    if fs::symlink_metadata(path).is_ok() {
        return Err(ErrorKind::AlreadyExists.into());
    }
    let file = prepared(path, bytes)?;
    file.persist_noclobber(path).map_err(|error| error.error)?;
    sync_directory(parent_of(path))
}

/// Replaces a file, or makes it: whatever happens, it holds what it held or these bytes.
///
/// # Errors
/// If it is not a file, such as a link or a pipe, and those of the file system.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let old = match fs::symlink_metadata(path) {
        Ok(metadata) if !metadata.is_file() => return Err(io::Error::other("it is not a file")),
        Ok(metadata) => Some(metadata),
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    let file = prepared(path, bytes)?;
    if let Some(old) = old {
        file.as_file().set_permissions(old.permissions())?;
    }
    file.persist(path).map_err(|error| error.error)?;
    sync_directory(parent_of(path))
}

/// The contents of a file to be, beside its place and durable.
fn prepared(path: &Path, bytes: &[u8]) -> io::Result<tempfile::NamedTempFile> {
    let name = path.file_name().ok_or_else(|| io::Error::other("the path does not end in a file's name"))?;
    // A longer name than the file's own might be too long.
    let prefix = format!(".isobar-{:08x}-", crc32fast::hash(name.as_encoded_bytes()));
    remove_abandoned(parent_of(path), &prefix);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Less what the user's mask takes away, as of any new file.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    // Another process may take it for abandoned before it is locked.
    for _ in 0..10 {
        let mut file = builder.tempfile_in(parent_of(path))?;
        let _ = file.as_file().try_lock();
        if !is_at(file.as_file(), file.path()) {
            continue;
        }
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        return Ok(file);
    }
    Err(io::Error::other("the file that is being written keeps disappearing"))
}

/// Removes what a process that was killed left: whoever still writes has a lock.
fn remove_abandoned(directory: &Path, prefix: &str) {
    let Ok(entries) = fs::read_dir(directory) else { return };
    let begins = |path: &PathBuf| path.file_name().and_then(|name| name.to_str()?.strip_prefix(prefix)).is_some();
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())).filter(begins) {
        // What cannot be opened or removed is in nobody's way.
        if open(&path).is_ok_and(|file| file.try_lock().is_ok()) {
            let _ = fs::remove_file(&path);
        }
    }
}

/// Whether the file is still the one of that name.
pub fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let same = |(a, b): (fs::Metadata, fs::Metadata)| (a.dev(), a.ino()) == (b.dev(), b.ino());
        file.metadata().ok().zip(fs::symlink_metadata(path).ok()).is_some_and(same)
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        path.exists()
    }
}

/// Makes renamings in a directory durable.
///
/// # Errors
/// Those of the file system.
pub fn sync_directory(directory: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(directory)?.sync_all() } else { Ok(()) }
}

/// Neither waits for the other end of a pipe nor becomes the owner of a terminal.
fn guarded(options: &mut OpenOptions, links: i32) -> &mut OpenOptions {
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags(links | libc::O_NONBLOCK | libc::O_NOCTTY);
    }
    let _ = links;
    options
}

/// The file, if it is one.
fn regular(file: File) -> io::Result<File> {
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("it is not a file")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of what becomes `page.html`.
    const PREFIX: &str = ".isobar-5b0f2d40-";

    fn names(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).unwrap();
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn a_new_file_is_there_as_a_whole_and_never_in_place_of_another() {
        let here = tempfile::tempdir().unwrap();
        let path = here.path().join("page.html");
        // What a process that was killed left.
        fs::write(here.path().join(format!("{PREFIX}abc")), "half").unwrap();
        write_new(&path, b"one").unwrap();
        assert_eq!(names(here.path()), ["page.html"]);
        assert_eq!(write_new(&path, b"two").unwrap_err().kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"one");
        replace(&path, b"three").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"three");
        assert!(replace(here.path(), b"").is_err());
        assert_eq!(names(here.path()), ["page.html"]);
    }

    #[test]
    fn what_another_process_is_writing_stays() {
        let here = tempfile::tempdir().unwrap();
        let other = here.path().join(format!("{PREFIX}abc"));
        let file = File::create(&other).unwrap();
        file.try_lock().unwrap();
        write_new(&here.path().join("page.html"), b"one").unwrap();
        assert!(other.exists());
    }

    #[cfg(unix)]
    #[test]
    fn links_and_pipes_are_neither_followed_nor_waited_for() {
        let here = tempfile::tempdir().unwrap();
        let [precious, link, pipe] = ["precious", "link", "pipe"].map(|name| here.path().join(name));
        fs::write(&precious, "precious").unwrap();
        std::os::unix::fs::symlink(&precious, &link).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&link, &pipe, &here.path().to_path_buf()] {
            assert!(open(path).is_err() && open_to_change(path).is_err(), "{path:?}");
            assert!(create_new(path).is_err() && write_new(path, b"new").is_err(), "{path:?}");
            assert!(replace(path, b"new").is_err(), "{path:?}");
        }
        create(&link).unwrap().write_all(b"new").unwrap();
        assert_eq!((fs::read(&precious).unwrap(), fs::read(&link).unwrap()), (b"precious".to_vec(), b"new".to_vec()));
        // Another name of the same file.
        let other = here.path().join("other");
        fs::hard_link(&precious, &other).unwrap();
        create(&other).unwrap().write_all(b"new").unwrap();
        assert_eq!(fs::read(&precious).unwrap(), b"precious");
    }
}
