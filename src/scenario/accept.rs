//! Rewriting `[expected]` in a scenario file, with every other byte as it was.

use super::Scenario;
use crate::safe_file;
use crate::scores::Expected;
use crate::text::shown_path;
use std::path::PathBuf;

/// Why the scores could not be accepted.
#[derive(Debug, thiserror::Error)]
pub enum AcceptError {
    /// The file cannot be written.
    #[error("cannot write {}: {source}", shown_path(path))]
    Write {
        /// The scenario file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file changed while the scenario ran.
    #[error("{} has changed since it was read; nothing was written", shown_path(path))]
    Changed {
        /// The scenario file.
        path: PathBuf,
    },
    /// The file holds its scores in a form that cannot be replaced, such as `expected = { … }`.
    #[error("cannot find the [expected] section of {}; remove it, and accept again", shown_path(path))]
    Form {
        /// The scenario file.
        path: PathBuf,
    },
}

/// The scenario's text with these scores: the tables of `[expected]` are taken out, and stand anew at the end.
///
/// # Errors
/// [`AcceptError::Form`] if the result would not be the same scenario with the new scores.
pub fn with_expected(scenario: &Scenario, expected: &Expected) -> Result<String, AcceptError> {
    let mut text = String::with_capacity(scenario.text.len() + 1000);
    let mut inside = false;
    for line in scenario.text.split_inclusive('\n') {
        if let Some(header) = line.trim_start().strip_prefix('[') {
            let table = header.trim_start().strip_prefix("expected").map(str::trim_start);
            inside = table.is_some_and(|rest| rest.starts_with(['.', ']']));
        }
        if !inside {
            text.push_str(line);
        }
    }
    let line_end = if text.contains("\r\n") { "\r\n" } else { "\n" };
    if !text.is_empty() && !text.ends_with('\n') {
        text.push_str(line_end);
    }
    if !text.ends_with("\n\n") && !text.ends_with("\n\r\n") {
        text.push_str(line_end);
    }
    text.push_str(&expected.to_toml().replace('\n', line_end));
    let same_methods =
        Scenario::parse(&scenario.path, &text).is_ok_and(|new| new.expected.methods.keys().eq(expected.methods.keys()));
    let same = same_methods && without_expected(&text) == without_expected(&scenario.text);
    if same { Ok(text) } else { Err(AcceptError::Form { path: scenario.path.clone() }) }
}

/// All of a scenario's text but `[expected]`; `None` if it is not TOML.
fn without_expected(text: &str) -> Option<toml::Table> {
    let mut table: toml::Table = text.parse().ok()?;
    table.remove("expected");
    Some(table)
}

/// Writes these scores into the scenario's file, which is replaced as a whole or not at all.
///
/// # Errors
/// [`AcceptError`]; the file is then as it was.
pub fn accept(scenario: &Scenario, expected: &Expected) -> Result<(), AcceptError> {
    let text = with_expected(scenario, expected)?;
    let fail = |source| AcceptError::Write { path: scenario.path.clone(), source };
    let path = scenario.path.canonicalize().map_err(fail)?;
    if std::fs::read_to_string(&path).map_err(fail)? != scenario.text {
        return Err(AcceptError::Changed { path: scenario.path.clone() });
    }
    safe_file::replace(&path, text.as_bytes()).map_err(fail)
}
