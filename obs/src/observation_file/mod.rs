//! Files of observations: a table in CSV of what was observed, where and when.

mod columns;
mod record;

pub use record::{FurtherColumns, ObservationPlace, ObservationRecord, ValidTime};

use crate::error::list;
use crate::table::{Faults, Numbered, Table, TableError, known_name};
use columns::Columns;
use record::Memory;
use std::collections::BTreeSet;

/// The observations of a file, in its order.
///
/// The file is a [`Table`]. Columns:
///
/// - `cycle`, from 1, **or** `time`, as [`crate::times::parse`] reads it;
/// - `x_m` and `y_m`, **or** `latitude_deg` and `longitude_deg`, **or** `column` and `row`: the variable's own point of the
///   grid, counted from 1 from the west and from the south;
/// - `value`, in the variable's unit;
/// - `variable` and `sigma` (the standard deviation of the random error), where they are not the same for all;
/// - `id` (also `platform`), optional: the station, which may observe a variable once in a cycle; by default the
///   observation's place;
/// - [`FurtherColumns`], where biases depend on them.
///
/// Other columns are not read.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationFile {
    file: String,
    numbered: Numbered,
    columns: Vec<String>,
    further: FurtherColumns,
    records: Vec<ObservationRecord>,
    missing: usize,
}

impl ObservationFile {
    /// Reads the text of a file of observations; `file` is its name, for messages. Rows without a value or a place (empty,
    /// `NaN`, `NA`), or with a value that is one of `markers`, are counted as missing.
    ///
    /// # Errors
    /// A value that usually marks a missing one, such as -9999, unless there are `markers`. Missing or ambiguous columns; else
    /// all lines that are not rows of the table, and fields that are not what they must be, each with its line; a file without
    /// observations.
    pub fn parse(text: &str, file: &str, markers: Option<&[f64]>) -> Result<Self, TableError> {
        Self::parse_with(text, file, markers, FurtherColumns::default())
    }

    /// The same with further columns. Numbers in these may be missing, and have the same `markers`.
    ///
    /// # Errors
    /// As [`ObservationFile::parse`].
    pub fn parse_with(
        text: &str,
        file: &str,
        markers: Option<&[f64]>,
        further: FurtherColumns,
    ) -> Result<Self, TableError> {
        match Table::new(text, file, columns::KNOWN)? {
            Some(table) => Self::of_table(&table, file, markers, further),
            None => Err(no_observations(file, Numbered::Lines)),
        }
    }

    /// The same of a table that is no text, of columns with these names, whose fields are as they would be written in a text.
    /// Rows may be shorter than the names, whose last ones then have no fields; [`ObservationFile::reads`] says which are read.
    ///
    /// # Errors
    /// As [`ObservationFile::parse`], with numbers of rows.
    pub fn of_rows(
        columns: Vec<String>,
        rows: Vec<Vec<String>>,
        file: &str,
        markers: Option<&[f64]>,
        further: FurtherColumns,
    ) -> Result<Self, TableError> {
        Self::of_table(&Table::of_rows(columns, rows, file, columns::KNOWN)?, file, markers, further)
    }

    /// Whether anything is read from a column.
    pub fn reads(column: &str, further: &FurtherColumns) -> bool {
        let FurtherColumns { group_by, report_by, network, predictors } = further;
        let is_further = |name: &String| name == column;
        Self::known_name(column).is_some()
            || group_by.iter().chain(report_by).chain(predictors).any(is_further)
            || network.is_some() && column == columns::NETWORK
    }

    /// The name of the column that every file may have and that another name means, in capitals or as a synonym.
    pub fn known_name(column: &str) -> Option<&'static str> {
        known_name(column, columns::KNOWN)
    }

    fn of_table(
        table: &Table<'_>,
        file: &str,
        markers: Option<&[f64]>,
        further: FurtherColumns,
    ) -> Result<Self, TableError> {
        let columns = Columns::find(table, &further)?;
        let mut faults = Faults::of(table.numbered());
        let mut records = Vec::new();
        let mut missing = 0;
        let mut others = BTreeSet::new();
        let mut memory = Memory::default();
        table.each_row(&mut faults, |row, faults| {
            if let Err(other) = columns.is_read(&row) {
                if !others.contains(other) {
                    others.insert(other.to_owned());
                }
            } else if columns.is_missing(&row, markers) {
                missing += 1;
            } else {
                records.extend(columns.record(&row, markers, &mut memory, faults));
            }
        });
        faults.check(file)?;
        if records.is_empty() && missing == 0 {
            return Err(match &further.network {
                Some(name) if !others.is_empty() => {
                    let others = list(others.iter().map(|name| name.chars().take(60).collect::<String>()).take(20));
                    TableError::whole(
                        file,
                        format!("has no observations of network `{name}`; it has those of {others}"),
                    )
                }
                _ => no_observations(file, table.numbered()),
            });
        }
        Ok(Self {
            file: file.to_owned(),
            numbered: table.numbered(),
            columns: table.columns().to_vec(),
            further,
            records,
            missing,
        })
    }

    /// Name of the file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// What the numbers of its records count.
    pub fn numbered(&self) -> Numbered {
        self.numbered
    }

    /// Names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The columns that were read beside those that every file may have.
    pub fn further(&self) -> &FurtherColumns {
        &self.further
    }

    /// The observations, in the order of the file; at least one unless all are missing.
    pub fn records(&self) -> &[ObservationRecord] {
        &self.records
    }

    /// The number of rows without a value or a place.
    pub fn missing(&self) -> usize {
        self.missing
    }
}

fn no_observations(file: &str, numbered: Numbered) -> TableError {
    let form = match numbered {
        Numbered::Lines => {
            "it needs a header line such as `cycle,x_m,y_m,variable,value,sigma` and a line for each observation"
        }
        Numbered::Rows => "it needs variables such as `time`, `x_m`, `y_m`, `variable`, `value` and `sigma`",
    };
    TableError::whole(file, format!("has no observations: {form}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Time;

    const GOOD: &str = "# two\n\ntime, x_m,y_m,variable,value,sigma,id,remark\n\
                        2026-01-15T06:00:00Z,1e5,2e5,h,1012.5,12,a,\n# a remark\n2026-01-15 12:00:00,1,2,u,-3,2.2,b,x\n";

    #[test]
    fn a_good_file_gives_its_observations_with_their_lines() {
        let file = ObservationFile::parse(GOOD, "good.csv", None).unwrap();
        let [first, second] = file.records() else { panic!("two observations") };
        let six = Time::from_seconds(1_768_456_800);
        assert_eq!((first.line, first.valid, first.value), (4, ValidTime::Time(six), 1012.5));
        assert_eq!(first.place, ObservationPlace::Plane { x_m: 1e5, y_m: 2e5 });
        assert_eq!((first.variable.as_deref(), first.sigma, first.id.as_deref()), (Some("h"), Some(12.0), Some("a")));
        assert_eq!((second.line, second.valid), (6, ValidTime::Time(Time::from_seconds(six.seconds() + 6 * 3600))));
        let short = ObservationFile::parse("cycle,column,row,value\r\n2,4,5,0.5\r\n", "short.csv", None).unwrap();
        let record = &short.records()[0];
        assert_eq!(
            (record.valid, record.place),
            (ValidTime::Cycle(2), ObservationPlace::GridPoint { column: 4, row: 5 })
        );
        assert_eq!((&record.variable, record.sigma, &record.id), (&None, None, &None));
    }

    /// What spreadsheets, R and old systems make of a table.
    #[test]
    fn a_file_is_the_same_however_its_table_is_written() {
        let clean = ObservationFile::parse("time,latitude_deg,longitude_deg,value,id\n2026-01-15T06:00:00Z,5,-6,7,a\n2026-01-15T12:00:00Z,8,9,-0.5,\"b, \"\"c\"\"\"\n", "t.csv", None).unwrap();
        let body = "2026-01-15 06:00:00 UTC,5,-6,7,a\n2026-01-15T14:00:00+02:00,8,9,-0.5,\"b, \"\"c\"\"\"\n";
        let long_remarks = "   # licence\n".repeat(2000);
        for text in [
            format!("\u{feff}\"time\",\"latitude_deg\",\"longitude_deg\",\"value\",\"id\"\n{body}"),
            format!("\u{feff}# remark\n\nTime,Lat,LON,Value,ID\n{body}"),
            format!("{long_remarks}time, latitude, longitude, value, id\n\n{body}"),
            format!(",,,,,,\ntime,latitude_deg,longitude_deg,value,id,,\n{body},,,,,,\n,\n"),
            format!("time,latitude_deg,longitude_deg,value,id\n{}", body.replace('\n', ",,\n")),
            format!("time,latitude_deg,longitude_deg,value,id\n{body}").replace('\n', "\r"),
        ] {
            let file = ObservationFile::parse(&text, "t.csv", None).unwrap_or_else(|error| panic!("{text}: {error}"));
            let without_lines = |file: &ObservationFile| -> Vec<ObservationRecord> {
                file.records().iter().map(|record| ObservationRecord { line: 0, ..record.clone() }).collect()
            };
            assert_eq!(without_lines(&file), without_lines(&clean), "{text}");
        }
        let whole = ObservationFile::parse("cycle,column,row,value\n1.0,2.0,3,4\n", "t.csv", None).unwrap();
        assert_eq!(whole.records()[0].valid, ValidTime::Cycle(1));
    }

    #[test]
    fn rows_without_a_value_or_a_place_are_counted() {
        let text =
            "cycle,x_m,y_m,value,sigma\n1,2,3,,\n1,2,3,NaN,1\n1,2,3,NA,1\n1,,3,4,1\n1,2,3,-9999.0,1\n1,2,3,4,1\n";
        let file = ObservationFile::parse(text, "t.csv", Some(&[-9999.0])).unwrap();
        assert_eq!((file.records().len(), file.missing()), (1, 5));
        let all = ObservationFile::parse("cycle,x_m,y_m,value\n1,2,3,\n", "t.csv", None).unwrap();
        assert_eq!((all.records().len(), all.missing()), (0, 1));
        let kept = ObservationFile::parse(text, "t.csv", Some(&[])).unwrap();
        assert_eq!((kept.records().len(), kept.missing()), (2, 4));
    }

    /// Rows that are no text have their own numbers, and the same faults.
    #[test]
    fn rows_give_what_the_same_text_gives() {
        let of = |text: &str, markers: Option<&[f64]>, further: &FurtherColumns| {
            let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<String>>());
            let (columns, rows) = (lines.next().unwrap(), lines.collect());
            let of_text = ObservationFile::parse_with(text, "t", markers, further.clone());
            (of_text, ObservationFile::of_rows(columns, rows, "t", markers, further.clone()))
        };
        let good = "Time,lat,lon,value,platform,network,note\n2026-01-15T06:00:00Z,5,-6,7,a,A,x\n2026-01-15T12:00:00Z,8,9,,b,A,\n\
                    2026-01-15T12:00:00Z,8,9,-0.5,b,B,\n";
        let only = |name: &str| FurtherColumns { network: Some(name.into()), ..FurtherColumns::default() };
        for (further, count) in [(FurtherColumns::default(), 2), (only("A"), 1), (only("B"), 1)] {
            let (text, rows) = of(good, None, &further);
            let (text, rows) = (text.unwrap(), rows.unwrap());
            let numbers = |it: &ObservationFile| it.records().iter().map(|own| own.line).collect::<Vec<_>>();
            assert_eq!(numbers(&text), numbers(&rows).iter().map(|row| row + 1).collect::<Vec<_>>());
            let same = |it: &ObservationFile| {
                let records = it.records().iter().map(|own| ObservationRecord { line: 0, ..own.clone() });
                (records.collect::<Vec<_>>(), it.missing(), it.columns().to_vec())
            };
            assert_eq!(same(&text), same(&rows));
            assert_eq!(rows.records().len(), count);
        }
        let (_, error) = of(good, None, &only("C"));
        assert_eq!(error.unwrap_err().to_string(), "t has no observations of network `C`; it has those of `A`, `B`");
        let bad = "cycle,x_m,y_m,value,sigma\n1,one,2,-9999,-1\n1,2,3,4,5\n1.5,2,3,4,1\n";
        let (text, rows) = of(bad, None, &FurtherColumns::default());
        let (text, rows) = (text.unwrap_err(), rows.unwrap_err());
        let with_rows = text.to_string().replace("line 2", "row 1").replace("line 4", "row 3");
        assert_eq!(with_rows, rows.to_string());
        assert!(rows.to_string().contains("row 3: `cycle` is `1.5`") && rows.total == 4, "{rows}");
        for (head, expected) in [
            ("cycle,x_m,y_m", "t has no column `value`; it has `cycle`, `x_m`, `y_m`"),
            ("value,value", "t has two columns `value`"),
            ("cycle,x_m,y_m,value", "t has no observations: it needs variables such as"),
        ] {
            let (_, rows) = of(head, None, &FurtherColumns::default());
            let said = rows.unwrap_err().to_string();
            assert!(said.starts_with(expected), "{said}");
        }
    }

    #[test]
    fn all_faults_are_listed_up_to_twenty() {
        let text = "cycle,x_m,y_m,value,sigma\n1,one,2,3,-1\n1,2,3,4,5\n1.5,2,3,\"4,5\",1\n";
        let error = ObservationFile::parse(text, "t.csv", None).unwrap_err();
        assert_eq!(
            error.to_string(),
            "t.csv has 4 faults:\n\
             line 2: `x_m` is `one`, but must be a finite number\n\
             line 2: `sigma` is `-1`, but must be a finite number above 0\n\
             line 4: `cycle` is `1.5`, but must be a whole number from 1 to 1000000\n\
             line 4: `value` is `4,5`, but must be a finite number; numbers have a decimal point, not a comma"
        );
        let many = format!("cycle,x_m,y_m,value\n{}", "1,2,3,x\n".repeat(23));
        let error = ObservationFile::parse(&many, "t.csv", None).unwrap_err();
        assert_eq!((error.faults.len(), error.total), (20, 23));
        assert!(error.to_string().ends_with("\nand 3 more"), "{error}");
    }

    #[test]
    fn errors_say_where_and_what() {
        let head = "cycle,x_m,y_m,value";
        for (text, expected) in [
            (format!("{head}\n1,2,3\n"), "line 2: there are 3 fields, but the header has 4"),
            (format!("{head}\n0,2,3,4\n"), "line 2: `cycle` is `0`, but must be a whole number from 1 to 1000000"),
            (format!("{head}\n1,2,3,inf\n"), "line 2: `value` is `inf`, but must be a finite number"),
            (format!("{head}\n1,2,3,-9999.0\n"), "line 2: `value` is -9999, which usually marks a missing value"),
            (format!("{head}\n1,2,inf,4\n"), "line 2: `y_m` is `inf`, but must be a finite number"),
            (format!("{head}\n#\n1,2,3,1e19\n"), "line 3: `value` is `1e19`"),
            (format!("{head},sigma\n1,2,3,4,0\n"), "`sigma` is `0`, but must be a finite number above 0"),
            (format!("{head},id\n1,2,3,4,\n"), "the column `id` is empty, but must be a name"),
            (format!("{head}\n1,2,3,\"4\n"), "line 2: a quotation mark is not closed"),
            ("time,x_m,y_m,value\nnoon,2,3,4\n".into(), "`time` is `noon`, but must be a time such as"),
            ("time,x_m,y_m,value\n2026-01-15T06:00:00.5Z,2,3,4\n".into(), "in whole seconds"),
            ("x_m,y_m,value\n".into(), "no column `cycle` (or `time`)"),
            ("cycle;x_m;y_m;value\n1;2;3;4,5\n".into(), "line 1: the fields are separated by semicolons"),
            ("\"cycle\"\tx_m\ty_m\tvalue\n".into(), "line 1: the fields are separated by tabs"),
            (
                format!("{head}\n1,2,3,4,5\n"),
                "line 2: there are 5 fields, but the header has 4 columns; are there decimal",
            ),
            (format!("{head},,\n1,2,3,4,,5\n"), "line 2: field 6 is `5`, but its column has no name"),
            (format!("{head},Value\n"), "two columns `value`"),
            (format!("{head},id\n1,2,3,4,{}\n", "x".repeat(201)), "`id` has 201 characters"),
            (format!("{head},note\n1,2,3,4,{}\n", "x".repeat(10_001)), "field 5 has 10001 characters"),
            ("date,x_m,y_m,value\n".into(), "it has `date`, `x_m`, `y_m`, `value`; is `date` for `time` meant?"),
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
            let message = ObservationFile::parse(&text, "bad.csv", None).unwrap_err().to_string();
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
                    let Ok(file) = ObservationFile::parse(text, "mutated.csv", None) else { continue };
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
