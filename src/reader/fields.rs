//! Files of fields: a column for each field, a row for each cell.

use super::{Field, Read, files};
use crate::text::{clean, clean_lines, shown_path};
use isobar_model::Grid;
use isobar_obs::table::{Faults, LARGEST, Table, TableError};

/// The fields of a file.
pub(crate) struct Fields {
    /// Their names, if the file has a header.
    pub names: Option<Vec<String>>,
    /// Each `[y, x]`; at least one.
    pub columns: Vec<Vec<f64>>,
}

/// Reads the CSV file that a key names: a column for each of at most `most` fields, a row for each cell of the grid, row by
/// row from the south, each from the west. Empty lines and lines that begin with `#` are skipped; the first line may be a
/// header.
pub(crate) fn read(field: &Field<'_>, grid: &Grid, most: usize) -> Read<Fields> {
    let shown = shown_path(&field.path()?);
    parse(&files::read(field, "file")?, &shown, grid.cells(), most).map_err(|error| {
        let message = format!("{error} (the grid is {} × {})", grid.nx, grid.ny);
        field.invalid(clean_lines(&message), "cannot be used")
    })
}

/// The fields of a text, with `cells` values each.
///
/// # Errors
/// All that is wrong, each with its line.
fn parse(text: &str, file: &str, cells: usize, most: usize) -> Result<Fields, TableError> {
    let nothing = || TableError::whole(file, "has no rows of numbers");
    let (table, has_header) = Table::of_numbers(text, file)?.ok_or_else(nothing)?;
    let width = table.width();
    if width > most {
        return Err(table.wrong_header(format!("there are {width} columns, more than the {most} allowed")));
    }
    let mut columns = vec![Vec::new(); width];
    let (mut faults, mut rows) = (Faults::default(), 0);
    let mut commas = DecimalCommas::default();
    table.each_row(&mut faults, |row, faults| {
        rows += 1;
        if rows == cells + 1 {
            let names = if has_header { "" } else { "; names in a header must not be numbers" };
            let problem = format!("there are more than the {cells} rows of numbers that the grid has cells{names}");
            faults.add(row.line, problem);
        }
        if rows <= cells {
            let numbers = columns.iter_mut().enumerate();
            numbers.for_each(|(number, column)| column.extend(row.number(number, (-LARGEST, LARGEST), faults)));
            commas.look_at((0..width).map(|number| row.text(number)));
        }
    });
    faults.check(file)?;
    if !has_header && commas.are_likely() {
        let problem = "seems to have decimal commas; write numbers with points, or name the columns in a header";
        return Err(TableError::whole(file, problem));
    }
    if rows < cells {
        let problem = format!("has {rows} rows of numbers, but should have {cells}, one for each cell of the grid");
        return Err(TableError::whole(file, problem));
    }
    let names = has_header.then(|| table.columns()[..width].iter().map(|name| clean(name)).collect());
    Ok(Fields { names, columns })
}

/// Whether each second column of a table could be the decimals of the column before it: digits alone, some of which begin
/// with a zero as no number does.
#[derive(Default)]
struct DecimalCommas {
    has_other: bool,
    has_leading_zero: bool,
}

impl DecimalCommas {
    fn look_at<'a>(&mut self, fields: impl ExactSizeIterator<Item = &'a str>) {
        self.has_other |= fields.len() % 2 == 1;
        for field in fields.skip(1).step_by(2) {
            self.has_other |= !field.bytes().all(|byte| byte.is_ascii_digit());
            self.has_leading_zero |= field.len() > 1 && field.starts_with('0');
        }
    }

    fn are_likely(&self) -> bool {
        self.has_leading_zero && !self.has_other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_with_and_without_names() {
        let named = parse("# two\n\nh, u\n1,2\r\n-3e-2,4\n", "f.csv", 2, 2).unwrap();
        assert_eq!(
            (named.names, named.columns),
            (Some(vec!["h".into(), "u".into()]), vec![vec![1.0, -0.03], vec![2.0, 4.0]])
        );
        let plain = parse("\u{feff}1\n2\n3", "f.csv", 3, 1).unwrap();
        assert_eq!((plain.names, plain.columns), (None, vec![vec![1.0, 2.0, 3.0]]));
        let of_a_spreadsheet = parse("\"h\",\"u\",,\r1,2,,\r,,,\r3,4,,\r", "f.csv", 2, 2).unwrap();
        assert_eq!(of_a_spreadsheet.columns, [[1.0, 3.0], [2.0, 4.0]]);
    }

    #[test]
    fn faults_are_named_with_their_line() {
        for (text, expected) in [
            ("", "f.csv has no rows of numbers"),
            ("# only a remark\n", "has no rows of numbers"),
            ("1,2\n3\n", "line 2: there are 1 fields, but the header has 2"),
            ("a\n1\n#\nx\n", "line 4: `a` is `x`, but must be a finite number"),
            ("1,2\n3,nan\n", "line 2: `column 2` is `nan`"),
            ("1,2\n3,1e999\n", "line 2: `column 2` is `1e999`"),
            ("1,2,3\n", "3 columns, more than the 2 allowed"),
            ("1\n", "1 rows of numbers, but should have 2"),
            ("1\n2\n3\n", "line 3: there are more than the 2 rows"),
            ("1;5\n2;5\n", "line 1: the fields are separated by semicolons"),
            ("a\n1,5\n2,5\n", "line 2: there are 2 fields, but the header has 1 columns; are there decimal commas"),
            ("1,05\n2,5\n", "decimal commas"),
            ("\"1,5\"\n\"2,5\"\n", "`1,5`"),
        ] {
            let Err(error) = parse(text, "f.csv", 2, 2) else { panic!("{text:?} is accepted") };
            let message = error.to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
