//! What a run wrote into its directory: the list of its files, by which they are told from those that a user put beside them.

use crate::output::SinkError;
use crate::safe_file;
use crate::text::clean;
use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The list, one path in a line, relative to the directory, with `/` between its parts.
pub const LIST_FILE: &str = "files.txt";

/// The largest list \[bytes\]: of ten thousand runs with hundreds of files each.
const LARGEST_LIST: u64 = 500_000_000;

/// How many files of others a message names.
const NAMED: usize = 5;

/// Writes the list of all files in a directory and below it, and makes them and the list durable.
///
/// # Errors
/// Those of the file system, and a name that is not UTF-8 or has more than one line.
pub fn list(directory: &Path) -> io::Result<()> {
    let mut names = BTreeSet::from([LIST_FILE.to_string()]);
    walk(directory, "", &mut |name, path, metadata| {
        if metadata.is_dir() {
            return Ok(true);
        }
        if !metadata.is_file() || name.contains(['\n', '\u{fffd}']) {
            return Err(io::Error::other(format!("{} is not a file of a run", clean(name))));
        }
        fs::File::options().write(true).open(path)?.sync_all()?;
        names.insert(name.to_string());
        Ok(true)
    })?;
    let mut file = safe_file::create(&directory.join(LIST_FILE))?;
    file.write_all(text_of(names.iter().map(String::as_str)).as_bytes())?;
    file.sync_all()?;
    sync_directories(directory)
}

/// Adds a file that is made later to the list.
///
/// # Errors
/// Those of the file system, and a list that is not there.
pub fn add(directory: &Path, name: &str) -> io::Result<()> {
    let path = directory.join(LIST_FILE);
    let text = safe_file::read(&path, LARGEST_LIST)?;
    let text = String::from_utf8_lossy(&text);
    let names: BTreeSet<&str> = text.lines().chain([name]).collect();
    safe_file::replace(&path, text_of(names.into_iter()).as_bytes())
}

/// The text of a list.
fn text_of<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.flat_map(|name| [name, "\n"]).collect()
}

/// Refuses a directory in which there is anything but what a run wrote there, with the names of some of it.
///
/// # Errors
/// If so, if it has no list, and those of the file system.
pub fn check(directory: &Path) -> Result<(), SinkError> {
    let refuse = |reason: String| SinkError { path: directory.to_path_buf(), reason };
    let path = directory.join(LIST_FILE);
    let text = safe_file::read(&path, LARGEST_LIST).map_err(|error| {
        refuse(format!(
            "it exists and is not the output of a complete run, for it has no list of its files ({LIST_FILE}: {error}), so \
             it will not be deleted: remove it yourself, or choose another --out"
        ))
    })?;
    let text = String::from_utf8_lossy(&text);
    let files: BTreeSet<&str> = text.lines().collect();
    let mut directories = BTreeSet::new();
    for file in &files {
        directories.extend(file.match_indices('/').map(|(end, _)| &file[..end]));
    }
    let mut foreign = Vec::new();
    let walked = walk(directory, "", &mut |name, _, metadata| {
        let is_known = if metadata.is_dir() { directories.contains(name) } else { files.contains(name) };
        if !is_known {
            foreign.push(clean(name) + if metadata.is_dir() { "/" } else { "" });
        }
        Ok(is_known)
    });
    walked.map_err(|error| refuse(format!("cannot be examined: {error}")))?;
    if foreign.is_empty() {
        return Ok(());
    }
    let others = foreign.len().saturating_sub(NAMED);
    foreign.truncate(NAMED);
    let others = if others == 0 { String::new() } else { format!(" and {others} more") };
    Err(refuse(format!(
        "it holds what no run wrote, which --overwrite does not delete: {}{others}. Move it away, or choose another --out",
        foreign.join(", ")
    )))
}

/// Tells `visit` of everything in a directory, in the order of names: its name relative to the first directory, its path, and
/// what it is; links are not followed. Where `visit` says so, it goes on below.
fn walk(
    directory: &Path,
    prefix: &str,
    visit: &mut dyn FnMut(&str, &Path, &fs::Metadata) -> io::Result<bool>,
) -> io::Result<()> {
    let mut paths = fs::read_dir(directory)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<PathBuf>>>()?;
    paths.sort();
    for path in paths {
        let metadata = fs::symlink_metadata(&path)?;
        let name = format!("{prefix}{}", path.file_name().unwrap_or_default().to_string_lossy());
        if visit(&name, &path, &metadata)? && metadata.is_dir() {
            walk(&path, &format!("{name}/"), visit)?;
        }
    }
    Ok(())
}

/// Makes the names in a directory and below it durable.
fn sync_directories(directory: &Path) -> io::Result<()> {
    let mut all = vec![directory.to_path_buf()];
    walk(directory, "", &mut |_, path, metadata| {
        all.extend(metadata.is_dir().then(|| path.to_path_buf()));
        Ok(true)
    })?;
    all.iter().rev().try_for_each(|path| safe_file::sync_directory(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_run_wrote_is_named() {
        let here = tempfile::tempdir().unwrap();
        let here = here.path();
        fs::create_dir(here.join("figures")).unwrap();
        fs::write(here.join("figures/a.svg"), "").unwrap();
        fs::write(here.join("summary.json"), "").unwrap();
        assert!(check(here).unwrap_err().reason.contains("no list of its files"));
        list(here).unwrap();
        assert_eq!(fs::read_to_string(here.join(LIST_FILE)).unwrap(), "figures/a.svg\nfiles.txt\nsummary.json\n");
        check(here).unwrap();
        // What is gone is nobody's loss.
        fs::remove_file(here.join("figures/a.svg")).unwrap();
        check(here).unwrap();
        for name in ["figures/b.svg", "NOTES.md", "summary.json.bak"] {
            fs::write(here.join(name), "").unwrap();
            let reason = check(here).unwrap_err().reason;
            assert!(reason.contains(&format!("does not delete: {name}. Move")), "{reason}");
            fs::remove_file(here.join(name)).unwrap();
        }
        fs::create_dir(here.join("analysis")).unwrap();
        assert!(check(here).unwrap_err().reason.contains("analysis/"));
    }
}
