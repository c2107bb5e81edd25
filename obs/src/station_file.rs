//! Station files: a table of stations in CSV, with any further columns to group them by.

use crate::table::{Faults, LARGEST, LONGEST_NAME, Row, Table, TableError};
use std::collections::HashMap;

/// The stations of a file, in its order.
///
/// The file is a [`Table`]. Columns:
///
/// - `id`: unique, not empty;
/// - `latitude_deg` in [-90, 90] and `longitude_deg` in [-180, 360], **or** `x_m` and `y_m`;
/// - `name`, optional: the station's name in words;
/// - any others, by which the stations can be grouped.
#[derive(Clone, Debug, PartialEq)]
pub struct StationFile {
    file: String,
    columns: Vec<String>,
    records: Vec<StationRecord>,
}

/// Where a station file says that a station is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Position {
    /// On the Earth.
    Geographic {
        /// Degrees north.
        latitude_deg: f64,
        /// Degrees east.
        longitude_deg: f64,
    },
    /// On the plane.
    Plane {
        /// x \[m\].
        x_m: f64,
        /// y \[m\].
        y_m: f64,
    },
}

/// One line of a station file.
#[derive(Clone, Debug, PartialEq)]
pub struct StationRecord {
    /// Line number, from 1.
    pub line: usize,
    /// Unique identifier.
    pub id: String,
    /// Where it is.
    pub position: Position,
    /// All fields as text, in the order of [`StationFile::columns`].
    pub fields: Vec<String>,
}

/// Columns that are recognised in capitals too, and by synonyms.
const KNOWN: &[&str] = &["id", "latitude_deg", "longitude_deg", "x_m", "y_m", "name"];

/// Which columns hold the position, as numbers of columns.
enum PositionColumns {
    Geographic(usize, usize),
    Plane(usize, usize),
}

impl StationFile {
    /// Reads the text of a station file; `file` is its name, for messages.
    ///
    /// # Errors
    /// Missing or ambiguous columns; else all lines that are not rows of the table, coordinates that are not numbers or
    /// out of range, and empty or repeated identifiers, each with its line; a file without stations.
    pub fn parse(text: &str, file: &str) -> Result<Self, TableError> {
        let no_stations = || {
            let form = "it needs a header line such as `id,latitude_deg,longitude_deg` and a line for each station";
            TableError::whole(file, format!("has no stations: {form}"))
        };
        let table = Table::new(text, file, KNOWN)?.ok_or_else(no_stations)?;
        let (id_column, position_columns) = find_columns(&table)?;
        let name_column = table.find("name");
        let mut faults = Faults::default();
        let mut records = Vec::new();
        let mut line_of_id: HashMap<String, usize> = HashMap::new();
        table.each_row(&mut faults, |row, faults| {
            let line = row.line;
            let id = row.name(id_column, faults).map(str::to_owned);
            let position = position_columns.read(&row, faults);
            if let Some(column) = name_column.filter(|&column| !row.text(column).is_empty()) {
                row.name(column, faults);
            }
            if let Some(first_line) = id.as_ref().and_then(|id| line_of_id.insert(id.clone(), line)) {
                let id = id.as_deref().unwrap_or_default();
                faults
                    .add(line, format!("the station `{id}` is already on line {first_line}; identifiers must differ"));
            }
            if let (Some(id), Some(position)) = (id, position) {
                records.push(StationRecord { line, id, position, fields: row.to_fields() });
            }
        });
        faults.check(file)?;
        if records.is_empty() {
            return Err(no_stations());
        }
        Ok(Self { file: file.to_owned(), columns: table.columns().to_vec(), records })
    }

    /// Name of the file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// The stations, in the order of the file; at least one.
    pub fn records(&self) -> &[StationRecord] {
        &self.records
    }

    /// Number of the column of this name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// The group of each station: its field in the column number `column`.
    ///
    /// # Errors
    /// The stations whose field is empty.
    pub(crate) fn groups(&self, column: usize) -> Result<Vec<&str>, TableError> {
        let mut faults = Faults::default();
        for record in &self.records {
            let (name, length) = (&self.columns[column], record.fields[column].chars().count());
            if length == 0 {
                faults.add(record.line, format!("the column `{name}` is empty; every station needs one"));
            } else if length > LONGEST_NAME {
                faults.add(record.line, format!("`{name}` has {length} characters, but may have {LONGEST_NAME}"));
            }
        }
        faults.check(&self.file)?;
        Ok(self.records.iter().map(|record| record.fields[column].as_str()).collect())
    }
}

/// The columns of the identifier and of the position.
fn find_columns(table: &Table<'_>) -> Result<(usize, PositionColumns), TableError> {
    let find = |name| table.find(name);
    let missing = |name: &str| table.missing(&format!("`{name}`"), &[name]);
    let id = find("id").ok_or_else(|| missing("id"))?;
    let position = match (find("latitude_deg"), find("longitude_deg"), find("x_m"), find("y_m")) {
        (Some(latitude), Some(longitude), None, None) => PositionColumns::Geographic(latitude, longitude),
        (None, None, Some(x), Some(y)) => PositionColumns::Plane(x, y),
        (None, None, None, None) => {
            let columns = "`latitude_deg` and `longitude_deg` (or `x_m` and `y_m`)";
            return Err(table.missing(columns, &["x_m", "y_m"]));
        }
        (Some(_), None, None, None) => return Err(missing("longitude_deg")),
        (None, Some(_), None, None) => return Err(missing("latitude_deg")),
        (None, None, Some(_), None) => return Err(missing("y_m")),
        (None, None, None, Some(_)) => return Err(missing("x_m")),
        _ => {
            let problem = "the header has columns of both kinds of position; \
                           keep `latitude_deg` and `longitude_deg`, or `x_m` and `y_m`";
            return Err(table.wrong_header(problem.to_owned()));
        }
    };
    Ok((id, position))
}

impl PositionColumns {
    /// The position of a row; `None`, and a fault, if its fields are none.
    fn read(&self, row: &Row<'_>, faults: &mut Faults) -> Option<Position> {
        match *self {
            PositionColumns::Geographic(latitude, longitude) => {
                let latitude_deg = row.number(latitude, (-90.0, 90.0), faults);
                let longitude_deg = row.number(longitude, (-180.0, 360.0), faults);
                Some(Position::Geographic { latitude_deg: latitude_deg?, longitude_deg: longitude_deg? })
            }
            PositionColumns::Plane(x, y) => {
                let (x_m, y_m) =
                    (row.number(x, (-LARGEST, LARGEST), faults), row.number(y, (-LARGEST, LARGEST), faults));
                Some(Position::Plane { x_m: x_m?, y_m: y_m? })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "# stations\n\nid,latitude_deg,longitude_deg,name,country\n\
                        10410, 51.4,6.97,\"ESSEN, BREDENEY\",Germany\n# a remark\n03005,60.1,-1.2,LERWICK,United Kingdom\n";

    #[test]
    fn a_good_file_gives_its_stations_with_their_lines() {
        let stations = StationFile::parse(GOOD, "good.csv").unwrap();
        let [first, second] = stations.records() else { panic!("two stations") };
        assert_eq!((first.id.as_str(), first.line), ("10410", 4));
        assert_eq!(first.position, Position::Geographic { latitude_deg: 51.4, longitude_deg: 6.97 });
        assert_eq!(first.fields[3], "ESSEN, BREDENEY");
        assert_eq!((second.id.as_str(), second.line), ("03005", 6));
        assert_eq!(stations.groups(stations.column("country").unwrap()).unwrap(), ["Germany", "United Kingdom"]);
        assert_eq!(stations.column("state"), None);
    }

    #[test]
    fn lines_may_end_as_on_windows_and_begin_with_a_byte_order_mark() {
        let text = format!("\u{feff}{}", GOOD.replace('\n', "\r\n"));
        assert_eq!(StationFile::parse(&text, "good.csv"), StationFile::parse(GOOD, "good.csv"));
    }

    #[test]
    fn a_file_is_the_same_however_its_table_is_written() {
        let remarks = "  # licence\n".repeat(2000);
        for text in [
            "\"id\",\"x_m\",\"y_m\"\n\"a\",1e5,-2\n",
            "\n\nID,X_m,Y_M,,\na,1e5,-2,,\n,,,,\n",
            "\u{feff}x_m,y_m,id\r1e5,-2,a\r",
            "\u{feff}# remark\nid,x_m,y_m\na,1e5,-2",
            &format!("{remarks}id,x_m,y_m\na,1e5,-2"),
        ] {
            let stations = StationFile::parse(text, "plane.csv").unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(stations.records()[0].position, Position::Plane { x_m: 1e5, y_m: -2.0 });
        }
        let earth = "id,lat,lon\na,51,7\n";
        let Position::Geographic { .. } = StationFile::parse(earth, "earth.csv").unwrap().records()[0].position else {
            panic!("on the Earth")
        };
    }

    #[test]
    fn positions_may_be_on_the_plane() {
        let stations = StationFile::parse("id,x_m,y_m\na,1e5,-2\n", "plane.csv").unwrap();
        assert_eq!(stations.records()[0].position, Position::Plane { x_m: 1e5, y_m: -2.0 });
    }

    #[test]
    fn errors_say_where_and_what() {
        let cases = [
            ("id,latitude_deg,longitude_deg\na,1,2\nb,north,2\n", "line 3: `latitude_deg` is `north`"),
            ("id,latitude_deg,longitude_deg\na,NaN,2\n", "line 2: `latitude_deg` is `NaN`"),
            ("id,latitude_deg,longitude_deg\na,91,2\n", "must be a number from -90 to 90"),
            ("id,latitude_deg,longitude_deg\na,1,-200\n", "must be a number from -180 to 360"),
            ("#\nid,x_m,y_m\n\na,inf,2\n", "line 4: `x_m` is `inf`, but must be a finite number"),
            ("#\nid,x_m,y_m\na,1,1\n#\na,2,2\n", "line 5: the station `a` is already on line 3"),
            ("id,x_m,y_m\n,1,1\n", "line 2: the column `id` is empty"),
            ("id,x_m,y_m\na,1\n", "line 2: there are 2 fields, but the header has 3 columns"),
            ("id,x_m,y_m\n\"a,1,1\n", "line 2: a quotation mark is not closed"),
            ("id,x_m,x_m\na,1,1\n", "line 1: the header has two columns `x_m`"),
            ("id,x_m\na,1\n", "line 1: the header has no column `y_m`; it has `id`, `x_m`"),
            ("id,y_m\na,1\n", "no column `x_m`"),
            ("id,latitude_deg\na,1\n", "no column `longitude_deg`"),
            ("id,longitude_deg\na,1\n", "no column `latitude_deg`"),
            ("station,x_m,y_m\na,1,1\n", "no column `id`"),
            ("id,name\na,b\n", "no column `latitude_deg` and `longitude_deg` (or `x_m` and `y_m`)"),
            ("id,x_m,y_m,latitude_deg\na,1,1,1\n", "both kinds of position"),
            ("# nothing\n\n", "bad.csv has no stations"),
            ("id,x_m,y_m\n", "bad.csv has no stations"),
            ("", "bad.csv has no stations"),
        ];
        for (text, expected) in cases {
            let message = StationFile::parse(text, "bad.csv").unwrap_err().to_string();
            assert!(message.contains(expected) && message.contains("bad.csv"), "{text:?} gives: {message}");
        }
    }

    #[test]
    fn no_text_makes_it_panic_and_what_it_accepts_is_sound() {
        let mut accepted = 0;
        for (at, old) in GOOD.char_indices() {
            for new in ["", ",", "\"", "\n", "#", "é", "-", "1e999"] {
                let text = format!("{}{new}{}", &GOOD[..at], &GOOD[at + old.len_utf8()..]);
                for text in [text.as_str(), &text[..at]] {
                    let Ok(stations) = StationFile::parse(text, "mutated.csv") else { continue };
                    accepted += 1;
                    for StationRecord { id, position, fields, .. } in stations.records() {
                        let Position::Geographic { latitude_deg, longitude_deg } = position else { panic!("{text}") };
                        assert!(latitude_deg.abs() <= 90.0 && (-180.0..=360.0).contains(longitude_deg), "{text}");
                        assert!(!id.is_empty() && fields.len() == stations.columns().len(), "{text}");
                    }
                }
            }
        }
        assert!(accepted > 100, "{accepted}");
    }

    #[test]
    fn an_empty_group_is_an_error_with_its_line() {
        let stations = StationFile::parse("id,x_m,y_m,country\na,1,1,X\nb,1,1,\n", "groups.csv").unwrap();
        let message = stations.groups(3).unwrap_err().to_string();
        assert!(message.contains("groups.csv, line 3: the column `country` is empty"), "{message}");
    }
}
