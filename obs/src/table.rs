//! Tables in CSV, of stations or of observations: a header line, and each line with its number for messages.

use crate::error::{ObservationError, list};

/// A table whose header has been read.
pub(crate) struct Table<'a> {
    text: &'a str,
    file: &'a str,
    header_line: usize,
    /// Names of the columns, no two of which are the same.
    pub columns: Vec<String>,
}

impl<'a> Table<'a> {
    /// Reads the header; `None` if there is no line at all. `file` is the table's name, for messages.
    ///
    /// # Errors
    /// A header that is not a line of CSV, a column that occurs twice.
    pub fn new(text: &'a str, file: &'a str) -> Result<Option<Self>, ObservationError> {
        let Some((header_line, header)) = rows(text).next() else { return Ok(None) };
        let table = Self { text, file, header_line, columns: split(header, file, header_line)? };
        for (index, column) in table.columns.iter().enumerate() {
            if table.columns[..index].contains(column) {
                let problem = format!("the header has two columns `{column}`; names of columns must differ");
                return Err(table.wrong_header(problem));
            }
        }
        Ok(Some(table))
    }

    /// The lines below the header, each with its number from 1 and as many fields as there are columns.
    ///
    /// # Errors
    /// A line that is not a row of the table.
    pub fn lines(&self) -> impl Iterator<Item = Result<(usize, Vec<String>), ObservationError>> {
        rows(self.text).skip(1).map(|(line, row)| {
            let (fields, width) = (split(row, self.file, line)?, self.columns.len());
            if fields.len() != width {
                let problem = format!("there are {} fields, but the header has {width} columns", fields.len());
                return Err(ObservationError::in_file(self.file, Some(line), problem));
            }
            Ok((line, fields))
        })
    }

    /// The number of the column of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// That a column is missing, which `missing` says in words.
    pub fn missing(&self, missing: &str) -> ObservationError {
        self.wrong_header(format!("the header has no column {missing}; it has {}", list(&self.columns)))
    }

    /// That the header is not what it must be.
    pub fn wrong_header(&self, problem: impl Into<String>) -> ObservationError {
        ObservationError::in_file(self.file, Some(self.header_line), problem)
    }
}

/// The lines with their numbers from 1, without empty ones and remarks.
fn rows(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    lines.filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'))
}

/// The fields of one line of CSV, without the blanks around them.
fn split(line: &str, file: &str, number: usize) -> Result<Vec<String>, ObservationError> {
    let malformed = |problem: String| ObservationError::in_file(file, Some(number), problem);
    if line.matches('"').count() % 2 == 1 {
        return Err(malformed("a quotation mark is not closed on its line".to_owned()));
    }
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).trim(csv::Trim::All).from_reader(line.trim().as_bytes());
    let mut record = csv::StringRecord::new();
    reader.read_record(&mut record).map_err(|error| malformed(format!("this is not a line of CSV: {error}")))?;
    Ok(record.iter().map(str::to_owned).collect())
}
