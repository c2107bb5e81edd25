//! The directory of a run's outputs: either complete under its final name, or not there at all.

use crate::sink::SinkError;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The file that the complete directory of a run holds; a directory without it is never replaced.
pub const SUMMARY_FILE: &str = "summary.json";

/// The file that the directory of runs with several seeds holds in its place.
pub const SEEDS_FILE: &str = "seeds.json";

/// What to do about outputs that are already there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Leave them alone, and fail.
    Refuse,
    /// Replace them, once the new ones are complete.
    Overwrite,
}

/// A directory in which outputs are written under a hidden temporary name beside the final one.
///
/// [`OutputDirectory::complete`] gives it its final name; dropped without that, it is removed with all that it holds.
#[derive(Debug)]
pub struct OutputDirectory {
    temporary: TempDir,
    destination: PathBuf,
    existing: Existing,
}

impl OutputDirectory {
    /// Opens a temporary directory for outputs that shall end in `destination`; missing parents are created.
    ///
    /// # Errors
    /// If `destination` exists and may not be replaced, or if nothing can be written beside it.
    pub fn create(destination: impl Into<PathBuf>, existing: Existing) -> Result<Self, SinkError> {
        let destination = destination.into();
        let Some(name) = destination.file_name() else {
            return Err(SinkError { path: destination, reason: "the path does not end in a directory's name".into() });
        };
        let name = name.to_string_lossy().into_owned();
        check_destination(&destination, existing)?;
        let parent = parent_of(&destination);
        fs::create_dir_all(parent).map_err(|error| failure(parent, "cannot create the directory", &error))?;
        let temporary = hidden_directory(parent, &format!(".{name}.partial-"))
            .map_err(|error| failure(parent, "cannot create a temporary directory in it", &error))?;
        Ok(Self { temporary, destination, existing })
    }

    /// Where outputs are written until they are complete.
    pub fn path(&self) -> &Path {
        self.temporary.path()
    }

    /// Where they will be when complete.
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Moves the outputs to their final name, and removes those that were there before.
    ///
    /// # Errors
    /// If the destination has meanwhile come to be something that may not be replaced, or if it cannot be renamed; what
    /// was there before is then there again.
    pub fn complete(self) -> Result<(), SinkError> {
        check_destination(&self.destination, self.existing)?;
        let Self { temporary, destination, .. } = self;
        if fs::symlink_metadata(&destination).is_ok() {
            return replace(temporary, &destination);
        }
        fs::rename(temporary.path(), &destination)
            .map_err(|error| failure(&destination, "cannot move the outputs there", &error))?;
        let _ = temporary.keep();
        Ok(())
    }
}

/// Swaps the complete directory for the one at the destination.
fn replace(temporary: TempDir, destination: &Path) -> Result<(), SinkError> {
    let parent = parent_of(destination);
    let name = destination.file_name().unwrap_or_default().to_string_lossy();
    let attic = hidden_directory(parent, &format!(".{name}.replaced-"))
        .map_err(|error| failure(parent, "cannot create a temporary directory in it", &error))?;
    let old = attic.path().join("old");
    fs::rename(destination, &old).map_err(|error| failure(destination, "cannot move the old outputs away", &error))?;
    if let Err(error) = fs::rename(temporary.path(), destination) {
        let mut failed = failure(destination, "cannot move the outputs there", &error);
        if let Err(error) = fs::rename(&old, destination) {
            let _ = attic.keep();
            failed.reason += &format!("; the old outputs are in {} and could not be put back: {error}", old.display());
        }
        return Err(failed);
    }
    let _ = temporary.keep();
    attic.close().map_err(|error| failure(destination, "the new outputs are complete, the old ones remain", &error))
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
        Existing::Overwrite if ![SUMMARY_FILE, SEEDS_FILE].iter().any(|file| destination.join(file).is_file()) => {
            refuse(
                "it exists and holds no summary.json, so it is not the output of a complete run, and will not be deleted",
            )
        }
        Existing::Overwrite => Ok(()),
    }
}

/// The directory in which `path` lies.
fn parent_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A new directory with the access rights of any other (a temporary directory is otherwise its owner's alone).
fn hidden_directory(parent: &Path, prefix: &str) -> io::Result<TempDir> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
    builder.tempdir_in(parent)
}

fn failure(path: &Path, what: &str, error: &io::Error) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: format!("{what}: {error}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(directory)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    fn finished_run(parent: &Path, text: &str) -> PathBuf {
        let destination = parent.join("quickstart");
        fs::create_dir(&destination).unwrap();
        fs::write(destination.join(SUMMARY_FILE), text).unwrap();
        destination
    }

    #[test]
    fn outputs_appear_under_their_name_only_when_complete() {
        let parent = tempfile::tempdir().unwrap();
        let destination = parent.path().join("out").join("quickstart");
        let output = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
        fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
        let hidden = names(&parent.path().join("out"));
        assert!(hidden.len() == 1 && hidden[0].starts_with(".quickstart.partial-"), "{hidden:?}");
        output.complete().unwrap();
        assert_eq!(names(&parent.path().join("out")), ["quickstart"]);
        assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_complete_outputs_as_they_may_any_new_directory() {
        use std::os::unix::fs::MetadataExt;
        let parent = tempfile::tempdir().unwrap();
        fs::create_dir(parent.path().join("plain")).unwrap();
        OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap().complete().unwrap();
        let mode = |name: &str| fs::metadata(parent.path().join(name)).unwrap().mode() & 0o777;
        assert_eq!(mode("run"), mode("plain"));
    }

    #[test]
    fn without_completion_nothing_remains() {
        let parent = tempfile::tempdir().unwrap();
        let output = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
        fs::write(output.path().join("truth.nc"), "half").unwrap();
        drop(output);
        assert!(names(parent.path()).is_empty());
    }

    #[test]
    fn existing_outputs_are_refused_unless_overwriting_was_asked_for() {
        let parent = tempfile::tempdir().unwrap();
        let destination = finished_run(parent.path(), "old");
        let error = OutputDirectory::create(&destination, Existing::Refuse).unwrap_err();
        assert!(error.to_string().contains("exists already"), "{error}");
        let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
        assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
        fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
        output.complete().unwrap();
        assert_eq!(names(parent.path()), ["quickstart"]);
        assert_eq!(names(&destination), [SUMMARY_FILE]);
        assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
    }

    #[test]
    fn a_failed_swap_brings_the_old_outputs_back() {
        let parent = tempfile::tempdir().unwrap();
        let destination = finished_run(parent.path(), "old");
        let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
        fs::remove_dir_all(output.path()).unwrap();
        let error = output.complete().unwrap_err();
        assert!(error.to_string().contains("cannot move the outputs there"), "{error}");
        assert_eq!(names(parent.path()), ["quickstart"]);
        assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
    }

    #[test]
    fn what_is_not_an_output_is_never_replaced() {
        let parent = tempfile::tempdir().unwrap();
        let (home, file) = (parent.path().join("thesis"), parent.path().join("notes"));
        fs::create_dir(&home).unwrap();
        fs::write(home.join("chapter"), "1").unwrap();
        fs::write(&file, "2").unwrap();
        let error = OutputDirectory::create(&home, Existing::Overwrite).unwrap_err();
        assert!(error.to_string().contains("no summary.json"), "{error}");
        let error = OutputDirectory::create(&file, Existing::Overwrite).unwrap_err();
        assert!(error.to_string().contains("not a directory"), "{error}");
        // It may also come to be there during the run.
        let output = OutputDirectory::create(parent.path().join("late"), Existing::Overwrite).unwrap();
        fs::create_dir(parent.path().join("late")).unwrap();
        fs::write(parent.path().join("late").join("work"), "3").unwrap();
        assert!(output.complete().is_err());
        assert_eq!(names(parent.path()), ["late", "notes", "thesis"]);
        assert_eq!(names(&parent.path().join("late")), ["work"]);
    }

    #[test]
    fn an_impossible_place_is_an_error_that_names_it() {
        let parent = tempfile::tempdir().unwrap();
        fs::write(parent.path().join("file"), "").unwrap();
        let error = OutputDirectory::create(parent.path().join("file").join("run"), Existing::Refuse).unwrap_err();
        assert!(error.to_string().contains("file"), "{error}");
        assert!(OutputDirectory::create("/", Existing::Refuse).is_err());
        assert!(OutputDirectory::create("..", Existing::Overwrite).is_err());
    }
}
