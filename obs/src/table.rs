//! Tables in CSV, of stations, observations, fields or sensors, as people and spreadsheets write them.

mod decode;
pub(crate) mod error;
mod line;

pub use decode::decode;
pub use error::{Faults, Numbered, TableError, TableFault};

use crate::error::list;
use crate::times;
use isobar_model::Time;
use line::{lines, separator, split};
use std::borrow::Cow;

/// The largest number of characters of a field.
const LONGEST_FIELD: usize = 10_000;

/// The largest number of characters of a name: of a station, or of a group of them.
pub const LONGEST_NAME: usize = 200;

/// The largest size of a number.
pub const LARGEST: f64 = 1e18;

/// Other names of columns that can only mean the same.
const SYNONYMS: &[(&str, &[&str])] = &[
    ("latitude_deg", &["lat", "latitude", "lat_deg", "latitude_degrees", "latitude_degrees_north"]),
    ("longitude_deg", &["lon", "long", "lng", "longitude", "lon_deg", "longitude_degrees", "longitude_degrees_east"]),
    ("id", &["platform"]),
];

/// Names that people give to columns, of which a missing column may be meant.
const LIKELY: &[(&str, &[&str])] = &[
    ("id", &["station", "station_id", "stationid", "stid", "wmo", "wmo_id", "identifier", "name"]),
    ("time", &["date", "datetime", "date_time", "timestamp", "valid_time", "valid"]),
    ("value", &["obs", "observation", "obs_value", "observed", "measurement"]),
    ("sigma", &["error", "obs_error", "std", "stdev", "standard_deviation", "uncertainty"]),
    ("variable", &["var", "varname", "parameter", "quantity"]),
    ("x_m", &["x", "x_km", "easting"]),
    ("y_m", &["y", "y_km", "northing"]),
    ("column", &["col", "i"]),
    ("row", &["j"]),
    ("record", &["kind", "type"]),
];

/// A table whose header has been read.
///
/// A byte order mark, empty lines, rows of nothing but commas, and lines that begin with `#` are skipped wherever they are.
/// Lines may end as on any system. Columns that have neither a name nor a field are no columns.
pub struct Table<'a> {
    file: &'a str,
    /// What is below the header.
    body: Body<'a>,
    /// Names of the columns; empty for one without a name.
    columns: Vec<String>,
}

/// Lines with their numbers from 1.
type Lines<'a> = Vec<(usize, &'a str)>;

enum Body<'a> {
    /// The lines that are neither empty nor remarks, and the number of the header's line.
    Text { header_line: usize, lines: Lines<'a> },
    /// Rows of a table that is no text.
    Rows(Vec<Vec<String>>),
}

/// A row of a table, with as many fields as the table has columns.
pub struct Row<'a> {
    /// Number of its line, or of the row where there is no text, from 1.
    pub line: usize,
    columns: &'a [String],
    fields: &'a [Cow<'a, str>],
}

impl<'a> Table<'a> {
    /// Reads the header of the table in `text`; `None` if there is no line at all. `file` is its name, for messages. The
    /// names in `known` are recognised in capitals too, and by common synonyms unless the column itself is there.
    ///
    /// # Errors
    /// A header that is not a line of CSV, other separators than commas, a column that is there twice.
    pub fn new(text: &'a str, file: &'a str, known: &[&str]) -> Result<Option<Self>, TableError> {
        let Some((mut table, mut lines)) = Self::of_lines(text, file)? else { return Ok(None) };
        let (header_line, _) = lines.remove(0);
        table.body = Body::Text { header_line, lines };
        table.with_known(known).map(Some)
    }

    /// A table that is no text, of columns with these names. Rows may be shorter than the names, whose last ones then have no
    /// fields. `known` are recognised as in [`Table::new`].
    ///
    /// # Errors
    /// A column that is there twice.
    pub fn of_rows(
        columns: Vec<String>,
        rows: Vec<Vec<String>>,
        file: &'a str,
        known: &[&str],
    ) -> Result<Self, TableError> {
        Self { file, body: Body::Rows(rows), columns }.with_known(known)
    }

    /// With the names of known columns as they are known.
    fn with_known(self, known: &[&str]) -> Result<Self, TableError> {
        let mut table = self;
        for column in &mut table.columns {
            if let Some(name) = known.iter().find(|name| name.eq_ignore_ascii_case(column)) {
                *column = name.to_string();
            }
        }
        for (name, synonyms) in SYNONYMS.iter().filter(|(name, _)| known.contains(name)) {
            if table.find(name).is_none() {
                let meant = table.columns.iter_mut().filter(|column| synonyms.contains(&plain(column).as_str()));
                meant.for_each(|column| *column = name.to_string());
            }
        }
        table.check_names()
    }

    /// As [`Table::new`], of a table of numbers that may begin without a header: the columns are then called `column 1` and
    /// so on. Also whether there is a header.
    ///
    /// # Errors
    /// As there.
    pub fn of_numbers(text: &'a str, file: &'a str) -> Result<Option<(Self, bool)>, TableError> {
        let Some((mut table, mut lines)) = Self::of_lines(text, file)? else { return Ok(None) };
        let has_header = table.columns.iter().any(|field| !field.is_empty() && field.parse::<f64>().is_err());
        let header_line = if has_header { lines.remove(0).0 } else { lines[0].0 };
        table.body = Body::Text { header_line, lines };
        if has_header {
            return Ok(Some((table.check_names()?, true)));
        }
        let width = table.width();
        for (number, column) in table.columns.iter_mut().enumerate() {
            *column = if number < width { format!("column {}", number + 1) } else { String::new() };
        }
        Ok(Some((table, false)))
    }

    /// A table of the first line of a text as the names of columns, and all lines.
    fn of_lines(text: &'a str, file: &'a str) -> Result<Option<(Self, Lines<'a>)>, TableError> {
        let is_empty = |line: &(usize, &str)| line.1.chars().all(|c| c == ',' || c.is_whitespace());
        let lines: Lines<'_> = lines(text).filter(|line| !is_empty(line)).collect();
        let Some(&(header_line, header)) = lines.first() else { return Ok(None) };
        let fault = |problem: String| TableError::at(file, header_line, problem);
        if let Some(other) = separator(header) {
            return Err(fault(format!(
                "the fields are separated by {other}, but must be separated by commas, with points in numbers; save the \
                 file so, or replace the {other} and any decimal commas"
            )));
        }
        let mut columns = Vec::new();
        split(header, &mut columns).map_err(fault)?;
        let columns = columns.into_iter().map(Cow::into_owned).collect();
        let body = Body::Text { header_line, lines: Vec::new() };
        Ok(Some((Self { file, body, columns }, lines)))
    }

    /// Refuses two columns of one name.
    fn check_names(self) -> Result<Self, TableError> {
        let is_repeated = |(index, name): &(usize, &String)| !name.is_empty() && self.columns[..*index].contains(name);
        match self.columns.iter().enumerate().find(is_repeated) {
            Some((_, name)) => Err(self
                .wrong_header(format!("the header has two columns `{}`; names of columns must differ", shown(name)))),
            None => Ok(self),
        }
    }

    /// The number of columns up to the last one with a name.
    pub fn width(&self) -> usize {
        self.columns.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1)
    }

    /// Calls `take` with each row below the header. What is not a row is added to the faults.
    pub fn each_row(&self, faults: &mut Faults, mut take: impl FnMut(Row<'_>, &mut Faults)) {
        // One list for all rows: a table may have millions.
        let mut fields: Vec<Cow<'_, str>> = Vec::new();
        match &self.body {
            Body::Text { lines, .. } => {
                for &(line, text) in lines {
                    fields.clear();
                    match self.fields(text, &mut fields) {
                        Ok(true) => take(Row { line, columns: &self.columns, fields: &fields }, faults),
                        Ok(false) => {}
                        Err(problem) => faults.add(line, problem),
                    }
                }
            }
            Body::Rows(rows) => {
                for (row, line) in rows.iter().zip(1..) {
                    fields.clear();
                    fields.extend(row.iter().map(|field| Cow::Borrowed(field.as_str())));
                    fields.resize(self.columns.len(), Cow::Borrowed(""));
                    take(Row { line, columns: &self.columns, fields: &fields }, faults);
                }
            }
        }
    }

    /// Appends the fields of a line; whether any of them says something.
    fn fields<'b>(&self, text: &'b str, fields: &mut Vec<Cow<'b, str>>) -> Result<bool, String> {
        split(text, fields)?;
        if fields.iter().all(|field| field.is_empty()) {
            return Ok(false);
        }
        let named = self.width();
        while fields.len() > self.columns.len() && fields.last().is_some_and(|field| field.is_empty()) {
            fields.pop();
        }
        if fields.len() < named || fields.len() > self.columns.len() {
            let hint = match separator(text) {
                Some(other) => format!("; are they separated by {other}?"),
                None if fields.len() > self.columns.len() => "; are there decimal commas in numbers?".to_owned(),
                None => String::new(),
            };
            let (found, width) = (fields.len(), named);
            return Err(format!("there are {found} fields, but the header has {width} columns{hint}"));
        }
        for (number, field) in fields.iter().enumerate() {
            // No character is shorter than a byte.
            let length = if field.len() > LONGEST_FIELD { field.chars().count() } else { 0 };
            if length > LONGEST_FIELD {
                return Err(format!("field {} has {length} characters, but may have {LONGEST_FIELD}", number + 1));
            }
            if self.columns[number].is_empty() && !field.is_empty() {
                let (number, field) = (number + 1, shown(field));
                return Err(format!("field {number} is `{field}`, but its column has no name in the header"));
            }
        }
        fields.resize(self.columns.len(), Cow::Borrowed(""));
        Ok(true)
    }

    /// Names of the columns; empty for one without a name.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The number of the column of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// That one of the columns `names` is missing, which `missing` says in words.
    pub fn missing(&self, missing: &str, names: &[&str]) -> TableError {
        let present = || self.columns.iter().filter(|column| !column.is_empty());
        let meant = |name: &str| {
            let likely = LIKELY.iter().find(|likely| likely.0 == name)?.1;
            let column = present().find(|column| likely.contains(&plain(column).as_str()))?;
            Some(format!("`{}` for `{name}`", shown(column)))
        };
        let meant: Vec<String> = names.iter().filter_map(|name| meant(name)).collect();
        let hint = if meant.is_empty() { String::new() } else { format!("; is {} meant?", meant.join(", ")) };
        let columns = list(present().map(|column| shown(column)));
        self.wrong_header(format!("the header has no column {missing}; it has {columns}{hint}"))
    }

    /// What is wrong with the header. Without text the name of the file takes its place in the sentence.
    pub fn wrong_header(&self, problem: String) -> TableError {
        match self.body {
            Body::Text { header_line, .. } => TableError::at(self.file, header_line, problem),
            Body::Rows(_) => TableError::whole(self.file, problem.strip_prefix("the header ").unwrap_or(&problem)),
        }
    }

    /// What the numbers of its rows count.
    pub fn numbered(&self) -> Numbered {
        match self.body {
            Body::Text { .. } => Numbered::Lines,
            Body::Rows(_) => Numbered::Rows,
        }
    }
}

impl Row<'_> {
    /// The field in a column, without blanks around it.
    pub fn text(&self, column: usize) -> &str {
        &self.fields[column]
    }

    /// All fields.
    pub fn to_fields(&self) -> Vec<String> {
        self.fields.iter().map(|field| field.to_string()).collect()
    }

    /// Whether the field in a column says that there is no value: it is empty, `NaN`, `NA` or `null`.
    pub fn is_missing(&self, column: usize) -> bool {
        const WORDS: [&str; 6] = ["", "nan", "na", "n/a", "null", "none"];
        let field = &self.fields[column];
        // Most fields are longer than any of these words.
        field.len() <= 4 && WORDS.iter().any(|word| field.eq_ignore_ascii_case(word))
    }

    /// A number from `low` to `high`; `None`, and a fault, if the field is none.
    pub fn number(&self, column: usize, (low, high): (f64, f64), faults: &mut Faults) -> Option<f64> {
        let number = self.fields[column].parse::<f64>().ok().filter(|number| (low..=high).contains(number));
        if number.is_none() {
            let found = self.fields[column].parse::<f64>().unwrap_or(0.0);
            let expected = match (low, high) {
                _ if high < LARGEST => format!("a number from {low} to {high}"),
                _ if low > 0.0 && found > 0.0 && found.is_finite() => format!("a number from {low:e} to {high:e}"),
                _ if low <= 0.0 && found != 0.0 && found.is_finite() => format!("a number from {low:e} to {high:e}"),
                _ if low > 0.0 => "a finite number above 0".to_owned(),
                _ => "a finite number".to_owned(),
            };
            self.wrong(column, &expected, faults);
        }
        number
    }

    /// A whole number from 1 to `most`, which may be written as `1.0`; `None`, and a fault, if the field is none.
    pub fn whole(&self, column: usize, most: usize, faults: &mut Faults) -> Option<usize> {
        let number = self.fields[column].parse::<f64>().ok();
        let number = number.filter(|number| number.fract() == 0.0 && (1.0..=most as f64).contains(number));
        if number.is_none() {
            self.wrong(column, &format!("a whole number from 1 to {most}"), faults);
        }
        number.map(|number| number as usize)
    }

    /// A time; `None`, and a fault, if the field is none.
    pub fn time(&self, column: usize, faults: &mut Faults) -> Option<Time> {
        times::parse(&self.fields[column])
            .map_err(|expected| self.wrong(column, &format!("a time {expected}"), faults))
            .ok()
    }

    /// A name of at most [`LONGEST_NAME`] characters; `None`, and a fault, if the field is none.
    pub fn name(&self, column: usize, faults: &mut Faults) -> Option<&str> {
        let name = &self.fields[column];
        let length = name.chars().count();
        if (1..=LONGEST_NAME).contains(&length) {
            return Some(name);
        }
        let column = shown(&self.columns[column]);
        faults.add(
            self.line,
            match length {
                0 => format!("the column `{column}` is empty, but must be a name"),
                _ => format!("`{column}` has {length} characters, but a name has at most {LONGEST_NAME}"),
            },
        );
        None
    }

    /// Adds the fault that a field is not what it must be.
    pub fn wrong(&self, column: usize, expected: &str, faults: &mut Faults) {
        let (field, column) = (&self.fields[column], shown(&self.columns[column]));
        let with_point = field.replacen(',', ".", 1);
        let hint = match with_point.parse::<f64>() {
            Ok(_) if with_point != *field => "; numbers have a decimal point, not a comma",
            _ => "",
        };
        faults.add(self.line, format!("`{column}` is `{}`, but must be {expected}{hint}", shown(field)));
    }
}

/// What a table says, row by row from its header on: the fields, without the blanks and quotation marks around them, and
/// without empty ones at the end. Lines that say nothing, as remarks, do not count.
pub fn rows(text: &str) -> impl Iterator<Item = Vec<String>> {
    let fields = |(_, line): (usize, &str)| {
        let mut split_fields = Vec::new();
        let is_row = split(line, &mut split_fields).is_ok();
        let mut fields: Vec<String> =
            if is_row { split_fields.into_iter().map(Cow::into_owned).collect() } else { vec![line.to_owned()] };
        fields.truncate(fields.iter().rposition(|field| !field.is_empty()).map_or(0, |last| last + 1));
        fields
    };
    lines(text).map(fields).filter(|fields| !fields.is_empty())
}

/// The name under which a column is known, as [`Table::new`] recognises it.
pub(crate) fn known_name<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let is_synonym = |own: &str| {
        let synonyms = SYNONYMS.iter().find(|(name, _)| *name == own);
        synonyms.is_some_and(|(_, synonyms)| synonyms.contains(&plain(name).as_str()))
    };
    known.iter().find(|own| own.eq_ignore_ascii_case(name) || is_synonym(own)).copied()
}

/// A column's name in lower case, with underscores for anything but letters and digits.
fn plain(name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    plain.trim_matches('_').to_owned()
}

/// A field as a message shows it: the beginning of a long one.
fn shown(field: &str) -> String {
    let mut shown: String = field.chars().take(60).collect();
    if shown.len() < field.len() {
        shown.push('…');
    }
    shown
}
