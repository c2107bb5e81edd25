//! What is wrong with a table: all of its faults at once.

use std::fmt;

/// How many faults of a table are listed.
const MOST_LISTED: usize = 20;

/// What the numbers of faults count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numbered {
    /// Lines of a text.
    #[default]
    Lines,
    /// Rows of a table that is no text.
    Rows,
}

impl fmt::Display for Numbered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lines => "line",
            Self::Rows => "row",
        })
    }
}

/// Why a table cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableError {
    /// The table's name.
    pub file: String,
    /// What the faults' numbers count.
    pub numbered: Numbered,
    /// The first faults, in the order of their lines; at least one, at most 20.
    pub faults: Vec<TableFault>,
    /// The number of all faults.
    pub total: usize,
}

/// One fault of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableFault {
    /// Number of the line, or of the row, from 1; `None`: the table as a whole.
    pub line: Option<usize>,
    /// What is wrong, and what would be right.
    pub problem: String,
}

impl TableError {
    /// The fault of one line.
    pub fn at(file: &str, line: usize, problem: impl Into<String>) -> Self {
        let fault = TableFault { line: Some(line), problem: problem.into() };
        Self { file: file.to_owned(), numbered: Numbered::Lines, faults: vec![fault], total: 1 }
    }

    /// A fault of the table as a whole; `problem` continues a sentence that begins with the table's name.
    pub fn whole(file: &str, problem: impl Into<String>) -> Self {
        let fault = TableFault { line: None, problem: problem.into() };
        Self { file: file.to_owned(), numbered: Numbered::Lines, faults: vec![fault], total: 1 }
    }

    /// The number of faults, and each of the first ones in a line of its own.
    pub fn listing(&self) -> String {
        let Self { faults, total, numbered, .. } = self;
        let mut listing = format!("{total} faults:");
        for TableFault { line, problem } in faults {
            listing += &line.map_or("\n".to_owned(), |line| format!("\n{numbered} {line}: "));
            listing += problem;
        }
        match total - faults.len() {
            0 => listing,
            more => format!("{listing}\nand {more} more"),
        }
    }
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, faults, numbered, .. } = self;
        match &faults[..] {
            [TableFault { line: Some(line), problem }] => write!(f, "{file}, {numbered} {line}: {problem}"),
            [TableFault { line: None, problem }] => write!(f, "{file} {problem}"),
            _ => write!(f, "{file} has {}", self.listing()),
        }
    }
}

impl std::error::Error for TableError {}

/// The faults that are found while a table is read.
#[derive(Debug, Default)]
pub struct Faults {
    numbered: Numbered,
    first: Vec<TableFault>,
    total: usize,
}

impl Faults {
    /// None yet, of lines or of rows.
    pub fn of(numbered: Numbered) -> Self {
        Self { numbered, ..Self::default() }
    }

    /// Adds the fault of a line, or of a row.
    pub fn add(&mut self, line: usize, problem: impl Into<String>) {
        if self.first.len() < MOST_LISTED {
            self.first.push(TableFault { line: Some(line), problem: problem.into() });
        }
        self.total += 1;
    }

    /// Whether there are none so far.
    pub fn is_empty(&self) -> bool {
        self.total == 0
    }

    /// `Ok` if there are no faults.
    ///
    /// # Errors
    /// The faults, as those of the table of this name.
    pub fn check(self, file: &str) -> Result<(), TableError> {
        match self.total {
            0 => Ok(()),
            total => Err(TableError { file: file.to_owned(), numbered: self.numbered, faults: self.first, total }),
        }
    }
}
