//! What is known of each sensor, kept between runs: station metadata, test points, calibrations with their covariance,
//! announced recalibrations.
//!
//! | module | what it does |
//! |---|---|
//! | [`record`] | the records, and which of them contradict each other |
//! | [`database`] | the SQLite file that holds them |
//! | [`table`] | the same as CSV |
//! | [`knowledge`] | what they mean for a run that starts at some time |
//! | [`write_back`] | what a run has found out |

pub mod database;
pub mod knowledge;
pub mod record;
pub mod table;
pub mod write_back;

pub use database::Database;
pub use record::{Record, Records};

use crate::text::{clean, clean_lines, shown_path};
use isobar_obs::table::TableError;
use std::path::{Path, PathBuf};

/// Why sensors cannot be read or written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, miette::Diagnostic)]
#[error("{}{}: {reason}", shown_path(path), line.map_or(String::new(), |line| format!(", line {line}")))]
pub struct SensorError {
    /// The database or the table.
    pub path: PathBuf,
    /// The line of a table, from 1.
    pub line: Option<u64>,
    /// What is wrong, and what would be right.
    pub reason: String,
}

impl SensorError {
    /// A fault of a file.
    pub fn new(path: &Path, reason: impl ToString) -> Self {
        Self { path: path.to_path_buf(), line: None, reason: reason.to_string() }
    }

    /// A fault in a line of a table.
    pub fn at(path: &Path, line: u64, reason: impl ToString) -> Self {
        Self { path: path.to_path_buf(), line: Some(line), reason: reason.to_string() }
    }

    /// The faults of a table.
    fn of_table(path: &Path, error: &TableError) -> Self {
        let (line, reason) = match &error.faults[..] {
            [fault] => (fault.line.map(|line| line as u64), clean(&fault.problem)),
            _ => (None, clean_lines(&error.listing())),
        };
        Self { path: path.to_path_buf(), line, reason }
    }
}
