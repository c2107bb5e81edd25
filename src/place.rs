//! Paths as they are seen from a directory.

use crate::shipped;
use std::path::{Component, Path, PathBuf};

/// The directory in which `path` lies.
pub(crate) fn parent_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The path of a file that another one names: relative to that one's directory, or inside the program.
pub(crate) fn beside(file: &Path, name: &str) -> PathBuf {
    match Path::new(name) {
        inside if shipped::contains(inside) => inside.to_path_buf(),
        relative => file.parent().unwrap_or(Path::new("")).join(relative),
    }
}

/// What leads from a directory to a file, `../stations.csv`, without links on the way; the file's absolute path where
/// nothing does, as between two drives, and where the directories cannot be found.
///
/// The directory need not be there yet. From anywhere, a path into the program is the same.
pub(crate) fn seen_from(directory: &Path, file: &Path) -> PathBuf {
    let relative = || -> Option<PathBuf> {
        let name = file.file_name()?;
        let (from, to) = (real(directory)?, real(parent_of(file))?);
        let (from, to): (Vec<_>, Vec<_>) = (from.components().collect(), to.components().collect());
        let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
        // Different drives share not even the root.
        let up = (shared > 0).then(|| from[shared..].iter().map(|_| Component::ParentDir))?;
        Some(up.chain(to[shared..].iter().copied()).chain([Component::Normal(name)]).collect())
    };
    if shipped::contains(file) { file.to_path_buf() } else { relative().unwrap_or_else(|| from_root(file)) }
}

/// A path from the root, as far as there is one; one into the program stays the same.
pub(crate) fn from_root(path: &Path) -> PathBuf {
    let absolute = if shipped::contains(path) { None } else { std::path::absolute(path).ok() };
    absolute.unwrap_or_else(|| path.to_path_buf())
}

/// A directory without links, as far as it is there; `None` if what is missing of it goes back up.
fn real(directory: &Path) -> Option<PathBuf> {
    let directory = std::path::absolute(directory).ok()?;
    directory.ancestors().find_map(|known| {
        let missing = directory.strip_prefix(known).ok()?;
        let is_plain = missing.components().all(|component| matches!(component, Component::Normal(_)));
        known.canonicalize().ok().filter(|_| is_plain).map(|known| known.join(missing))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn what_leads_to_a_file_leads_there_also_through_links_and_before_the_directory_is_there() {
        let place = tempfile::tempdir().unwrap();
        let here = place.path();
        fs::create_dir_all(here.join("project/data")).unwrap();
        fs::create_dir_all(here.join("scratch/deep/out")).unwrap();
        let file = here.join("project/data/stations.csv");
        fs::write(&file, "x").unwrap();
        assert_eq!(seen_from(&here.join("project/out/a/b"), &file), Path::new("../../../data/stations.csv"));
        assert_eq!(seen_from(&here.join("project/data"), &file), Path::new("stations.csv"));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(here.join("scratch/deep/out"), here.join("project/out")).unwrap();
            let from = here.join("project/out");
            let seen = seen_from(&from, &file);
            assert_eq!(fs::read(from.join(&seen)).unwrap(), b"x", "{}", seen.display());
        }
    }
}
