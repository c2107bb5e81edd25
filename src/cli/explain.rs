//! `isobar explain` and `isobar schema`.

use super::console::{print, width};
use crate::reference::{Explanation, KeyReference, explain as find, schema as make_schema, sections};
use crate::tables::terminal::sentences;
use crate::tables::{Cell, Table};
use crate::text::capitalised;
use miette::{IntoDiagnostic, Report, miette};
use std::process::ExitCode;

/// Prints what a key of a scenario means, or all that stand at the top of a scenario.
pub fn explain(key: Option<&str>) -> Result<ExitCode, Report> {
    let text = match key {
        None => {
            let row = |key: KeyReference| [key.name, key.default, key.meaning].map(Cell::from).into();
            Table::new(&["key", "default", "meaning"], sections().into_iter().map(row).collect()).terminal(width())
        }
        Some(key) => text(&find(key).map_err(|unknown| miette!(help = unknown.help.clone(), "{}", unknown.message))?),
    };
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn text(found: &Explanation) -> String {
    let mut parts = vec![found.name.clone()];
    if !found.about.is_empty() {
        parts.push(sentences(&format!("{}.", found.about), width()));
    }
    for (key, kinds) in &found.keys {
        let mut lines = vec![format!("{}.", capitalised(&key.meaning)), format!("value: {}", key.allowed)];
        if !key.unit.is_empty() {
            lines.push(format!("unit: {}", key.unit));
        }
        lines.push(format!("default: {}", key.default));
        if !kinds.is_empty() {
            lines.push(format!("of kind: {}", kinds.join(", ")));
        }
        parts.push(sentences(&lines.join("\n"), width()));
    }
    if !found.kinds.is_empty() {
        let row = |(name, about): &(&str, &str)| [*name, *about].map(Cell::from).into();
        parts.push(Table::new(&["kind", "what it is"], found.kinds.iter().map(row).collect()).terminal(width()));
    }
    if !found.inner.is_empty() {
        let lines: Vec<String> = found.inner.iter().map(entry).collect();
        parts.push(sentences(&lines.join("\n"), width()));
    }
    parts.join("\n\n")
}

/// A key in a sentence: tables of five columns are narrow on a terminal.
fn entry(KeyReference { name, unit, allowed, default, meaning }: &KeyReference) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
    // An entry of a table without keys of its own has only its values.
    let meaning = if meaning.is_empty() { String::new() } else { format!("{meaning}. ") };
    let default = match default.as_str() {
        "" => String::new(),
        default if default.contains("must be given") => format!("; {default}"),
        default => format!("; default: {default}"),
    };
    format!("{name}{unit}: {meaning}{}{default}.", capitalised(allowed))
}

/// A row for each key.
pub fn table(keys: &[KeyReference]) -> Table {
    let row = |KeyReference { name, unit, allowed, default, meaning }: &KeyReference| {
        [name.as_str(), *unit, allowed, default, meaning].map(Cell::from).into()
    };
    Table::new(&["key", "unit", "value", "default", "meaning"], keys.iter().map(row).collect())
}

/// Prints the JSON schema of scenario files.
pub fn schema() -> Result<ExitCode, Report> {
    print(&serde_json::to_string_pretty(&make_schema()).into_diagnostic()?)?;
    Ok(ExitCode::SUCCESS)
}
