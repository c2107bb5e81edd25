//! How a forcing depends on time.

use crate::kinds::{Domain, Kind, Kinds};
use crate::reader::{Absent, Described, Field, Form, Key, Limits, Read, files};
use crate::text::{clean_lines, shown_path};
use isobar_model::{Duration, Time, TimeFunction};
use isobar_obs::table::{Faults, LARGEST, Table, TableError};

const PERIOD_HOURS: Key<Limits> =
    Key::required("period_hours", "hours", Limits::Between(0.01, 1e6), "period, in whole seconds");

const HIGHEST_AT_HOURS: Key<Limits> = Key::absent(
    "phase_hours",
    "hours",
    Limits::Between(-1e6, 1e6),
    Absent::Means(0.0),
    "when it is highest, after 1970-01-01T00:00Z: with a period of a day the hour of the day (UTC)",
);

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described(
        "a CSV file with columns `time`, in ascending order, and `value`, from the start of the run to its end and that of \
         all forecasts ahead",
        Form::text,
    ),
    "times and values, linear in between",
);

/// All kinds of functions of time.
pub(crate) const FUNCTIONS: &Kinds<TimeFunction, Domain> = &[
    &Kind::new("constant", "The same at all times", &[], |_, _| Ok(Box::new(TimeFunction::Constant))),
    &Kind::new("sinusoid", "A cosine of amplitude 1", &[&[&PERIOD_HOURS, &HIGHEST_AT_HOURS]], |section, _| {
        let seconds = |hours: f64| Duration::from_seconds((3600.0 * hours).round() as i64);
        let (period, highest_at) = (section.get(&PERIOD_HOURS)?, section.get(&HIGHEST_AT_HOURS)?);
        Ok(Box::new(TimeFunction::Sinusoid { period: seconds(period), highest_at: seconds(highest_at) }))
    }),
    &Kind::new("table", "The values of a file, linear in between", &[&[&FILE]], |section, _| {
        Ok(Box::new(TimeFunction::Table(table(&section.required(FILE.name)?)?)))
    }),
];

/// Reads the file that a key names.
fn table(field: &Field<'_>) -> Read<Vec<(Time, f64)>> {
    let shown = shown_path(&field.path()?);
    let knots = parse(&files::read(field, "file")?, &shown);
    knots.map_err(|error| field.invalid(clean_lines(&error.to_string()), "cannot be used"))
}

/// Times and values of a text.
///
/// # Errors
/// All that is wrong, each with its line.
fn parse(text: &str, file: &str) -> Result<Vec<(Time, f64)>, TableError> {
    let columns = ["time", "value"];
    let table =
        Table::new(text, file, &columns)?.ok_or_else(|| TableError::whole(file, "has no header and no rows"))?;
    let [Some(time), Some(value)] = columns.map(|name| table.find(name)) else {
        return Err(table.missing("`time` and `value`", &columns));
    };
    let (mut faults, mut knots) = (Faults::default(), Vec::<(Time, f64)>::new());
    table.each_row(&mut faults, |row, faults| {
        let (at, value) = (row.time(time, faults), row.number(value, (-LARGEST, LARGEST), faults));
        if let Some((at, value)) = at.zip(value) {
            if knots.last().is_some_and(|last| last.0 >= at) {
                row.wrong(time, "a time after that of the row before", faults);
            }
            knots.push((at, value));
        }
    });
    faults.check(file)?;
    if knots.is_empty() { Err(TableError::whole(file, "has no rows")) } else { Ok(knots) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_values_are_read_and_faults_named_with_their_line() {
        let text = "# tide\nTime,value\n2026-01-15T00:00:00Z,1\n2026-01-15T06:00:00Z,-2e-1\n";
        let start = Time::from_seconds(1_768_435_200);
        let expected = vec![(start, 1.0), (start + Duration::from_seconds(21_600), -0.2)];
        assert_eq!(parse(text, "u.csv").unwrap(), expected);
        for (text, expected) in [
            ("", "u.csv has no header"),
            ("time,value\n", "u.csv has no rows"),
            ("time,u\n2026-01-15T00:00:00Z,1\n", "line 1: the header has no column `time` and `value`"),
            ("time,value\n2026-01-15,x\n", "line 2: "),
            ("time,value\n2026-01-15T00:00:00Z,nan\n", "line 2: `value` is `nan`"),
            ("time,value\nnever,1\n", "line 2: `time` is `never`"),
            (
                "time,value\n2026-01-15T06:00:00Z,1\n2026-01-15T00:00:00Z,1\n",
                "line 3: `time` is `2026-01-15T00:00:00Z`, but must be a time after that of the row before",
            ),
        ] {
            let message = parse(text, "u.csv").unwrap_err().to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
