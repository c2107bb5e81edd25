//! From what the user typed to a scenario file.

use crate::scenario::Scenario;
use crate::shipped;
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};
use std::ffi::OsStr;
use std::path::PathBuf;

/// Where scenarios are sought by name, before those inside the program.
const DIRECTORY: &str = "scenarios";

/// Reads the scenario that the user means.
pub fn load(argument: &OsStr) -> Result<Scenario, Report> {
    Ok(Scenario::load(&find(argument)?)?)
}

/// The file that the user means: a path, the name of a file in ./scenarios, or that of a scenario inside the program.
pub fn find(argument: &OsStr) -> Result<PathBuf, Report> {
    let path = PathBuf::from(argument);
    let looks_like_a_path =
        path.extension().is_some_and(|extension| extension == "toml") || path.components().count() != 1;
    if shipped::is_file(&path) || (looks_like_a_path && path.exists()) {
        return Ok(path);
    }
    let known = known()?;
    if let Some(named) = known.iter().find(|path| !looks_like_a_path && path.file_stem() == Some(argument)) {
        return Ok(named.clone());
    }
    let names: Vec<String> = known.iter().filter_map(|path| Some(path.file_stem()?.to_str()?.to_string())).collect();
    let stem = path.file_stem().unwrap_or(argument).to_string_lossy().into_owned();
    let near = nearest(&stem, names.iter().map(String::as_str));
    let mut help = near.map_or(String::new(), |near| format!("did you mean `{}`?\n", clean(near)));
    let names: Vec<String> = names.iter().map(|name| clean(name)).collect();
    help.push_str(&format!("there are: {}", listed(names.iter().map(String::as_str))));
    let argument = clean(&argument.to_string_lossy());
    Err(if looks_like_a_path {
        miette!(help = help, "there is no file {argument}")
    } else {
        miette!(help = help, "there is no scenario `{argument}`")
    })
}

/// All scenarios that have a name: those in ./scenarios, and then those inside the program that have other names, each by
/// name.
pub fn known() -> Result<Vec<PathBuf>, Report> {
    let mut known = in_directory()?.unwrap_or_default();
    let is_new = |path: &PathBuf| known.iter().all(|own| own.file_name() != path.file_name());
    let others: Vec<PathBuf> = shipped::scenarios().filter(is_new).collect();
    known.extend(others);
    Ok(known)
}

/// The scenarios that are meant where nobody names any: those in ./scenarios, or, where there is no such directory, those
/// inside the program.
pub fn all() -> Result<Vec<PathBuf>, Report> {
    Ok(in_directory()?.unwrap_or_else(|| shipped::scenarios().collect()))
}

/// All scenario files in ./scenarios, by name; `None` if there is no such directory.
fn in_directory() -> Result<Option<Vec<PathBuf>>, Report> {
    let entries = match std::fs::read_dir(DIRECTORY) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(miette!("cannot read ./{DIRECTORY}: {error}")),
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> = paths.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    paths.sort();
    Ok(Some(paths))
}
