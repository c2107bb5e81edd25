//! What can be wrong with a file of stations or observations, or with the description of an observing system.

use crate::table::error::{Numbered, TableError};
use std::fmt;

/// A fault in a file of stations or observations, or in the description of an observing system.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}{problem}")]
pub struct ObservationError {
    /// Where it is.
    pub place: Place,
    /// What is wrong, and what would be right.
    pub problem: String,
}

/// Where a fault is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// In a setting of a network.
    Setting {
        /// Name of the network.
        network: String,
        /// The setting: the path of fields, without the numbers of list entries (`biases.initial.sigma`).
        setting: &'static str,
    },
    /// In a file.
    File {
        /// Name of the file, as its reader was given it.
        file: String,
        /// Which line or row, from 1; `None` if it is the file as a whole.
        row: Option<(Numbered, usize)>,
    },
    /// In the observing system as a whole.
    System,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Setting { network, .. } => write!(f, "{network}: "),
            Place::File { file, row: Some((numbered, number)) } => write!(f, "{file}, {numbered} {number}: "),
            Place::File { file, row: None } => write!(f, "{file} "),
            Place::System => Ok(()),
        }
    }
}

impl ObservationError {
    /// A fault in a setting of a network; the `problem` names the setting.
    pub fn in_setting(network: &str, setting: &'static str, problem: impl Into<String>) -> Self {
        Self { place: Place::Setting { network: network.to_owned(), setting }, problem: problem.into() }
    }

    /// A fault in a line or row of a file, or in the file as a whole; the `problem` then goes on after the file's name.
    pub fn in_file(file: &str, row: Option<(Numbered, usize)>, problem: impl Into<String>) -> Self {
        Self { place: Place::File { file: file.to_owned(), row }, problem: problem.into() }
    }

    /// The same fault of a file as one of the network that reads it.
    pub(crate) fn of_network(self, network: &str, setting: &'static str) -> Self {
        Self::in_setting(network, setting, self.to_string())
    }

    /// A fault in the observing system as a whole.
    pub(crate) fn in_system(problem: impl Into<String>) -> Self {
        Self { place: Place::System, problem: problem.into() }
    }

    /// A setting that names something that does not exist; `valid` are the names that do.
    pub(crate) fn unknown_name<S: AsRef<str>>(
        network: &str,
        setting: &'static str,
        value: &str,
        valid: impl IntoIterator<Item = S>,
    ) -> Self {
        let problem = format!("{setting} names `{value}`, which is not known; valid: {}", list(valid));
        Self::in_setting(network, setting, problem)
    }

    /// A setting that names the same thing twice.
    pub(crate) fn duplicate_name(network: &str, setting: &'static str, value: &str) -> Self {
        Self::in_setting(network, setting, format!("{setting} has `{value}` twice; each may occur once"))
    }

    /// The network concerned; `None` for a fault elsewhere.
    pub fn network(&self) -> Option<&str> {
        match &self.place {
            Place::Setting { network, .. } => Some(network),
            _ => None,
        }
    }

    /// The network's setting concerned; `None` for a fault elsewhere.
    pub fn setting(&self) -> Option<&'static str> {
        match self.place {
            Place::Setting { setting, .. } => Some(setting),
            _ => None,
        }
    }
}

impl From<TableError> for ObservationError {
    fn from(error: TableError) -> Self {
        match &error.faults[..] {
            [fault] => {
                let row = fault.line.map(|line| (error.numbered, line));
                Self::in_file(&error.file, row, fault.problem.clone())
            }
            _ => Self::in_file(&error.file, None, format!("has {}", error.listing())),
        }
    }
}

/// Names as a message lists them: `a`, `b`, `c`.
pub(crate) fn list<S: AsRef<str>>(names: impl IntoIterator<Item = S>) -> String {
    let quoted: Vec<String> = names.into_iter().map(|name| format!("`{}`", name.as_ref())).collect();
    if quoted.is_empty() { "none".to_owned() } else { quoted.join(", ") }
}

/// `Ok` if `value` is finite and `right`, else the error that says what it must be.
pub(crate) fn require(
    right: bool,
    network: &str,
    setting: &'static str,
    value: f64,
    expected: impl fmt::Display,
) -> Result<(), ObservationError> {
    if right && value.is_finite() {
        return Ok(());
    }
    Err(ObservationError::in_setting(network, setting, format!("{setting} is {value}, but must be {expected}")))
}
