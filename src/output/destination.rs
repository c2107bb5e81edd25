//! What stands where outputs are to go: nothing, the outputs of earlier runs, or something else, which is never touched.

use crate::output::{SinkError, contents};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The file that the complete directory of a run holds; a directory without it is never replaced.
pub const SUMMARY_FILE: &str = "summary.json";

/// The file that the directory of runs with several seeds holds in its place.
pub const SEEDS_FILE: &str = "seeds.json";

/// The file that the directory of a sweep holds in its place.
pub const SWEEP_FILE: &str = "sweep.json";

/// Every directory that `--overwrite` replaces has one of these files.
const KINDS: [&str; 3] = [SUMMARY_FILE, SEEDS_FILE, SWEEP_FILE];

/// How far below the directory of a batch its runs are.
pub const RUNS_DEPTH: usize = 2;

/// What to do about outputs that are already there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Leave them alone, and fail.
    Refuse,
    /// Replace them, once the new ones are complete; an interrupted run is discarded at once.
    Overwrite,
}

/// Whether outputs may go to `destination`.
///
/// # Errors
/// If not, with the reason.
pub fn check(destination: &Path, existing: Existing) -> Result<(), SinkError> {
    let refuse = |reason: &str| Err(SinkError { path: destination.to_path_buf(), reason: reason.into() });
    let metadata = match fs::symlink_metadata(destination) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) if error.kind() == ErrorKind::NotADirectory => {
            return refuse("a part of this path is a file, not a directory: choose another --out");
        }
        Err(error) => return refuse(&format!("cannot be examined: {error}")),
    };
    match existing {
        _ if !metadata.is_dir() => refuse("it exists and is not a directory"),
        Existing::Refuse => refuse("it exists already (--overwrite replaces it, once the new run is complete)"),
        Existing::Overwrite if !is_complete(destination) => refuse(
            "it exists and holds no summary.json, so it is not the output of a complete run, and will not be deleted",
        ),
        Existing::Overwrite => contents::check(destination),
    }
}

/// Whether a directory holds complete outputs, of a run or of several.
pub fn is_complete(directory: &Path) -> bool {
    KINDS.iter().any(|file| directory.join(file).is_file())
}

/// Refuses to replace the directory of several runs by that of one.
///
/// # Errors
/// If it is that of several.
pub fn check_single(destination: &Path) -> Result<(), SinkError> {
    if ![SEEDS_FILE, SWEEP_FILE].iter().any(|file| destination.join(file).is_file()) {
        return Ok(());
    }
    let runs = complete_runs(destination);
    let reason = format!(
        "it holds a batch of {runs} runs, which a single run does not replace: choose another --out, or remove it"
    );
    Err(SinkError { path: destination.to_path_buf(), reason })
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
    count(directory, RUNS_DEPTH)
}
