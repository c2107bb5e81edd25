//! Files of fields: a column for each field, a row for each cell.

use super::{Field, Read, files};
use crate::text::clean;
use isobar_model::Grid;

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
    let shown = clean(&field.file.beside(&field.text()?).display().to_string());
    parse(&files::read(field, "file")?, grid.cells(), most).map_err(|reason| {
        let message = format!("{shown}{reason} (the grid is {} × {})", grid.nx, grid.ny);
        field.invalid(message, "cannot be used")
    })
}

/// The fields of a text, with `cells` values each.
///
/// # Errors
/// What is wrong, as it goes on after the file's name.
fn parse(text: &str, cells: usize, most: usize) -> Result<Fields, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let rows = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let mut rows = rows.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')).peekable();
    let Some(&(first, header)) = rows.peek() else { return Err(": there is nothing in it".into()) };
    let count = header.split(',').count();
    if count > most {
        return Err(format!(", line {first}: there are {count} columns, more than the {most} allowed"));
    }
    let is_header = header.split(',').any(|word| word.trim().parse::<f64>().is_err());
    let names = is_header.then(|| header.split(',').map(|word| clean(word.trim())).collect());
    if is_header {
        rows.next();
    }
    let mut columns = vec![Vec::with_capacity(cells); count];
    for (number, (line, row)) in rows.enumerate() {
        if number == cells {
            return Err(format!(
                ", line {line}: there are more than the {cells} rows of numbers that the grid has cells"
            ));
        }
        let found = row.split(',').count();
        if found != count {
            return Err(format!(", line {line}: there are {found} values, but should be {count}"));
        }
        for (place, (word, column)) in row.split(',').zip(&mut columns).enumerate() {
            match word.trim().parse::<f64>() {
                Ok(value) if value.abs() <= 1e18 => column.push(value),
                _ => {
                    let word = clean(word.trim());
                    return Err(format!(", line {line}, column {}: `{word}` is not a finite number", place + 1));
                }
            }
        }
    }
    match columns[0].len() {
        rows if rows == cells => Ok(Fields { names, columns }),
        rows => {
            Err(format!(": there are {rows} rows of numbers, but should be {cells}, one for each cell of the grid"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_with_and_without_names() {
        let named = parse("# two\n\nh, u\n1,2\r\n-3e-2,4\n", 2, 2).unwrap();
        assert_eq!(
            (named.names, named.columns),
            (Some(vec!["h".into(), "u".into()]), vec![vec![1.0, -0.03], vec![2.0, 4.0]])
        );
        let plain = parse("\u{feff}1\n2\n3", 3, 1).unwrap();
        assert_eq!((plain.names, plain.columns), (None, vec![vec![1.0, 2.0, 3.0]]));
    }

    #[test]
    fn faults_are_named_with_their_line() {
        for (text, expected) in [
            ("", "nothing in it"),
            ("# only a remark\n", "nothing in it"),
            ("1,2\n3\n", "line 2: there are 1 values, but should be 2"),
            ("a\n1\n#\nx\n", "line 4, column 1: `x` is not a finite number"),
            ("1,2\n3,nan\n", "line 2, column 2: `nan`"),
            ("1,2\n3,1e999\n", "line 2, column 2: `1e999`"),
            ("1,2\n3,\u{1b}[2J\n", "`\\u{1b}[2J`"),
            ("1,2,3\n", "3 columns, more than the 2 allowed"),
            ("1\n", "1 rows of numbers, but should be 2"),
            ("1\n2\n3\n", "line 3: there are more than the 2 rows"),
        ] {
            let Err(message) = parse(text, 2, 2) else { panic!("{text:?} is accepted") };
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
