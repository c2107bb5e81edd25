//! A netCDF-3 file (64-bit offset) that grows record by record.
//!
//! The netCDF library writes the header and the fixed variables. Records follow each other behind them, each with the
//! numbers of every record variable, that is checked; after a record the number of records in the header is renewed. So the
//! file is well-formed after each of them, nothing needs to be known in advance, no record costs more than its numbers
//! however long the header's texts are, and no value is ever filled in by the library (which would destroy records).

use crate::output::SinkError;
use netcdf3::{DataSet, FileWriter, InvalidDataSet, Version, error::WriteError};
use std::cell::RefCell;
use std::fmt::Debug;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// The number that stands for a missing value: netCDF's default fill value.
pub const FILL_VALUE: f64 = 9.96921e36;

/// An attribute's value.
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    /// UTF-8 text.
    Text(String),
    /// A finite number.
    Number(f64),
    /// Integers.
    Integers(Vec<i32>),
}

impl From<&str> for Attribute {
    fn from(text: &str) -> Self {
        Attribute::Text(text.into())
    }
}

impl From<String> for Attribute {
    fn from(text: String) -> Self {
        Attribute::Text(text)
    }
}

impl From<Vec<i32>> for Attribute {
    fn from(integers: Vec<i32>) -> Self {
        Attribute::Integers(integers)
    }
}

impl From<f64> for Attribute {
    fn from(number: f64) -> Self {
        Attribute::Number(number)
    }
}

/// The values of a variable, or of one of its records.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Numbers.
    Numbers(Vec<f64>),
    /// Integers.
    Integers(Vec<i32>),
    /// Bytes of UTF-8 text.
    Text(Vec<u8>),
}

/// A variable: its name, dimensions and attributes.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    name: String,
    dimensions: Vec<String>,
    attributes: Vec<(String, Attribute)>,
}

impl Variable {
    /// A variable without attributes; for a record variable the record dimension is not among `dimensions`.
    pub fn new(name: impl Into<String>, dimensions: &[&str]) -> Self {
        let dimensions = dimensions.iter().map(|&dimension| dimension.into()).collect();
        Self { name: name.into(), dimensions, attributes: Vec::new() }
    }

    /// With one attribute more; an empty text is left out.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Attribute>) -> Self {
        let value = value.into();
        if value != Attribute::Text(String::new()) {
            self.attributes.push((name.into(), value));
        }
        self
    }

    /// With words added to an attribute of text, which is new if it is not there.
    #[must_use]
    pub fn with_more(mut self, name: &str, words: &str) -> Self {
        for (own, value) in &mut self.attributes {
            if let Attribute::Text(text) = value
                && own == name
            {
                *text += &format!(" {words}");
                return self;
            }
        }
        self.with(name, words)
    }

    /// With an attribute, if there is a value for it.
    #[must_use]
    pub fn with_some(self, name: &str, value: Option<impl Into<Attribute>>) -> Self {
        match value {
            Some(value) => self.with(name, value),
            None => self,
        }
    }
}

/// What a file holds: dimensions, attributes, variables, and the values of those that are the same in all records.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Definition {
    record_dimension: Option<String>,
    dimensions: Vec<(String, usize)>,
    attributes: Vec<(String, Attribute)>,
    fixed: Vec<(Variable, Values)>,
    record: Vec<Variable>,
}

impl Definition {
    /// A definition of nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Names the unlimited dimension.
    pub fn record_dimension(&mut self, name: &str) {
        self.record_dimension = Some(name.into());
    }

    /// Adds a dimension of fixed length, unless it is there.
    pub fn dimension(&mut self, name: &str, length: usize) {
        if self.dimensions.iter().all(|(other, _)| other != name) {
            self.dimensions.push((name.into(), length));
        }
    }

    /// Adds a global attribute; an empty text is left out.
    pub fn attribute(&mut self, name: &str, value: impl Into<Attribute>) {
        let value = value.into();
        if value != Attribute::Text(String::new()) {
            self.attributes.push((name.into(), value));
        }
    }

    /// Adds a variable that does not change from record to record.
    pub fn fixed(&mut self, variable: Variable, values: Values) {
        self.fixed.push((variable, values));
    }

    /// Adds a fixed variable of texts along `dimension`, each padded with zero bytes to the length of the longest.
    pub fn texts<'a>(&mut self, variable: Variable, dimension: &str, texts: impl Iterator<Item = &'a str> + Clone) {
        let length = texts.clone().map(str::len).max().unwrap_or(0).max(1);
        let length_dimension = format!("{}_length", variable.name);
        let bytes = texts.flat_map(|text| text.bytes().chain(std::iter::repeat_n(0, length - text.len()))).collect();
        self.dimension(&length_dimension, length);
        let variable = Variable { dimensions: vec![dimension.into(), length_dimension], ..variable };
        self.fixed(variable.with("_Encoding", "utf-8"), Values::Text(bytes));
    }

    /// Adds a variable of numbers with a value in each record.
    pub fn record(&mut self, variable: Variable) {
        self.record.push(variable);
    }

    /// Whether there is a variable of that name.
    pub fn has_variable(&self, name: &str) -> bool {
        self.fixed.iter().map(|(variable, _)| variable).chain(&self.record).any(|variable| variable.name == name)
    }

    /// The definition in the library's terms, with `records` records.
    fn data_set(&self, records: usize) -> Result<DataSet, String> {
        let mut data_set = DataSet::new();
        if let Some(name) = &self.record_dimension {
            data_set.set_unlimited_dim(name, records).map_err(in_words)?;
        }
        for (name, length) in &self.dimensions {
            data_set.add_fixed_dim(name, *length).map_err(in_words)?;
        }
        for (name, value) in &self.attributes {
            match finite(name, value)? {
                Attribute::Text(text) => data_set.add_global_attr_string(name, text),
                Attribute::Number(number) => data_set.add_global_attr_f64(name, vec![*number]),
                Attribute::Integers(integers) => data_set.add_global_attr_i32(name, integers.clone()),
            }
            .map_err(in_words)?;
        }
        for (variable, values) in &self.fixed {
            let dimensions: Vec<&str> = variable.dimensions.iter().map(String::as_str).collect();
            match values {
                Values::Numbers(_) => data_set.add_var_f64(&variable.name, &dimensions),
                Values::Integers(_) => data_set.add_var_i32(&variable.name, &dimensions),
                Values::Text(_) => data_set.add_var_u8(&variable.name, &dimensions),
            }
            .map_err(in_words)?;
            add_attributes(&mut data_set, variable)?;
        }
        for variable in &self.record {
            let record = self.record_dimension.iter();
            let dimensions: Vec<&str> = record.chain(&variable.dimensions).map(String::as_str).collect();
            data_set.add_var_f64(&variable.name, &dimensions).map_err(in_words)?;
            add_attributes(&mut data_set, variable)?;
        }
        Ok(data_set)
    }

    /// Writes header and fixed variables; where the records begin.
    fn write_start(&self, output: impl Write + Seek + 'static) -> Result<u64, String> {
        let data_set = self.data_set(0)?;
        let header = write(&data_set, output, |writer| {
            self.fixed.iter().try_for_each(|(variable, values)| match values {
                Values::Numbers(numbers) => writer.write_var_f64(&variable.name, numbers),
                Values::Integers(integers) => writer.write_var_i32(&variable.name, integers),
                Values::Text(bytes) => writer.write_var_u8(&variable.name, bytes),
            })
        })?;
        let bytes = |values: &Values| match values {
            Values::Numbers(numbers) => 8 * numbers.len(),
            Values::Integers(integers) => 4 * integers.len(),
            Values::Text(bytes) => bytes.len().next_multiple_of(4),
        };
        Ok(header + self.fixed.iter().map(|(_, values)| bytes(values) as u64).sum::<u64>())
    }

    /// How many numbers a record has of a variable.
    fn record_len(&self, variable: &Variable) -> usize {
        let length =
            |name: &String| self.dimensions.iter().find(|(own, _)| own == name).map_or(1, |(_, length)| *length);
        variable.dimensions.iter().map(length).product()
    }

    /// Fails unless a record has the numbers of every variable once.
    fn check_complete(&self, record: usize, values: &[(&str, &[f64])]) -> Result<(), String> {
        for variable in &self.record {
            match values.iter().filter(|(name, _)| *name == variable.name).count() {
                1 => {}
                count => return Err(format!("record {record} has {count} values of `{}`, not 1", variable.name)),
            }
        }
        Ok(())
    }
}

/// A file that grows record by record.
#[derive(Debug)]
pub struct NetcdfFile {
    path: PathBuf,
    file: File,
    definition: Definition,
    /// Where the records begin \[bytes\].
    start: u64,
    records: usize,
}

/// Where the number of records stands in the header \[bytes\].
const RECORD_COUNT: u64 = 4;

impl NetcdfFile {
    /// Creates the file with its fixed variables and no records.
    ///
    /// # Errors
    /// If the definition is not consistent, or the file cannot be written.
    pub fn create(path: &Path, definition: Definition) -> Result<Self, SinkError> {
        let failure = |reason| SinkError { path: path.to_path_buf(), reason };
        let file = File::create(path).map_err(|error| failure(error.to_string()))?;
        let output = file.try_clone().map_err(|error| failure(error.to_string()))?;
        let start = definition.write_start(output).map_err(failure)?;
        Ok(Self { path: path.to_path_buf(), file, definition, start, records: 0 })
    }

    /// Appends a record: the numbers of every record variable, by name.
    ///
    /// # Errors
    /// If a variable is missing or has another number of values, or if the file cannot be written.
    pub fn append(&mut self, values: &[(&str, &[f64])]) -> Result<(), SinkError> {
        self.definition.check_complete(self.records, values).map_err(|reason| self.failure(reason))?;
        self.write(self.records, values)?;
        let count = u32::try_from(self.records + 1).map_err(|_| self.failure("there are too many records".into()))?;
        self.write_at(RECORD_COUNT, &count.to_be_bytes())?;
        self.records += 1;
        Ok(())
    }

    /// Writes other numbers of some record variables into a record that is there.
    ///
    /// # Errors
    /// If there is no such record or variable, a number of values is wrong, or the file cannot be written.
    pub fn amend(&mut self, record: usize, values: &[(&str, &[f64])]) -> Result<(), SinkError> {
        if record >= self.records {
            return Err(self.failure(format!("record {record} of {} is to be amended", self.records)));
        }
        self.write(record, values)
    }

    /// Writes numbers of some variables into a record; none if one of them is wrong.
    fn write(&mut self, record: usize, values: &[(&str, &[f64])]) -> Result<(), SinkError> {
        let (mut places, mut record_bytes) = (Vec::with_capacity(self.definition.record.len()), 0);
        for variable in &self.definition.record {
            let length = self.definition.record_len(variable);
            places.push((&*variable.name, length, record_bytes));
            record_bytes += 8 * length as u64;
        }
        let start = self.start + record as u64 * record_bytes;
        let mut parts = Vec::with_capacity(values.len());
        for (name, numbers) in values {
            let place = places.iter().find(|(own, ..)| own == name);
            let &(_, length, offset) = place.ok_or_else(|| self.failure(format!("there is no variable `{name}`")))?;
            if numbers.len() != length {
                let reason = format!("record {record} has {} numbers of `{name}`, not {length}", numbers.len());
                return Err(self.failure(reason));
            }
            parts.push((start + offset, numbers.iter().flat_map(|number| number.to_be_bytes()).collect::<Vec<u8>>()));
        }
        parts.iter().try_for_each(|(place, bytes)| self.write_at(*place, bytes))
    }

    fn write_at(&mut self, place: u64, bytes: &[u8]) -> Result<(), SinkError> {
        let written = self.file.seek(SeekFrom::Start(place)).and_then(|_| self.file.write_all(bytes));
        written.map_err(|error| self.failure(error.to_string()))
    }

    /// Appends a record of which nothing is known but its time.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn append_missing(&mut self, time: f64) -> Result<(), SinkError> {
        let values = |variable: &Variable| match variable.name.as_str() {
            "time" => vec![time],
            _ => vec![FILL_VALUE; self.definition.record_len(variable)],
        };
        let record = &self.definition.record;
        let missing: Vec<(String, Vec<f64>)> = record.iter().map(|it| (it.name.clone(), values(it))).collect();
        let missing: Vec<(&str, &[f64])> =
            missing.iter().map(|(name, values)| (name.as_str(), values.as_slice())).collect();
        self.append(&missing)
    }

    /// Number of records so far.
    pub fn records(&self) -> usize {
        self.records
    }

    /// What the file holds.
    pub fn definition(&self) -> &Definition {
        &self.definition
    }

    /// An error about this file.
    pub fn failure(&self, reason: String) -> SinkError {
        SinkError { path: self.path.clone(), reason }
    }
}

/// An output of which the library holds one end and we the other, to see whether its last bytes were written.
struct Shared<W: Write + Seek>(Rc<RefCell<BufWriter<W>>>);

impl<W: Write + Seek> Write for Shared<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // All of it: the library takes no notice when a part of a header is written.
        self.0.borrow_mut().write_all(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.borrow_mut().flush()
    }
}

impl<W: Write + Seek> Seek for Shared<W> {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.0.borrow_mut().seek(position)
    }
}

/// Writes the header and what `body` writes, through a buffer: the library writes each number by itself. Returns the length
/// of the header.
fn write<'a, W: Write + Seek + 'static>(
    data_set: &'a DataSet,
    output: W,
    body: impl FnOnce(&mut FileWriter<'a>) -> Result<(), WriteError>,
) -> Result<u64, String> {
    let shared = Rc::new(RefCell::new(BufWriter::with_capacity(1 << 18, output)));
    let mut writer = FileWriter::open_seek_write("", Box::new(Shared(Rc::clone(&shared)))).map_err(in_words)?;
    writer.set_def(data_set, Version::Offset64Bit, 0).map_err(failure)?;
    let header = shared.borrow_mut().stream_position().map_err(|error| error.to_string())?;
    body(&mut writer).map_err(failure)?;
    // Dropped, never closed: `close` overwrites records where it believes that something is missing.
    drop(writer);
    shared.borrow_mut().flush().map_err(|error| error.to_string())?;
    Ok(header)
}

/// What the library could not write.
fn failure(error: WriteError) -> String {
    match error {
        WriteError::IOErrorKind(kind) => io::Error::from(kind).to_string(),
        error => in_words(error),
    }
}

fn add_attributes(data_set: &mut DataSet, variable: &Variable) -> Result<(), String> {
    for (name, value) in &variable.attributes {
        let result: Result<(), InvalidDataSet> = match finite(name, value)? {
            Attribute::Text(text) => data_set.add_var_attr_string(&variable.name, name, text),
            Attribute::Number(number) => data_set.add_var_attr_f64(&variable.name, name, vec![*number]),
            Attribute::Integers(integers) => data_set.add_var_attr_i32(&variable.name, name, integers.clone()),
        };
        result.map_err(in_words)?;
    }
    Ok(())
}

/// The attribute, unless it is a number that is not finite: the library cannot find a variable that has one.
fn finite<'a>(name: &str, value: &'a Attribute) -> Result<&'a Attribute, String> {
    match value {
        Attribute::Number(number) if !number.is_finite() => Err(format!("attribute `{name}` is {number}")),
        value => Ok(value),
    }
}

fn in_words(error: impl Debug) -> String {
    format!("netCDF: {error:?}")
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
