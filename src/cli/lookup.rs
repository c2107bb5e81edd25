//! From what the user typed to a scenario file.

use crate::scenario::Scenario;
use crate::text::{clean, listed, nearest};
use miette::{Report, miette};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Where scenarios are sought by name.
const DIRECTORY: &str = "scenarios";

/// Reads the scenario that the user means.
pub fn load(argument: &OsStr) -> Result<Scenario, Report> {
    Ok(Scenario::load(&find(argument)?)?)
}

/// The file that the user means: a path, or the name of a file in ./scenarios.
pub fn find(argument: &OsStr) -> Result<PathBuf, Report> {
    let path = PathBuf::from(argument);
    let looks_like_a_path =
        path.extension().is_some_and(|extension| extension == "toml") || path.components().count() != 1;
    if path.is_file() || (looks_like_a_path && path.exists()) {
        return Ok(path);
    }
    let mut file = argument.to_os_string();
    file.push(".toml");
    let named = Path::new(DIRECTORY).join(file);
    if !looks_like_a_path && named.is_file() {
        return Ok(named);
    }
    let known: Vec<String> = all()?.iter().filter_map(|path| Some(path.file_stem()?.to_str()?.to_string())).collect();
    let stem = path.file_stem().unwrap_or(argument).to_string_lossy().into_owned();
    let near = nearest(&stem, known.iter().map(String::as_str));
    let mut help = near.map_or(String::new(), |near| format!("did you mean `{}`?\n", clean(near)));
    match known.as_slice() {
        [] => help.push_str("there are no scenarios in ./scenarios; `isobar init` writes one to start from"),
        known => {
            let known: Vec<String> = known.iter().map(|name| clean(name)).collect();
            help.push_str(&format!("scenarios in ./scenarios: {}", listed(known.iter().map(String::as_str))));
        }
    }
    let argument = clean(&argument.to_string_lossy());
    Err(if looks_like_a_path {
        miette!(help = help, "there is no file {argument}")
    } else {
        miette!(help = help, "there is no scenario `{argument}`")
    })
}

/// All scenario files in ./scenarios, by name; an empty list if there is no such directory.
pub fn all() -> Result<Vec<PathBuf>, Report> {
    let entries = match std::fs::read_dir(DIRECTORY) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(miette!("cannot read ./{DIRECTORY}: {error}")),
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> = paths.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    paths.sort();
    Ok(paths)
}
