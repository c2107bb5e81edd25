//! The working directory of a run: locked by the process that works there, and examined before anything in it is touched.
//!
//! Whoever may write beside the outputs can put a directory of this name there, and an archive may bring one. So one that
//! holds links, pipes or devices, or belongs to somebody else, is refused as it is.

use crate::output::SinkError;
use crate::place::parent_of;
use crate::safe_file::{self, is_at};
use crate::text::shown_path;
use std::ffi::OsString;
use std::fs::{self, DirBuilder, File, Metadata, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

const LOCK: &str = "lock";

/// The beginning of the names of checkpoints in a working directory; the number of the cycle follows.
pub const CHECKPOINT_PREFIX: &str = "checkpoint-";

/// What ends the name of a working directory.
const PARTIAL: &str = ".partial";

/// How often a directory is sought again that others remove at that moment.
const ATTEMPTS: usize = 20;

/// How often one without a lock is looked at before it counts as one that isobar did not make.
const PATIENCE: usize = 5;

/// A working directory that no other process uses.
#[derive(Debug)]
pub struct WorkingDirectory {
    path: PathBuf,
    /// Locked as long as it is open.
    lock: File,
}

impl WorkingDirectory {
    /// Locks the working directory for a destination; makes it if there is none.
    ///
    /// # Errors
    /// If another process uses it, if it is not one that isobar made for this user, or if nothing can be written there.
    pub fn lock(destination: &Path) -> Result<Self, SinkError> {
        let path = path(destination)?;
        let cannot = |error: &io::Error| failure(&path, "cannot create a directory for the outputs", error);
        let lock_path = path.join(LOCK);
        let owner = Owner::beside(&path).map_err(|error| cannot(&error))?;
        let mut without_lock = 0;
        // Whoever was here before may be about to remove the directory, and with it the file that we lock.
        for _ in 0..ATTEMPTS {
            let made = match make(&path) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(cannot(&error)),
                made => made.is_ok(),
            };
            match check_directory(&path, owner) {
                Ok(true) => {}
                Ok(false) => continue,
                Err(reason) => return Err(refused(&path, &reason)),
            }
            let opened = match safe_file::open_to_change(&lock_path) {
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    if !made && !is_empty(&path) {
                        // Another process may have come first, or be about to leave.
                        without_lock += 1;
                        if without_lock < PATIENCE {
                            continue;
                        }
                        return Err(refused(&path, "it has no lock"));
                    }
                    safe_file::create_new(&lock_path)
                }
                opened => opened,
            };
            let lock = match opened {
                Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::AlreadyExists) => continue,
                Err(error) if made => return Err(cannot(&error)),
                Err(error) => return Err(refused(&path, &format!("{LOCK}: {error}"))),
                Ok(lock) => lock,
            };
            match lock.try_lock() {
                Ok(()) if is_at(&lock, &lock_path) => {
                    examine(destination)?;
                    return Ok(Self { path, lock });
                }
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    let reason = "another run writes there at this moment; wait for its end, or choose another --out";
                    return Err(SinkError { path: destination.to_path_buf(), reason: reason.into() });
                }
                Err(TryLockError::Error(error)) => return Err(failure(&lock_path, "cannot be locked", &error)),
            }
        }
        Err(SinkError { path, reason: "the directory keeps disappearing; is another run using it?".into() })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes everything in it but the lock and what `keep` names.
    ///
    /// # Errors
    /// The first thing that cannot be removed.
    pub fn clear(&self, keep: &[&str]) -> Result<(), SinkError> {
        if !is_at(&self.lock, &self.path.join(LOCK)) {
            let reason = "it is no longer the directory in which this run began".into();
            return Err(SinkError { path: self.path.clone(), reason });
        }
        let stays = |entry: &Path| {
            let name = entry.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name == LOCK || keep.contains(&name))
        };
        clear(&self.path, &stays)
    }

    /// Removes it with all that it holds.
    ///
    /// # Errors
    /// The first thing that cannot be removed.
    pub fn remove(&self) -> Result<(), SinkError> {
        self.clear(&[])?;
        // The lock goes last: until then nobody else is here. From then on others may be, and the directory is theirs.
        let lock = self.path.join(LOCK);
        let removed = fs::remove_file(&lock).map_err(|error| failure(&lock, "cannot be removed", &error));
        match removed.map(|()| fs::remove_dir(&self.path)) {
            Ok(Err(error)) if !matches!(error.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::NotFound) => {
                Err(failure(&self.path, "cannot be removed", &error))
            }
            other => other.map(drop),
        }
    }
}

impl Drop for WorkingDirectory {
    fn drop(&mut self) {
        let _ = self.lock.unlock();
    }
}

/// The working directory for a destination.
///
/// # Errors
/// If the destination does not end in a name.
pub fn path(destination: &Path) -> Result<PathBuf, SinkError> {
    match destination.file_name() {
        Some(name) => {
            let mut partial = OsString::from(".");
            partial.push(name);
            partial.push(PARTIAL);
            Ok(parent_of(destination).join(partial))
        }
        None => Err(SinkError {
            path: destination.to_path_buf(),
            reason: "the path does not end in a directory's name".into(),
        }),
    }
}

/// Refuses a working directory that isobar did not make for this user: nothing in it may be read, and nothing is changed.
/// One that is not there is not refused.
///
/// # Errors
/// If it is such a one, with what is wrong.
pub fn examine(destination: &Path) -> Result<(), SinkError> {
    let path = path(destination)?;
    if fs::symlink_metadata(&path).is_err_and(|error| error.kind() == ErrorKind::NotFound) {
        return Ok(());
    }
    let owner = Owner::beside(&path).map_err(|error| failure(&path, "nothing can be written beside it", &error))?;
    let checked =
        check_directory(&path, owner).and_then(|is_there| if is_there { check_entries(&path, owner) } else { Ok(()) });
    checked.map_err(|reason| refused(&path, &reason))
}

/// Removes everything in a directory but what stays.
///
/// # Errors
/// The first thing that cannot be removed.
pub fn clear(directory: &Path, stays: &dyn Fn(&Path) -> bool) -> Result<(), SinkError> {
    let cannot = |path: &Path, error: &io::Error| failure(path, "cannot be cleared away", error);
    for entry in fs::read_dir(directory).map_err(|error| cannot(directory, &error))? {
        let path = entry.map_err(|error| cannot(directory, &error))?.path();
        if !stays(&path) {
            remove(&path).map_err(|error| cannot(&path, &error))?;
        }
    }
    Ok(())
}

/// Removes the working directories of a batch's runs from its outputs, but those that stay.
///
/// # Errors
/// The first one that cannot be removed.
pub fn clear_runs(outputs: &Path, depth: usize, stays: &dyn Fn(&Path) -> bool) -> Result<(), SinkError> {
    let cannot = |path: &Path, error: &io::Error| failure(path, "cannot be cleared away", error);
    let runs = of_runs(outputs, depth).map_err(|error| cannot(outputs, &error))?;
    runs.iter().filter(|path| !stays(path)).try_for_each(|path| remove(path).map_err(|error| cannot(path, &error)))
}

/// The working directories in a batch's outputs and below them.
///
/// # Errors
/// Those of the file system.
pub fn of_runs(outputs: &Path, depth: usize) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(outputs) {
        // What is not there holds none.
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with('.') && name.ends_with(PARTIAL) {
            found.push(path);
        } else if depth > 1 && path.is_dir() {
            found.extend(of_runs(&path, depth - 1)?);
        }
    }
    Ok(found)
}

/// The checkpoints in a working directory with their cycles, the newest first.
pub fn checkpoints(working: &Path) -> Vec<(usize, PathBuf)> {
    let Ok(entries) = fs::read_dir(working) else { return Vec::new() };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let cycle = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix(CHECKPOINT_PREFIX)?.parse().ok();
    let mut all: Vec<(usize, PathBuf)> = paths.filter_map(|path| Some((cycle(&path)?, path))).collect();
    all.sort_by(|a, b| b.cmp(a));
    all
}

/// Removes a file, a link, or a directory with all that it holds; no link is followed.
fn remove(path: &Path) -> io::Result<()> {
    if fs::symlink_metadata(path)?.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }
}

/// Makes the directory. However much others may write here, they may not write into it.
fn make(path: &Path) -> io::Result<()> {
    let mut builder = DirBuilder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::DirBuilderExt;
        builder.mode(0o755);
    }
    builder.create(path)
}

fn is_empty(directory: &Path) -> bool {
    fs::read_dir(directory).is_ok_and(|mut entries| entries.next().is_none())
}

/// Whether the directory is there, and nobody else's.
///
/// # Errors
/// In words, if it is not what it should be.
fn check_directory(path: &Path, owner: Owner) -> Result<bool, String> {
    let metadata = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        metadata => metadata.map_err(|error| error.to_string())?,
    };
    if !metadata.is_dir() {
        return Err(format!("it is {}", kind(&metadata)));
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        if metadata.mode() & 0o002 != 0 {
            return Err("everybody may write into it".into());
        }
    }
    owner.check(&metadata)?;
    Ok(true)
}

/// Refuses links, pipes, devices and what belongs to others, in a directory and below it.
fn check_entries(directory: &Path, owner: Owner) -> Result<(), String> {
    let entries = match fs::read_dir(directory) {
        // Another process is removing the directory.
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(|error| error.to_string())?,
    };
    for entry in entries {
        let path = entry.map_err(|error| error.to_string())?.path();
        let shown = || shown_path(&path);
        let metadata = match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => continue,
            metadata => metadata.map_err(|error| format!("{}: {error}", shown()))?,
        };
        if !metadata.is_dir() && !metadata.is_file() {
            return Err(format!("{} is {}", shown(), kind(&metadata)));
        }
        owner.check(&metadata).map_err(|reason| format!("{}: {reason}", shown()))?;
        if metadata.is_dir() {
            check_entries(&path, owner)?;
        }
    }
    Ok(())
}

/// What something is, in words.
fn kind(metadata: &Metadata) -> &'static str {
    if metadata.is_symlink() {
        "a link"
    } else if metadata.is_dir() {
        "a directory"
    } else if metadata.is_file() {
        "a file"
    } else {
        "a pipe or a device"
    }
}

/// Whom the files belong to that this process makes.
#[derive(Clone, Copy, Debug)]
struct Owner {
    #[cfg(unix)]
    user: u32,
}

impl Owner {
    /// The owner of files beside `path`: on a file system of another machine that need not be this process's user.
    fn beside(path: &Path) -> io::Result<Self> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            Ok(Self { user: tempfile::tempfile_in(parent_of(path))?.metadata()?.uid() })
        }
        #[cfg(not(unix))]
        {
            let _ = path;
            Ok(Self {})
        }
    }

    /// Refuses what belongs to somebody else.
    fn check(&self, metadata: &Metadata) -> Result<(), String> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            if metadata.uid() != self.user {
                return Err(format!("it belongs to user {}, and not to user {}", metadata.uid(), self.user));
            }
        }
        let _ = metadata;
        Ok(())
    }
}

fn refused(path: &Path, reason: &str) -> SinkError {
    let reason = format!(
        "this directory is not one that isobar made for you, and stays as it is: {reason}. Remove it, or choose another --out"
    );
    SinkError { path: path.to_path_buf(), reason }
}

fn failure(path: &Path, what: &str, error: &io::Error) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: format!("{what}: {error}") }
}
