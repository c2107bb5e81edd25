//! Files of observations: a table in CSV of what was observed, where and when.

use crate::error::ObservationError;
use crate::table::Table;
use isobar_model::Time;

/// The observations of a file, in its order.
///
/// The file is CSV with a header line; empty lines and lines that begin with `#` are skipped. Columns:
///
/// - `cycle`, from 1, **or** `time`, such as `2026-01-15T06:00:00Z`, in whole seconds;
/// - `x_m` and `y_m`, **or** `latitude_deg` and `longitude_deg`, **or** `column` and `row`: the variable's own point of the
///   grid, counted from 1 from the west and from the south;
/// - `value`, in the variable's unit;
/// - `variable` and `sigma` (the standard deviation of the random error), where they are not the same for all;
/// - `id`, optional: the station, which may observe a variable once in a cycle; by default the observation's place.
///
/// Other columns are not read.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationFile {
    file: String,
    columns: Vec<String>,
    records: Vec<ObservationRecord>,
}

/// One line of a file of observations.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationRecord {
    /// Line number, from 1.
    pub line: usize,
    /// When it is valid.
    pub valid: ValidTime,
    /// Where.
    pub place: ObservationPlace,
    /// The variable's name, if the file says it.
    pub variable: Option<String>,
    /// The observed value; finite.
    pub value: f64,
    /// Standard deviation of its random error, above 0, if the file says it.
    pub sigma: Option<f64>,
    /// The station, if the file says it.
    pub id: Option<String>,
}

/// When an observation is valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ValidTime {
    /// At the end of the cycle of this number, from 1.
    Cycle(usize),
    /// At this time.
    Time(Time),
}

/// Where an observation is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObservationPlace {
    /// On the plane.
    Plane {
        /// x \[m\].
        x_m: f64,
        /// y \[m\].
        y_m: f64,
    },
    /// On the Earth.
    Geographic {
        /// Degrees north.
        latitude_deg: f64,
        /// Degrees east.
        longitude_deg: f64,
    },
    /// At a point of the grid.
    GridPoint {
        /// From 1, from the west.
        column: usize,
        /// From 1, from the south.
        row: usize,
    },
}

/// The largest size of a value or coordinate.
const LARGEST: f64 = 1e18;

/// The last cycle that a file may name, and the last column or row.
const LAST: usize = 1_000_000;

/// Numbers of the columns.
struct Columns {
    cycle: Option<usize>,
    time: Option<usize>,
    place: PlaceColumns,
    value: usize,
    variable: Option<usize>,
    sigma: Option<usize>,
    id: Option<usize>,
}

#[derive(Clone, Copy)]
enum PlaceColumns {
    Plane(usize, usize),
    Geographic(usize, usize),
    GridPoint(usize, usize),
}

impl ObservationFile {
    /// Reads the text of a file of observations; `file` is its name, for messages.
    ///
    /// # Errors
    /// Lines that are not rows of the table, missing or ambiguous columns, fields that are not what they must be, each with
    /// its line; a file without observations.
    pub fn parse(text: &str, file: &str) -> Result<Self, ObservationError> {
        let no_observations = || {
            let problem = "has no observations; it needs a header line such as \
                           `cycle,x_m,y_m,variable,value,sigma` and a line for each observation";
            ObservationError::in_file(file, None, problem)
        };
        let table = Table::new(text, file)?.ok_or_else(no_observations)?;
        let numbers = find_columns(&table)?;
        let mut records = Vec::new();
        for row in table.lines() {
            let (line, fields) = row?;
            records.push(Row { file, line, columns: &table.columns, fields: &fields }.record(&numbers)?);
        }
        if records.is_empty() {
            return Err(no_observations());
        }
        Ok(Self { file: file.to_owned(), columns: table.columns, records })
    }

    /// Name of the file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The observations, in the order of the file; at least one.
    pub fn records(&self) -> &[ObservationRecord] {
        &self.records
    }
}

/// A line of the table.
struct Row<'a> {
    file: &'a str,
    line: usize,
    columns: &'a [String],
    fields: &'a [String],
}

impl Row<'_> {
    fn record(&self, numbers: &Columns) -> Result<ObservationRecord, ObservationError> {
        let anywhere = |column| self.number(column, -LARGEST, LARGEST);
        let valid = match (numbers.cycle, numbers.time) {
            (Some(cycle), _) => ValidTime::Cycle(self.whole(cycle)?),
            (None, Some(time)) => ValidTime::Time(self.time(time)?),
            (None, None) => unreachable!("there is a column for the time"),
        };
        let place = match numbers.place {
            PlaceColumns::Plane(x, y) => ObservationPlace::Plane { x_m: anywhere(x)?, y_m: anywhere(y)? },
            PlaceColumns::Geographic(latitude, longitude) => ObservationPlace::Geographic {
                latitude_deg: self.number(latitude, -90.0, 90.0)?,
                longitude_deg: self.number(longitude, -180.0, 360.0)?,
            },
            PlaceColumns::GridPoint(column, row) => {
                ObservationPlace::GridPoint { column: self.whole(column)?, row: self.whole(row)? }
            }
        };
        Ok(ObservationRecord {
            line: self.line,
            valid,
            place,
            variable: numbers.variable.map(|column| self.fields[column].clone()),
            value: anywhere(numbers.value)?,
            sigma: numbers.sigma.map(|column| self.number(column, 1.0 / LARGEST, LARGEST)).transpose()?,
            id: numbers.id.map(|column| self.text(column)).transpose()?,
        })
    }

    fn fault(&self, column: usize, expected: String) -> ObservationError {
        ObservationError::invalid_field(self.file, self.line, &self.columns[column], &self.fields[column], &expected)
    }

    fn number(&self, column: usize, low: f64, high: f64) -> Result<f64, ObservationError> {
        let number = self.fields[column].parse::<f64>().ok().filter(|number| (low..=high).contains(number));
        number.ok_or_else(|| match low {
            _ if high < LARGEST => self.fault(column, format!("a number from {low} to {high}")),
            low if low > 0.0 => self.fault(column, "a finite number above 0".to_owned()),
            _ => self.fault(column, "a finite number".to_owned()),
        })
    }

    fn whole(&self, column: usize) -> Result<usize, ObservationError> {
        let number = self.fields[column].parse::<usize>().ok().filter(|number| (1..=LAST).contains(number));
        number.ok_or_else(|| self.fault(column, format!("a whole number from 1 to {LAST}")))
    }

    fn text(&self, column: usize) -> Result<String, ObservationError> {
        match self.fields[column].as_str() {
            "" => Err(self.fault(column, "a name".to_owned())),
            text => Ok(text.to_owned()),
        }
    }

    /// A time in whole seconds; universal time if it does not say another.
    fn time(&self, column: usize) -> Result<Time, ObservationError> {
        let field = self.fields[column].as_str();
        let zoned = field.parse::<jiff::Timestamp>().ok();
        let of_zero_offset = |civil: jiff::civil::DateTime| jiff::tz::Offset::UTC.to_timestamp(civil).ok();
        let time = zoned.or_else(|| field.parse().ok().and_then(of_zero_offset));
        match time.filter(|time| time.subsec_nanosecond() == 0) {
            Some(time) => Ok(Time::from_seconds(time.as_second())),
            None => Err(self.fault(column, "a time such as 2026-01-15T06:00:00Z, in whole seconds".to_owned())),
        }
    }
}

fn find_columns(table: &Table<'_>) -> Result<Columns, ObservationError> {
    let (find, missing) = (|name| table.find(name), |name: &str| table.missing(name));
    let ambiguous = |problem: &str| table.wrong_header(problem);
    let (cycle, time) = (find("cycle"), find("time"));
    match (cycle, time) {
        (None, None) => return Err(missing("`cycle` (or `time`)")),
        (Some(_), Some(_)) => return Err(ambiguous("the header has both `cycle` and `time`; keep one")),
        _ => {}
    }
    let pairs = [("x_m", "y_m"), ("latitude_deg", "longitude_deg"), ("column", "row")];
    let mut places = Vec::new();
    for ((first, second), number) in pairs.into_iter().zip(0..) {
        match (find(first), find(second)) {
            (Some(first), Some(second)) => places.push((number, first, second)),
            (Some(_), None) => return Err(missing(&format!("`{second}`"))),
            (None, Some(_)) => return Err(missing(&format!("`{first}`"))),
            (None, None) => {}
        }
    }
    let place = match places[..] {
        [(0, x, y)] => PlaceColumns::Plane(x, y),
        [(1, latitude, longitude)] => PlaceColumns::Geographic(latitude, longitude),
        [(_, column, row)] => PlaceColumns::GridPoint(column, row),
        [] => return Err(missing("`x_m` and `y_m` (or `latitude_deg` and `longitude_deg`, or `column` and `row`)")),
        _ => return Err(ambiguous("the header has several kinds of position; keep one")),
    };
    let value = find("value").ok_or_else(|| missing("`value`"))?;
    Ok(Columns { cycle, time, place, value, variable: find("variable"), sigma: find("sigma"), id: find("id") })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "# two\n\ntime, x_m,y_m,variable,value,sigma,id,remark\n\
                        2026-01-15T06:00:00Z,1e5,2e5,h,1012.5,12,a,\n# a remark\n2026-01-15 12:00:00,1,2,u,-3,2.2,b,x\n";

    #[test]
    fn a_good_file_gives_its_observations_with_their_lines() {
        let file = ObservationFile::parse(GOOD, "good.csv").unwrap();
        let [first, second] = file.records() else { panic!("two observations") };
        let six = Time::from_seconds(1_768_456_800);
        assert_eq!((first.line, first.valid, first.value), (4, ValidTime::Time(six), 1012.5));
        assert_eq!(first.place, ObservationPlace::Plane { x_m: 1e5, y_m: 2e5 });
        assert_eq!((first.variable.as_deref(), first.sigma, first.id.as_deref()), (Some("h"), Some(12.0), Some("a")));
        assert_eq!((second.line, second.valid), (6, ValidTime::Time(Time::from_seconds(six.seconds() + 6 * 3600))));
        let short = ObservationFile::parse("cycle,column,row,value\r\n2,4,5,0.5\r\n", "short.csv").unwrap();
        let record = &short.records()[0];
        assert_eq!(
            (record.valid, record.place),
            (ValidTime::Cycle(2), ObservationPlace::GridPoint { column: 4, row: 5 })
        );
        assert_eq!((&record.variable, record.sigma, &record.id), (&None, None, &None));
    }

    #[test]
    fn errors_say_where_and_what() {
        let head = "cycle,x_m,y_m,value";
        for (text, expected) in [
            (format!("{head}\n1,2,3\n"), "line 2: there are 3 fields, but the header has 4"),
            (format!("{head}\n0,2,3,4\n"), "line 2: `cycle` is `0`, but must be a whole number from 1 to 1000000"),
            (format!("{head}\n1,2,3,nan\n"), "line 2: `value` is `nan`, but must be a finite number"),
            (format!("{head}\n1,2,inf,4\n"), "line 2: `y_m` is `inf`, but must be a finite number"),
            (format!("{head}\n#\n1,2,3,1e19\n"), "line 3: `value` is `1e19`"),
            (format!("{head},sigma\n1,2,3,4,0\n"), "`sigma` is `0`, but must be a finite number above 0"),
            (format!("{head},id\n1,2,3,4,\n"), "`id` is ``, but must be a name"),
            (format!("{head}\n1,2,3,\"4\n"), "line 2: a quotation mark is not closed"),
            ("time,x_m,y_m,value\nnoon,2,3,4\n".into(), "`time` is `noon`, but must be a time such as"),
            ("time,x_m,y_m,value\n2026-01-15T06:00:00.5Z,2,3,4\n".into(), "in whole seconds"),
            ("x_m,y_m,value\n".into(), "no column `cycle` (or `time`)"),
            ("cycle,time,x_m,y_m,value\n".into(), "both `cycle` and `time`"),
            ("cycle,x_m,value\n".into(), "no column `y_m`"),
            ("cycle,row,value\n".into(), "no column `column`"),
            ("cycle,value\n".into(), "no column `x_m` and `y_m`"),
            ("cycle,x_m,y_m,column,row,value\n".into(), "several kinds of position"),
            ("cycle,x_m,y_m\n".into(), "no column `value`"),
            ("cycle,cycle,x_m,y_m,value\n".into(), "two columns `cycle`"),
            ("cycle,latitude_deg,longitude_deg,value\n1,91,0,0\n".into(), "a number from -90 to 90"),
            (head.into(), "has no observations"),
            (String::new(), "has no observations"),
        ] {
            let message = ObservationFile::parse(&text, "bad.csv").unwrap_err().to_string();
            assert!(message.contains(expected) && message.contains("bad.csv"), "{text:?} gives: {message}");
        }
    }

    #[test]
    fn no_text_makes_it_panic_and_what_it_accepts_is_sound() {
        let mut accepted = 0;
        for (at, old) in GOOD.char_indices() {
            for new in ["", ",", "\"", "\n", "#", "é", "-", "9", "1e999"] {
                let text = format!("{}{new}{}", &GOOD[..at], &GOOD[at + old.len_utf8()..]);
                for text in [text.as_str(), &text[..at]] {
                    let Ok(file) = ObservationFile::parse(text, "mutated.csv") else { continue };
                    accepted += 1;
                    for record in file.records() {
                        assert!(record.value.is_finite() && record.sigma.is_none_or(|sigma| sigma > 0.0), "{text}");
                    }
                }
            }
        }
        assert!(accepted > 100, "{accepted}");
    }
}
