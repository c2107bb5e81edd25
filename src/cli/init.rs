//! `isobar init`.

use super::arguments::InitArguments;
use super::console::print;
use super::lookup;
use crate::place::parent_of;
use crate::safe_file;
use crate::scenario::Scenario;
use crate::shell::command;
use crate::shipped;
use crate::text::{clean, listed, shown_path};
use miette::{Report, miette};
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;

/// A small scenario with a comment on every section.
const TEMPLATE: &str = include_str!("template.toml");

/// The largest file that is copied \[bytes\].
const LARGEST_FILE: u64 = 1_000_000_000;

/// Writes the template, or another scenario with the files that it names; nothing that is there is replaced.
pub fn init(arguments: &InitArguments) -> Result<ExitCode, Report> {
    let path = &arguments.path;
    let shown = shown_path(path);
    if path.file_name().is_none() {
        return Err(miette!(help = "such as mine.toml", "{shown} is not the name of a file"));
    }
    let mut files = BTreeMap::new();
    let text = match &arguments.from {
        None => TEMPLATE.to_string(),
        Some(from) => {
            let scenario = lookup::load(from)?;
            files = beside(&scenario, parent_of(path))?;
            scenario.text
        }
    };
    if !parent_of(path).is_dir() {
        let (directory, make) = (parent_of(path), command("mkdir -p", &[parent_of(path)]));
        let help = format!("make it first: `{make}`");
        return Err(miette!(help = help, "cannot write {shown}: there is no directory {}", shown_path(directory)));
    }
    let names: Vec<String> = files.keys().map(|path| shown_path(path)).collect();
    files.insert(path.clone(), text.into_bytes());
    write_all(&files)?;
    let [check, run] = ["isobar check", "isobar run"].map(|words| command(words, &[path]));
    let beside =
        if names.is_empty() { String::new() } else { format!(" and {}", listed(names.iter().map(String::as_str))) };
    print(&format!("wrote {shown}{beside}; now: {check} && {run}"))?;
    Ok(ExitCode::SUCCESS)
}

/// The files that a scenario names, with what they hold, by where they are to be for a scenario in `directory`. Those that
/// are there already, and the same, are left out.
///
/// # Errors
/// A file that is neither beside the scenario nor below, or cannot be read.
fn beside(scenario: &Scenario, directory: &Path) -> Result<BTreeMap<PathBuf, Vec<u8>>, Report> {
    let mut files = BTreeMap::new();
    for (name, source) in scenario.files() {
        let is_below =
            |name: &Path| name.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        // These lead there from anywhere.
        if shipped::contains(Path::new(name)) || Path::new(name).is_absolute() {
            continue;
        }
        let (shown, of) = (clean(name), shown_path(&scenario.path));
        if !is_below(Path::new(name)) {
            let help = "copy the scenario by hand, and change that name";
            return Err(miette!(help = help, "{of} names {shown}, which is not below its directory"));
        }
        // A database of sensors may be yet to be made.
        if !shipped::is_file(&source) {
            continue;
        }
        let bytes =
            safe_file::read_named(&source, LARGEST_FILE).map_err(|error| miette!("cannot read {shown}: {error}"))?;
        let target = directory.join(name);
        if safe_file::read_named(&target, LARGEST_FILE).ok().as_ref() != Some(&bytes) {
            files.insert(target, bytes);
        }
    }
    Ok(files)
}

/// Writes files that are not there yet: all of them, or, if one cannot be written, nothing.
fn write_all(files: &BTreeMap<PathBuf, Vec<u8>>) -> Result<(), Report> {
    let exists = |path: &&PathBuf| fs::symlink_metadata(path).is_ok();
    let there: Vec<String> = files.keys().filter(exists).map(|path| shown_path(path)).collect();
    let help = "give another path, or remove what is there first";
    if !there.is_empty() {
        let verb = if there.len() == 1 { "exists" } else { "exist" };
        return Err(miette!(help = help, "{} {verb}; nothing was written", listed(there.iter().map(String::as_str))));
    }
    let mut made = Made::default();
    for (path, bytes) in files {
        made.write(path, bytes).map_err(|error| {
            let shown = shown_path(path);
            match error.kind() {
                ErrorKind::AlreadyExists => miette!(help = help, "{shown} exists; nothing was written"),
                _ => miette!("cannot write {shown}: {error}"),
            }
        })?;
    }
    made.keep();
    Ok(())
}

/// Files and directories that were made, and are removed again unless they are kept.
#[derive(Default)]
struct Made {
    files: Vec<PathBuf>,
    directories: Vec<PathBuf>,
}

impl Made {
    fn write(&mut self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
        let missing: Vec<&Path> =
            parent_of(path).ancestors().take_while(|it| !it.as_os_str().is_empty() && !it.exists()).collect();
        for directory in missing.into_iter().rev() {
            fs::create_dir(directory)?;
            self.directories.push(directory.to_path_buf());
        }
        safe_file::write_new(path, bytes)?;
        self.files.push(path.to_path_buf());
        Ok(())
    }

    fn keep(mut self) {
        self.files.clear();
        self.directories.clear();
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        // What cannot be removed, such as a directory into which somebody else has written, stays.
        self.files.iter().for_each(|path| drop(fs::remove_file(path)));
        self.directories.iter().rev().for_each(|path| drop(fs::remove_dir(path)));
    }
}
