//! A CSV file that is not there unless it has rows.

use super::{OutputDirectory, SinkError};
use std::fmt::Display;
use std::fs::File;
use std::path::PathBuf;

/// A CSV file that is created with its first row.
#[derive(Debug)]
pub struct LateCsv {
    path: PathBuf,
    header: &'static [&'static str],
    writer: Option<csv::Writer<File>>,
}

impl LateCsv {
    /// A file of this name in `directory`.
    pub fn new(directory: &OutputDirectory, name: &str, header: &'static [&'static str]) -> Self {
        Self { path: directory.path().join(name), header, writer: None }
    }

    /// Writes a row.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write<const N: usize>(&mut self, row: [String; N]) -> Result<(), SinkError> {
        let fault = |error: &dyn Display| SinkError { path: self.path.clone(), reason: error.to_string() };
        let writer = match &mut self.writer {
            Some(writer) => writer,
            writer => {
                let created = csv::Writer::from_path(&self.path).map_err(|error| fault(&error))?;
                let writer = writer.insert(created);
                writer.write_record(self.header).map_err(|error| fault(&error))?;
                writer
            }
        };
        writer.write_record(row).map_err(|error| fault(&error))
    }

    /// Brings all rows to the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn flush(&mut self) -> Result<(), SinkError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        writer.flush().map_err(|error| SinkError { path: self.path.clone(), reason: error.to_string() })
    }
}
