//! Records as CSV, for people and their spreadsheets; what is exported can be imported, to the bit.

use super::SensorError;
use super::record::{MOST_RECORDS, Record, Records};
use crate::calendar::utc;
use crate::safe_file;
use crate::tables::{self, Cell};
use crate::text::{clean, listed, nearest};
use isobar_obs::table::{Faults, LARGEST, Row, Table, TableError, decode};
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
/// All lines that are no records, with what would be right.
pub fn read(path: &Path) -> Result<Vec<(u64, Record)>, SensorError> {
    let bytes = safe_file::read_named(path, LARGEST_TABLE);
    let bytes = bytes.map_err(|error| SensorError::new(path, error.to_string()))?;
    parse(path, &bytes)
}

/// Reads the text of a table; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &[u8]) -> Result<Vec<(u64, Record)>, SensorError> {
    records(text).map_err(|error| SensorError::of_table(path, &error))
}

/// Refuses a column that is not one of these: it would be ignored.
///
/// # Errors
/// The first such column, with the one that may be meant.
pub fn refuse_unknown(table: &Table<'_>, known: &[&str]) -> Result<(), TableError> {
    let is_unknown = |name: &&String| !name.is_empty() && !known.contains(&name.as_str());
    let Some(name) = table.columns().iter().find(is_unknown) else { return Ok(()) };
    let known = || known.iter().copied();
    let near = nearest(name, known()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
    Err(table.wrong_header(format!("unknown column `{}`{near} (columns: {})", clean(name), listed(known()))))
}

fn records(text: &[u8]) -> Result<Vec<(u64, Record)>, TableError> {
    let table =
        Table::new(decode(text, "")?, "", &COLUMNS)?.ok_or_else(|| TableError::whole("", "it has no records"))?;
    refuse_unknown(&table, &COLUMNS)?;
    if let Some(column) = ["record", "sensor"].into_iter().find(|column| table.find(column).is_none()) {
        let problem = format!("the header has no column `{column}` (columns: {})", listed(COLUMNS));
        return Err(table.wrong_header(problem));
    }
    let (mut faults, mut records) = (Faults::default(), Vec::new());
    table.each_row(&mut faults, |row, faults| {
        if records.len() == MOST_RECORDS {
            faults.add(row.line, format!("there are more than {MOST_RECORDS} records"));
        } else if let Some(record) = record(&table, &row, faults) {
            records.push((row.line as u64, record));
        }
    });
    faults.check("")?;
    Ok(records)
}

/// The record of a row; `None`, and its faults, if it is none.
fn record(table: &Table<'_>, row: &Row<'_>, faults: &mut Faults) -> Option<Record> {
    let field = |column: &str| table.find(column).map_or("", |number| row.text(number));
    let kind = field("record");
    let Some((_, required, optional)) = KINDS.iter().find(|(name, ..)| *name == kind) else {
        let names = || KINDS.iter().map(|kind| kind.0);
        let near = nearest(kind, names()).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        faults.add(row.line, format!("`record` cannot be \"{}\"{near} (records: {})", clean(kind), listed(names())));
        return None;
    };
    let mut is_complete = true;
    for column in COLUMNS.iter().skip(2) {
        let empty = field(column).is_empty();
        if empty && required.contains(column) {
            faults.add(row.line, format!("`{column}` is empty, but a {kind} must have it"));
            is_complete = false;
        }
        if !empty && !required.contains(column) && !optional.contains(column) {
            faults.add(row.line, format!("`{column}` is \"{}\", but a {kind} has none", clean(field(column))));
            is_complete = false;
        }
    }
    if !is_complete {
        return None;
    }
    let anywhere = (-LARGEST, LARGEST);
    let number =
        |column: &str, faults: &mut Faults| table.find(column).and_then(|number| row.number(number, anywhere, faults));
    let time = |faults: &mut Faults| table.find("time").and_then(|number| row.time(number, faults));
    let sensor = field("sensor").to_string();
    Some(match kind {
        "sensor" => Record::Sensor {
            name: sensor,
            unit: field("unit").into(),
            place: match (field("x_m").is_empty(), field("y_m").is_empty()) {
                (true, true) => None,
                (false, false) => Some((number("x_m", faults)?, number("y_m", faults)?)),
                _ => {
                    faults.add(row.line, "a place has both `x_m` and `y_m`");
                    return None;
                }
            },
            note: field("note").into(),
        },
        "calibration" => Record::Calibration {
            sensor,
            time: time(faults)?,
            origin: field("origin").into(),
            value: number("value", faults)?,
            sigma: number("sigma", faults)?,
        },
        "covariance" => Record::Covariance {
            sensor,
            other: field("other_sensor").into(),
            time: time(faults)?,
            origin: field("origin").into(),
            covariance: number("value", faults)?,
        },
        "test_point" => Record::TestPoint {
            sensor,
            time: time(faults)?,
            reading: number("value", faults)?,
            reference: number("reference", faults)?,
            sigma: number("sigma", faults)?,
        },
        _ => Record::Recalibration {
            sensor,
            time: time(faults)?,
            step: number("value", faults)?,
            sigma: number("sigma", faults)?,
            note: field("note").into(),
        },
    })
}

/// The records as a table.
pub fn write(records: &Records) -> String {
    let row = |record: &Record| -> Vec<Cell> {
        let fields = fields(record);
        let of = |column: &str| fields.iter().find(|field| field.0 == column).map_or("", |field| field.1.as_str());
        COLUMNS.map(|column| of(column).into()).into()
    };
    tables::Table::new(&COLUMNS, records.iter().map(row).collect()).csv()
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
