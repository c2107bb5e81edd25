//! Records as CSV, for people and their spreadsheets; what is exported can be imported, to the bit.

use super::SensorError;
use super::record::{MOST_RECORDS, Record, Records};
use crate::calendar::{self, utc};
use crate::text::{clean, listed, nearest};
use isobar_model::Time;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The largest table \[bytes\].
const LARGEST_TABLE: u64 = 500_000_000;

const COLUMNS: [&str; 12] =
    ["record", "sensor", "time", "value", "sigma", "reference", "other_sensor", "unit", "x_m", "y_m", "origin", "note"];

/// A table, for people.
pub const EXAMPLE: &str = "\
record,sensor,time,value,sigma,reference,other_sensor,unit,x_m,y_m,origin,note
sensor,sondes/h/DE,,,,,,m,,,,type RS41
sensor,sondes/h/FR,,,,,,m,,,,
calibration,sondes/h/DE,2026-01-15T00:00:00Z,3.5,0.8,,,,,,laboratory,
calibration,sondes/h/FR,2026-01-15T00:00:00Z,-1,0.8,,,,,,laboratory,
covariance,sondes/h/DE,2026-01-15T00:00:00Z,0.2,,,sondes/h/FR,,,,laboratory,
test_point,sondes/h/DE,2026-02-01T12:00:00Z,1003.1,0.5,1000,,,,,,
recalibration,sondes/h/DE,2026-03-01T00:00:00Z,-4,0.3,,,,,,,new software
";

/// The columns that a record of each kind must and may have beside `record` and `sensor`.
const KINDS: [(&str, &[&str], &[&str]); 5] = [
    ("sensor", &["unit"], &["x_m", "y_m", "note"]),
    ("calibration", &["time", "value", "sigma", "origin"], &[]),
    ("covariance", &["time", "value", "other_sensor", "origin"], &[]),
    ("test_point", &["time", "value", "sigma", "reference"], &[]),
    ("recalibration", &["time", "value", "sigma"], &["note"]),
];

/// Reads a table; each record with its line.
///
/// # Errors
/// The first line that is no record, with what would be right.
pub fn read(path: &Path) -> Result<Vec<(u64, Record)>, SensorError> {
    let failure = |reason: &dyn ToString| SensorError::new(path, reason.to_string());
    let is_file = std::fs::metadata(path).map_err(|error| failure(&error))?.is_file();
    if !is_file {
        return Err(failure(&"it is not a file"));
    }
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|error| failure(&error))?;
    file.take(LARGEST_TABLE + 1).read_to_end(&mut bytes).map_err(|error| failure(&error))?;
    if bytes.len() as u64 > LARGEST_TABLE {
        return Err(failure(&format!("it is larger than {} MB, the largest table", LARGEST_TABLE / 1_000_000)));
    }
    parse(path, &bytes)
}

/// Reads the text of a table; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &[u8]) -> Result<Vec<(u64, Record)>, SensorError> {
    let text = text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(text);
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .flexible(true)
        .from_reader(text);
    let mut rows = reader.records();
    let mut next = || -> Result<Option<(u64, csv::StringRecord)>, SensorError> {
        match rows.next() {
            None => Ok(None),
            Some(Ok(row)) => Ok(Some((row.position().map_or(0, |place| place.line() + skipped(text, place)), row))),
            Some(Err(error)) => {
                let line = error.position().map_or(0, csv::Position::line);
                Err(SensorError::at(path, line, "this is not a line of CSV in UTF-8"))
            }
        }
    };
    let Some((line, header)) = next()? else { return Err(SensorError::new(path, "it has no records")) };
    let columns = header_columns(&header).map_err(|reason| SensorError::at(path, line, reason))?;
    let mut records = Vec::new();
    while let Some((line, row)) = next()? {
        if row.len() != columns.len() {
            let reason = format!("there are {} fields, but the header has {} columns", row.len(), columns.len());
            return Err(SensorError::at(path, line, reason));
        }
        if records.len() == MOST_RECORDS {
            return Err(SensorError::at(path, line, format!("there are more than {MOST_RECORDS} records")));
        }
        let field = |column: &str| {
            let number = columns.iter().position(|own| own == column);
            number.and_then(|number| row.get(number)).unwrap_or_default()
        };
        records.push((line, record(&field).map_err(|reason| SensorError::at(path, line, reason))?));
    }
    Ok(records)
}

/// How many lines that are empty or remarks come between a place and the record that the reader found from there on.
fn skipped(text: &[u8], place: &csv::Position) -> u64 {
    let rest = text.get(place.byte() as usize..).unwrap_or_default();
    let lines = rest.split(|&byte| byte == b'\n');
    lines.take_while(|line| line.trim_ascii().is_empty() || line.starts_with(b"#")).count() as u64
}

/// The names of the columns.
fn header_columns(header: &csv::StringRecord) -> Result<Vec<String>, String> {
    let names: Vec<String> = header.iter().map(String::from).collect();
    for (number, name) in names.iter().enumerate() {
        if !COLUMNS.contains(&name.as_str()) {
            let near = nearest(name, COLUMNS).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
            return Err(format!("unknown column `{}`{near} (columns: {})", clean(name), listed(COLUMNS)));
        }
        if names[..number].contains(name) {
            return Err(format!("the header has two columns `{}`", clean(name)));
        }
    }
    match ["record", "sensor"].iter().find(|column| !names.iter().any(|name| name == *column)) {
        Some(column) => Err(format!("the header has no column `{column}` (columns: {})", listed(COLUMNS))),
        None => Ok(names),
    }
}

/// The record of a row.
fn record<'a>(field: &impl Fn(&str) -> &'a str) -> Result<Record, String> {
    let kind = field("record");
    let Some((_, required, optional)) = KINDS.iter().find(|(name, ..)| *name == kind) else {
        let names = || KINDS.iter().map(|kind| kind.0);
        let near = nearest(kind, names()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        return Err(format!("`record` cannot be \"{}\"{near} (records: {})", clean(kind), listed(names())));
    };
    for column in COLUMNS.iter().skip(2) {
        let empty = field(column).is_empty();
        if empty && required.contains(column) {
            return Err(format!("`{column}` is empty, but a {kind} must have it"));
        }
        if !empty && !required.contains(column) && !optional.contains(column) {
            return Err(format!("`{column}` is \"{}\", but a {kind} has none", clean(field(column))));
        }
    }
    let number = |column: &str| -> Result<f64, String> {
        field(column).parse().map_err(|_| format!("`{column}` is \"{}\", but must be a number", clean(field(column))))
    };
    let sensor = field("sensor").to_string();
    let time = || time(field("time")).map_err(|reason| format!("`time` {reason}"));
    Ok(match kind {
        "sensor" => Record::Sensor {
            name: sensor,
            unit: field("unit").into(),
            place: match (field("x_m").is_empty(), field("y_m").is_empty()) {
                (true, true) => None,
                (false, false) => Some((number("x_m")?, number("y_m")?)),
                _ => return Err("a place has both `x_m` and `y_m`".into()),
            },
            note: field("note").into(),
        },
        "calibration" => Record::Calibration {
            sensor,
            time: time()?,
            origin: field("origin").into(),
            value: number("value")?,
            sigma: number("sigma")?,
        },
        "covariance" => Record::Covariance {
            sensor,
            other: field("other_sensor").into(),
            time: time()?,
            origin: field("origin").into(),
            covariance: number("value")?,
        },
        "test_point" => Record::TestPoint {
            sensor,
            time: time()?,
            reading: number("value")?,
            reference: number("reference")?,
            sigma: number("sigma")?,
        },
        _ => Record::Recalibration {
            sensor,
            time: time()?,
            step: number("value")?,
            sigma: number("sigma")?,
            note: field("note").into(),
        },
    })
}

/// A time in whole seconds.
///
/// # Errors
/// In words.
pub fn time(text: &str) -> Result<Time, String> {
    calendar::parse(text)
        .ok_or_else(|| format!("is \"{}\", but must be as 2026-01-15T00:00:00Z, in whole seconds", clean(text)))
}

/// The records as a table.
pub fn write(records: &Records) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let written = writer.write_record(COLUMNS).and_then(|()| {
        records.iter().try_for_each(|record| {
            let fields = fields(record);
            let of = |column: &str| fields.iter().find(|field| field.0 == column).map_or("", |field| field.1.as_str());
            writer.write_record(COLUMNS.map(of))
        })
    });
    let bytes = written.ok().and_then(|()| writer.into_inner().ok()).expect("memory takes any table");
    String::from_utf8(bytes).expect("CSV of UTF-8 is UTF-8")
}

/// The fields of a record that are not empty. Numbers are the shortest that are read back as the same.
fn fields(record: &Record) -> Vec<(&'static str, String)> {
    let number = |value: &f64| format!("{value:?}");
    match record {
        Record::Sensor { name, unit, place, note } => {
            let mut fields = vec![("record", "sensor".into()), ("sensor", name.clone()), ("unit", unit.clone())];
            fields.extend(place.iter().flat_map(|(x_m, y_m)| [("x_m", number(x_m)), ("y_m", number(y_m))]));
            fields.push(("note", note.clone()));
            fields
        }
        Record::Calibration { sensor, time, origin, value, sigma } => vec![
            ("record", "calibration".into()),
            ("sensor", sensor.clone()),
            ("time", utc(*time)),
            ("value", number(value)),
            ("sigma", number(sigma)),
            ("origin", origin.clone()),
        ],
        Record::Covariance { sensor, other, time, origin, covariance } => vec![
            ("record", "covariance".into()),
            ("sensor", sensor.clone()),
            ("other_sensor", other.clone()),
            ("time", utc(*time)),
            ("value", number(covariance)),
            ("origin", origin.clone()),
        ],
        Record::TestPoint { sensor, time, reading, reference, sigma } => vec![
            ("record", "test_point".into()),
            ("sensor", sensor.clone()),
            ("time", utc(*time)),
            ("value", number(reading)),
            ("reference", number(reference)),
            ("sigma", number(sigma)),
        ],
        Record::Recalibration { sensor, time, step, sigma, note } => vec![
            ("record", "recalibration".into()),
            ("sensor", sensor.clone()),
            ("time", utc(*time)),
            ("value", number(step)),
            ("sigma", number(sigma)),
            ("note", note.clone()),
        ],
    }
}
