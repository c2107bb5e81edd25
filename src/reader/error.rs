//! A fault in a scenario, with the place in the file at which it is.

use crate::place::beside;
use crate::text::{clean, same_length, shown_path};
use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Why a scenario cannot be used: what is wrong, where, and what is allowed there.
#[derive(Clone, Debug)]
pub struct ScenarioError {
    details: Box<Details>,
}

#[derive(Clone, Debug)]
struct Details {
    message: String,
    help: Option<String>,
    place: Option<(NamedSource<String>, LabeledSpan)>,
    /// Line and column, from 1, if it is at a place.
    line_and_column: Option<(usize, usize)>,
    /// Whether a key is missing: there can be many such faults at one place.
    is_absence: bool,
    /// The file's other faults, in the order of their places.
    others: Vec<ScenarioError>,
}

impl ScenarioError {
    /// A fault of the file as a whole.
    pub(crate) fn of_file(path: &Path, reason: impl fmt::Display) -> Self {
        let message = format!("cannot read {}: {reason}", shown_path(path));
        Self::at(message, None, None, None)
    }

    fn at(
        message: String,
        help: Option<String>,
        place: Option<(NamedSource<String>, LabeledSpan)>,
        line_and_column: Option<(usize, usize)>,
    ) -> Self {
        let details = Details { message, help, place, line_and_column, is_absence: false, others: Vec::new() };
        Self { details: Box::new(details) }
    }

    /// The same, as a key that is missing.
    pub(super) fn of_absence(mut self) -> Self {
        self.details.is_absence = true;
        self
    }

    /// Whether two faults are the same one, found twice at the same place.
    fn is_same(&self, other: &Self) -> bool {
        let absent = self.details.is_absence || other.details.is_absence;
        let at_one_place = self.line_and_column().is_some() && self.line_and_column() == other.line_and_column();
        at_one_place && (!absent || self.message() == other.message())
    }

    /// All of several faults, in the order of their places. Of one that was found twice only the first is kept, whose message
    /// says more. `None` if there is no fault.
    pub(super) fn of_all(faults: impl IntoIterator<Item = ScenarioError>) -> Option<Self> {
        let mut all: Vec<ScenarioError> = Vec::new();
        for mut fault in faults {
            let others = std::mem::take(&mut fault.details.others);
            for fault in std::iter::once(fault).chain(others) {
                if !all.iter().any(|other| other.is_same(&fault)) {
                    all.push(fault);
                }
            }
        }
        // Stable: those without a place come first.
        all.sort_by_key(ScenarioError::line_and_column);
        let more = all.len().saturating_sub(MOST_SHOWN);
        all.truncate(MOST_SHOWN);
        if let Some(last) = all.last_mut().filter(|_| more > 0) {
            let help = last.details.help.get_or_insert_default();
            *help = format!("{help}\nand there are {more} more faults").trim_start().to_string();
        }
        let mut all = all.into_iter();
        let mut first = all.next()?;
        first.details.others = all.collect();
        Some(first)
    }

    /// What is wrong, in one sentence.
    pub fn message(&self) -> &str {
        &self.details.message
    }

    /// Line and column in the file, from 1, if the fault is at a place.
    pub fn line_and_column(&self) -> Option<(usize, usize)> {
        self.details.line_and_column
    }

    /// What would be right, where the label of the place does not say it all.
    pub fn own_help(&self) -> Option<&str> {
        self.details.help.as_deref()
    }

    /// The file's other faults, in the order of their places.
    pub fn others(&self) -> &[ScenarioError] {
        &self.details.others
    }
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.details.message)
    }
}

impl std::error::Error for ScenarioError {}

impl Diagnostic for ScenarioError {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.details.help.as_ref().map(|help| Box::new(help) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.details.place.as_ref().map(|(source, _)| source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let (_, label) = self.details.place.as_ref()?;
        Some(Box::new(std::iter::once(label.clone())))
    }

    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        let others = self.others();
        let all = || Box::new(others.iter().map(|other| other as &dyn Diagnostic)) as Box<dyn Iterator<Item = _>>;
        (!others.is_empty()).then(all)
    }
}

/// The most faults that are shown of a file.
const MOST_SHOWN: usize = 20;

/// The longest part of a line that is shown \[bytes\].
const WIDEST: usize = 200;

/// A scenario file, as error messages quote it.
pub(crate) struct SourceFile {
    /// Where it is.
    pub path: PathBuf,
    /// Its text, byte for byte in the places of the original, without anything that a terminal would obey.
    printable: String,
    /// Where it names files.
    names: RefCell<BTreeMap<usize, FileName>>,
    /// Checksums of what the tables say that it names and that have been read, by these names.
    tables: RefCell<BTreeMap<String, u32>>,
    /// The bytes that have been read of them.
    bytes: Cell<u64>,
}

/// The name of a file in a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FileName {
    /// Its place in the text, with the quotation marks.
    pub span: Range<usize>,
    /// The name.
    pub name: String,
}

impl SourceFile {
    pub fn new(path: &Path, text: &str) -> Self {
        Self {
            path: path.to_path_buf(),
            printable: same_length(text),
            names: RefCell::default(),
            tables: RefCell::default(),
            bytes: Cell::default(),
        }
    }

    /// The path of a file that this one names: relative to its own directory, or inside the program.
    pub(super) fn beside(&self, name: &str) -> PathBuf {
        beside(&self.path, name)
    }

    /// Takes note of where it names a file.
    pub(super) fn names(&self, span: Range<usize>, name: &str) {
        self.names.borrow_mut().insert(span.start, FileName { span, name: name.to_string() });
    }

    /// Counts bytes that have been read of such files; how many there are now.
    pub fn count(&self, bytes: u64) -> u64 {
        self.bytes.set(self.bytes.get() + bytes);
        self.bytes.get()
    }

    /// Takes note of what a table says that it names.
    pub(super) fn has_read(&self, name: &str, checksum: u32) {
        self.tables.borrow_mut().insert(name.to_string(), checksum);
    }

    /// The names of files in it, in the order of their places; and checksums of what the tables among these say.
    pub fn into_names(self) -> (Vec<FileName>, BTreeMap<String, u32>) {
        (self.names.into_inner().into_values().collect(), self.tables.into_inner())
    }

    /// A fault at `span`. The caret is labelled `label`; only the first line of a longer span is marked.
    pub fn error(&self, span: Range<usize>, message: String, label: &str, help: Option<String>) -> ScenarioError {
        let start = self.printable.floor_char_boundary(span.start.min(self.printable.len()));
        let end = self.printable.floor_char_boundary(span.end.clamp(start, self.printable.len()));
        let end = self.printable[start..end].find('\n').map_or(end, |newline| start + newline);
        let end = self.printable.floor_char_boundary(end.min(start + WIDEST));
        let name = shown_path(&self.path);
        let column = start - self.printable[..start].rfind('\n').map_or(0, |newline| newline + 1);
        let line = self.printable[..start].matches('\n').count() + 1;
        if column > WIDEST {
            let message = format!("{message} ({label}), at {name}:{line}:{}", column + 1);
            return ScenarioError::at(message, help, None, Some((line, column + 1)));
        }
        let (text, start) = self.excerpt(start, end);
        let length = (end - start.min(end)).min(text.len() - start);
        let label = LabeledSpan::new(Some(clean(label)), start, length);
        let place = Some((NamedSource::new(name, text), label));
        ScenarioError::at(message, help, place, Some((line, column + 1)))
    }

    /// The text, each line cut after [`WIDEST`] bytes (or shortly after the fault), so that no line floods the terminal;
    /// and where the fault begins in it.
    fn excerpt(&self, start: usize, end: usize) -> (String, usize) {
        let (mut text, mut place, mut offset) = (String::new(), start, 0);
        for line in self.printable.split_inclusive('\n') {
            let range = offset..offset + line.len();
            offset = range.end;
            let fault = (range.contains(&start)).then(|| end - range.start + 40);
            let keep = line.floor_char_boundary(fault.unwrap_or(0).max(WIDEST).min(line.len()));
            let newline = line.ends_with('\n') && keep < line.len();
            if range.end <= start {
                place -= line.len() - keep - usize::from(newline);
            }
            text.push_str(&line[..keep]);
            if newline {
                text.push('\n');
            }
        }
        (text, place)
    }
}
