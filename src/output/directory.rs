//! The directory of a run's outputs: either complete under its final name, or not there at all.
//!
//! Beside the final directory `NAME` stands the working directory `.NAME.partial` until the run is complete:
//!
//! | in it | what |
//! |---|---|
//! | `lock` | locked by the process that works here |
//! | `outputs/` | the outputs in the making, which become `NAME` by being renamed |
//! | `replaced/` | for a moment: the outputs of an earlier run that they replace |
//! | `journal`, `checkpoint-…` | what it takes to resume the run (see [`crate::run::checkpoint`]) |
//! | `batch.json` | what it takes to continue a batch of runs, whose complete runs are in `outputs/` |

use crate::output::SinkError;
use crate::place::parent_of;
use crate::shell::command;
use crate::text::shown_path;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// The file that the complete directory of a run holds; a directory without it is never replaced.
pub const SUMMARY_FILE: &str = "summary.json";

/// The file that the directory of runs with several seeds holds in its place.
pub const SEEDS_FILE: &str = "seeds.json";

/// The file that the directory of a sweep holds in its place.
pub const SWEEP_FILE: &str = "sweep.json";

/// The file in the working directory that says what a batch of runs was asked to do.
pub const BATCH_FILE: &str = "batch.json";

/// The beginning of the names of checkpoints in the working directory; the number of the cycle follows.
pub const CHECKPOINT_PREFIX: &str = "checkpoint-";

const LOCK: &str = "lock";
const OUTPUTS: &str = "outputs";
const REPLACED: &str = "replaced";

/// What to do about outputs that are already there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Leave them alone, and fail.
    Refuse,
    /// Replace them, once the new ones are complete; an interrupted run is discarded at once.
    Overwrite,
}

/// A directory in which outputs are written beside the final one.
///
/// [`OutputDirectory::complete`] gives it its final name; dropped without that, it is removed with all that it holds, unless
/// it holds a checkpoint.
#[derive(Debug)]
pub struct OutputDirectory {
    working: PathBuf,
    outputs: PathBuf,
    destination: PathBuf,
    existing: Existing,
    /// Locked as long as it is open.
    lock: File,
}

impl OutputDirectory {
    /// Creates the working directory of outputs whose final place is `destination`; missing parents are created.
    ///
    /// # Errors
    /// If `destination` exists and may not be replaced, if a run is under way there or was interrupted, or if nothing can
    /// be written beside it.
    pub fn create(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working(&destination)?;
        check_destination(&destination, existing)?;
        let parent = parent_of(&destination);
        fs::create_dir_all(parent).map_err(|error| failure(parent, "cannot create the directory", &error))?;
        let directory = Self::lock(working, destination, existing)?;
        let kept = checkpoints(&directory.working);
        if let (Some((cycle, _)), Existing::Refuse) = (kept.first(), existing) {
            return Err(SinkError {
                reason: format!(
                    "a run was interrupted there and is kept up to cycle {cycle}: `{}` continues it, --overwrite \
                     discards it",
                    command("isobar resume", &[&directory.destination])
                ),
                path: directory.destination.clone(),
            });
        }
        let batch = directory.working.join(BATCH_FILE);
        if existing == Existing::Refuse && directory.keeps_batch() {
            return Err(SinkError {
                reason: format!(
                    "{} complete runs of a batch that was interrupted are kept: `{}` runs the others, --overwrite \
                     discards them",
                    complete_runs(&directory.outputs),
                    command("isobar resume", &[&directory.destination])
                ),
                path: directory.destination.clone(),
            });
        }
        if batch.exists() {
            fs::remove_file(&batch).map_err(|error| failure(&batch, "cannot be removed", &error))?;
        }
        for (_, checkpoint) in kept {
            fs::remove_file(&checkpoint).map_err(|error| failure(&checkpoint, "cannot be removed", &error))?;
        }
        directory.clear()?;
        Ok(directory)
    }

    /// Opens the directory of an interrupted run again. Its outputs are made anew.
    ///
    /// # Errors
    /// If there is none, or a run is under way there.
    pub fn resume(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working(&destination)?;
        if checkpoints(&working).is_empty() {
            let reason = if destination.join(SUMMARY_FILE).is_file() {
                "the run is complete".into()
            } else {
                format!(
                    "there is no checkpoint in {}, so nothing of it is kept: begin the run anew",
                    shown_path(&working)
                )
            };
            return Err(SinkError { path: destination, reason });
        }
        let directory = Self::lock(working, destination, existing)?;
        if !directory.outputs.exists() && directory.destination.join(SUMMARY_FILE).is_file() {
            // It was ended after its outputs had their final name and before all else was cleared away.
            checkpoints(&directory.working).iter().for_each(|(_, path)| drop(fs::remove_file(path)));
            return Err(SinkError { path: directory.destination.clone(), reason: "the run is complete".into() });
        }
        directory.clear()?;
        Ok(directory)
    }

    /// Opens the directory of an interrupted batch again, with its complete runs.
    ///
    /// # Errors
    /// If there is none, or it is under way.
    pub fn resume_batch(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let working = working(&destination)?;
        if !working.join(BATCH_FILE).is_file() {
            return Err(SinkError { path: destination, reason: "no batch was interrupted there".into() });
        }
        let directory = Self::lock(working, destination, existing)?;
        if !directory.outputs.exists() {
            // It was ended after its outputs had their final name and before all else was cleared away.
            let _ = fs::remove_file(directory.working.join(BATCH_FILE));
            return Err(SinkError { path: directory.destination.clone(), reason: "the batch is complete".into() });
        }
        directory.put_back()?;
        Ok(directory)
    }

    /// Whether there are complete runs of a batch to continue.
    fn keeps_batch(&self) -> bool {
        self.working.join(BATCH_FILE).is_file() && complete_runs(&self.outputs) > 0
    }

    /// Makes the working directory and locks it.
    fn lock(working: PathBuf, destination: PathBuf, existing: Existing) -> Result<Self, SinkError> {
        let cannot = |error: &io::Error| failure(&working, "cannot create a directory for the outputs", error);
        let path = working.join(LOCK);
        // Whoever was here before may be about to remove the directory, and with it the file that we lock.
        for _ in 0..10 {
            match fs::create_dir(&working) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(cannot(&error)),
                _ => {}
            }
            let opened = File::options().create(true).truncate(false).write(true).open(&path);
            let lock = match opened {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                opened => opened.map_err(|error| cannot(&error))?,
            };
            match lock.try_lock() {
                Ok(()) if is_at(&lock, &path) => {
                    let outputs = working.join(OUTPUTS);
                    return Ok(Self { working, outputs, destination, existing, lock });
                }
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    let reason = "another run writes there at this moment; wait for its end, or choose another --out";
                    return Err(SinkError { path: destination, reason: reason.into() });
                }
                Err(TryLockError::Error(error)) => return Err(failure(&path, "cannot be locked", &error)),
            }
        }
        Err(SinkError { path: working, reason: "the directory keeps disappearing; is another run using it?".into() })
    }

    /// Outputs that were about to be replaced go back to their place, unless that is taken.
    fn put_back(&self) -> Result<(), SinkError> {
        let replaced = self.working.join(REPLACED);
        let cannot = |error: io::Error| failure(&replaced, "cannot be cleared away", &error);
        match (replaced.exists(), self.destination.exists()) {
            (false, _) => Ok(()),
            (true, true) => fs::remove_dir_all(&replaced).map_err(cannot),
            (true, false) => fs::rename(&replaced, &self.destination).map_err(cannot),
        }
    }

    /// Leaves no outputs of an earlier attempt, but never loses those that one was about to replace.
    fn clear(&self) -> Result<(), SinkError> {
        self.put_back()?;
        let cannot = |path: &Path, error: &io::Error| failure(path, "cannot be cleared away", error);
        // The directory itself stays: where it is missing, it has become the destination.
        match fs::read_dir(&self.outputs) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                fs::create_dir(&self.outputs).map_err(|error| failure(&self.outputs, "cannot be created", &error))
            }
            Err(error) => Err(cannot(&self.outputs, &error)),
            Ok(entries) => entries.into_iter().try_for_each(|entry| {
                let path = entry.map_err(|error| cannot(&self.outputs, &error))?.path();
                let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
                removed.map_err(|error| cannot(&path, &error))
            }),
        }
    }

    /// Where outputs are written until they are complete.
    pub fn path(&self) -> &Path {
        &self.outputs
    }

    /// Where journal and checkpoints are.
    pub fn working(&self) -> &Path {
        &self.working
    }

    /// Where the outputs will be when complete.
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Moves the outputs to their final name, and removes those that were there before.
    ///
    /// # Errors
    /// If the destination has meanwhile come to be something that may not be replaced, or if it cannot be renamed; what
    /// was there before is then there again.
    pub fn complete(self) -> Result<(), SinkError> {
        let Self { working, outputs, destination, existing, .. } = &self;
        check_destination(destination, *existing)?;
        sync_all(outputs).map_err(|error| failure(destination, "the outputs cannot be stored", &error))?;
        let replaced = working.join(REPLACED);
        let is_replaced = fs::symlink_metadata(destination).is_ok();
        if is_replaced {
            let moved = fs::rename(destination, &replaced);
            moved.map_err(|error| failure(destination, "cannot move the old outputs away", &error))?;
        }
        if let Err(error) = fs::rename(outputs, destination) {
            let mut failed = failure(destination, "cannot move the outputs there", &error);
            if is_replaced && let Err(error) = fs::rename(&replaced, destination) {
                let place = shown_path(&replaced);
                failed.reason += &format!("; the old outputs are in {place} and could not be put back: {error}");
            }
            return Err(failed);
        }
        let _ = sync_directory(parent_of(destination));
        // The checkpoints first: without them nothing is left to be resumed, whatever happens now.
        checkpoints(working).iter().for_each(|(_, path)| drop(fs::remove_file(path)));
        fs::remove_dir_all(working)
            .map_err(|error| failure(working, "the outputs are complete, but this remains", &error))
    }
}

impl Drop for OutputDirectory {
    fn drop(&mut self) {
        // Only the owner of the lock removes: it is still held here. Of old outputs there must be no doubt.
        if checkpoints(&self.working).is_empty() && !self.working.join(REPLACED).exists() && !self.keeps_batch() {
            let _ = fs::remove_dir_all(&self.working);
        }
        let _ = self.lock.unlock();
    }
}

/// The number of complete runs in a directory and those below it, as far down as a batch has any.
pub fn complete_runs(directory: &Path) -> usize {
    fn count(directory: &Path, depth: usize) -> usize {
        let Ok(entries) = fs::read_dir(directory) else { return 0 };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_dir());
        // What is in the making has a name with a dot.
        let named = paths.filter(|path| !path.file_name().is_some_and(|it| it.to_string_lossy().starts_with('.')));
        let of_one = |path: PathBuf| {
            if path.join(SUMMARY_FILE).is_file() {
                1
            } else if depth > 1 {
                count(&path, depth - 1)
            } else {
                0
            }
        };
        named.map(of_one).sum()
    }
    count(directory, 2)
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

/// Makes renamings in a directory durable.
///
/// # Errors
/// Those of the file system.
pub fn sync_directory(directory: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(directory)?.sync_all() } else { Ok(()) }
}

/// The working directory for a destination.
///
/// # Errors
/// If the destination does not end in a name.
pub fn working(destination: &Path) -> Result<PathBuf, SinkError> {
    match destination.file_name() {
        Some(name) => Ok(parent_of(destination).join(format!(".{}.partial", name.to_string_lossy()))),
        None => Err(SinkError {
            path: destination.to_path_buf(),
            reason: "the path does not end in a directory's name".into(),
        }),
    }
}

/// Whether the file is still the one of that name.
fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let same = |(a, b): (fs::Metadata, fs::Metadata)| (a.dev(), a.ino()) == (b.dev(), b.ino());
        file.metadata().ok().zip(fs::metadata(path).ok()).is_some_and(same)
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        path.exists()
    }
}

/// Makes all files in a directory and below it durable.
fn sync_all(directory: &Path) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        if path.is_dir() {
            sync_all(&path)?;
        } else {
            File::options().write(true).open(&path)?.sync_all()?;
        }
    }
    sync_directory(directory)
}

/// Whether outputs may go to `destination`.
fn check_destination(destination: &Path, existing: Existing) -> Result<(), SinkError> {
    let refuse = |reason: &str| Err(SinkError { path: destination.to_path_buf(), reason: reason.into() });
    let metadata = match fs::symlink_metadata(destination) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(failure(destination, "cannot be examined", &error)),
    };
    match existing {
        _ if !metadata.is_dir() => refuse("it exists and is not a directory"),
        Existing::Refuse => refuse("it exists already (--overwrite replaces it, once the new run is complete)"),
        Existing::Overwrite
            if ![SUMMARY_FILE, SEEDS_FILE, SWEEP_FILE].iter().any(|file| destination.join(file).is_file()) =>
        {
            refuse(
                "it exists and holds no summary.json, so it is not the output of a complete run, and will not be deleted",
            )
        }
        Existing::Overwrite => Ok(()),
    }
}

fn failure(path: &Path, what: &str, error: &io::Error) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: format!("{what}: {error}") }
}

#[cfg(test)]
#[path = "directory_tests.rs"]
mod tests;
