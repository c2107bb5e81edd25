//! The columns of a file of observations, and what a row of them says.

use super::record::{FurtherColumns, Memory, ObservationPlace, ObservationRecord, ValidTime};
use crate::table::{Faults, LARGEST, Row, Table, TableError};
use isobar_model::Time;

/// Columns that are recognised in capitals too, and by synonyms.
pub(super) const KNOWN: &[&str] = &[
    "cycle",
    "time",
    "x_m",
    "y_m",
    "latitude_deg",
    "longitude_deg",
    "column",
    "row",
    "value",
    "variable",
    "sigma",
    "id",
    "group",
];

/// The column of networks.
pub(super) const NETWORK: &str = "network";

/// The last cycle that a file may name, and the last column or row.
const LAST: usize = 1_000_000;

/// Values that usually mark a missing one.
const USUAL_MARKERS: [f64; 12] =
    [-9999.0, -999.0, -99999.0, -999.9, -9999.9, -999.99, -9999.99, -32767.0, -32768.0, 99999.0, 999999.0, 9999999.0];

/// Numbers of the columns.
pub(super) struct Columns {
    cycle: Option<usize>,
    time: Option<usize>,
    place: PlaceColumns,
    value: usize,
    variable: Option<usize>,
    sigma: Option<usize>,
    id: Option<usize>,
    group: Option<usize>,
    report: Option<usize>,
    /// The column of networks, and the one that is read.
    network: Option<(usize, String)>,
    /// With their names.
    predictors: Vec<(usize, String)>,
}

#[derive(Clone, Copy)]
enum PlaceColumns {
    Plane(usize, usize),
    Geographic(usize, usize),
    GridPoint(usize, usize),
}

impl Columns {
    /// Whether a row is of the network that is read, if only one is.
    ///
    /// # Errors
    /// The name of its own.
    pub fn is_read<'a>(&self, row: &'a Row<'_>) -> Result<(), &'a str> {
        match &self.network {
            Some((column, name)) if row.text(*column) != name => Err(row.text(*column)),
            _ => Ok(()),
        }
    }

    /// Whether a row has no value, or no place.
    pub fn is_missing(&self, row: &Row<'_>, markers: Option<&[f64]>) -> bool {
        let (PlaceColumns::Plane(x, y) | PlaceColumns::Geographic(x, y) | PlaceColumns::GridPoint(x, y)) = self.place;
        is_missing_or_marked(row, self.value, markers) || [x, y].iter().any(|column| row.is_missing(*column))
    }

    /// The observation of a row that is not missing; `None`, and its faults, if the fields are not what they must be. Values
    /// that usually mark a missing one are faults unless there are `markers`.
    pub fn record(
        &self,
        row: &Row<'_>,
        markers: Option<&[f64]>,
        memory: &mut Memory,
        faults: &mut Faults,
    ) -> Option<ObservationRecord> {
        let valid = match (self.cycle, self.time) {
            (Some(cycle), _) => row.whole(cycle, LAST, faults).map(ValidTime::Cycle),
            (None, Some(column)) => time(row, column, &mut memory.time, faults).map(ValidTime::Time),
            (None, None) => unreachable!("there is a column for the time"),
        };
        let place = self.place(row, faults);
        let value = number(row, self.value, "value", markers, faults);
        // `Some(None)` without such a column; `None` for a fault.
        let sigma =
            self.sigma.map_or(Some(None), |column| row.number(column, (1.0 / LARGEST, LARGEST), faults).map(Some));
        let Memory { variables, ids, groups, reports, .. } = memory;
        let [id, group, report] =
            [(self.id, ids), (self.group, groups), (self.report, reports)].map(|(column, names)| {
                column.map_or(Some(None), |column| row.name(column, faults).map(|name| Some(names.shared(name))))
            });
        let predictor = |&(column, ref name): &(usize, String)| {
            let is_missing = is_missing_or_marked(row, column, markers);
            if is_missing { Some(None) } else { number(row, column, name, markers, faults).map(Some) }
        };
        let predictors: Vec<Option<Option<f64>>> = self.predictors.iter().map(predictor).collect();
        Some(ObservationRecord {
            line: row.line,
            valid: valid?,
            place: place?,
            variable: self.variable.map(|column| variables.shared(row.text(column))),
            value: value?,
            sigma: sigma?,
            id: id?,
            group: group?,
            report: report?,
            predictors: predictors.into_iter().collect::<Option<_>>()?,
        })
    }

    fn place(&self, row: &Row<'_>, faults: &mut Faults) -> Option<ObservationPlace> {
        match self.place {
            PlaceColumns::Plane(x, y) => {
                let (x_m, y_m) =
                    (row.number(x, (-LARGEST, LARGEST), faults), row.number(y, (-LARGEST, LARGEST), faults));
                Some(ObservationPlace::Plane { x_m: x_m?, y_m: y_m? })
            }
            PlaceColumns::Geographic(latitude, longitude) => {
                let latitude_deg = row.number(latitude, (-90.0, 90.0), faults);
                let longitude_deg = row.number(longitude, (-180.0, 360.0), faults);
                Some(ObservationPlace::Geographic { latitude_deg: latitude_deg?, longitude_deg: longitude_deg? })
            }
            PlaceColumns::GridPoint(column, row_number) => {
                let (column, row) = (row.whole(column, LAST, faults), row.whole(row_number, LAST, faults));
                Some(ObservationPlace::GridPoint { column: column?, row: row? })
            }
        }
    }

    /// The columns of a table.
    ///
    /// # Errors
    /// One that is missing, or two that contradict each other.
    pub fn find(table: &Table<'_>, further: &FurtherColumns) -> Result<Self, TableError> {
        let find = |name| table.find(name);
        let missing = |name: &str| table.missing(&format!("`{name}`"), &[name]);
        let ambiguous = |problem: &str| table.wrong_header(problem.to_owned());
        let (cycle, time) = (find("cycle"), find("time"));
        match (cycle, time) {
            (None, None) => return Err(table.missing("`cycle` (or `time`)", &["time"])),
            (Some(_), Some(_)) => return Err(ambiguous("the header has both `cycle` and `time`; keep one")),
            _ => {}
        }
        let pairs = [("x_m", "y_m"), ("latitude_deg", "longitude_deg"), ("column", "row")];
        let mut places = Vec::new();
        for ((first, second), number) in pairs.into_iter().zip(0..) {
            match (find(first), find(second)) {
                (Some(first), Some(second)) => places.push((number, first, second)),
                (Some(_), None) => return Err(missing(second)),
                (None, Some(_)) => return Err(missing(first)),
                (None, None) => {}
            }
        }
        let place = match places[..] {
            [(0, x, y)] => PlaceColumns::Plane(x, y),
            [(1, latitude, longitude)] => PlaceColumns::Geographic(latitude, longitude),
            [(_, column, row)] => PlaceColumns::GridPoint(column, row),
            [] => {
                let columns = "`x_m` and `y_m` (or `latitude_deg` and `longitude_deg`, or `column` and `row`)";
                return Err(table.missing(columns, &["x_m", "y_m"]));
            }
            _ => return Err(ambiguous("the header has several kinds of position; keep one")),
        };
        let value = find("value").ok_or_else(|| missing("value"))?;
        let named = |name: &String| table.find(name).ok_or_else(|| missing(name));
        let with_name = |name: &String| Ok((named(name)?, name.clone()));
        Ok(Self {
            cycle,
            time,
            place,
            value,
            variable: find("variable"),
            sigma: find("sigma"),
            id: find("id"),
            group: further.group_by.as_ref().map(named).transpose()?,
            report: further.report_by.as_ref().map(named).transpose()?,
            network: further.network.clone().map(|name| Ok((named(&NETWORK.to_owned())?, name))).transpose()?,
            predictors: further.predictors.iter().map(with_name).collect::<Result<_, TableError>>()?,
        })
    }
}

/// Whether a field says that there is no number, in words or by a marker.
fn is_missing_or_marked(row: &Row<'_>, column: usize, markers: Option<&[f64]>) -> bool {
    let markers = markers.unwrap_or_default();
    let is_marked = |number: f64| markers.contains(&number);
    row.is_missing(column) || !markers.is_empty() && row.text(column).parse().is_ok_and(is_marked)
}

/// The time in a column: that of the row before, if it is written the same way.
fn time(row: &Row<'_>, column: usize, last: &mut Option<(String, Time)>, faults: &mut Faults) -> Option<Time> {
    match last {
        Some((text, time)) if text == row.text(column) => Some(*time),
        _ => {
            let time = row.time(column, faults)?;
            *last = Some((row.text(column).to_owned(), time));
            Some(time)
        }
    }
}

/// The number in a column that may have markers of missing numbers; `None`, and a fault, if the field is not a number, or if it
/// usually marks a missing one and no `markers` are given.
fn number(row: &Row<'_>, column: usize, name: &str, markers: Option<&[f64]>, faults: &mut Faults) -> Option<f64> {
    let number = row.number(column, (-LARGEST, LARGEST), faults);
    if let Some(number) = number.filter(|number| markers.is_none() && USUAL_MARKERS.contains(number)) {
        let key = format!("`missing = [{number}]` for the network if it is, `missing = []` if not");
        faults.add(row.line, format!("`{name}` is {number}, which usually marks a missing value: give {key}"));
    }
    number
}
