//! Observations from netCDF files: a variable for each column of the table that they would be in CSV, along one dimension.

use super::attributes::{TimeUnits, metres, plain_unit, text};
use crate::calendar::utc;
use crate::reader::{Field, Read, files};
use crate::text::{clean, clean_lines, listed};
use isobar_obs::table::LARGEST;
use isobar_obs::{FurtherColumns, ObservationFile, Projection};
use netcdf_reader::{NcFile, NcType, NcVariable};

/// The most observations of a file.
const MOST_ROWS: u64 = 5_000_000;

/// The most bytes of a variable of text.
const MOST_TEXT: u64 = 200_000_000;

/// What observations must fit to.
pub(crate) struct Plane<'a> {
    /// Where the plane lies on the Earth, if anywhere.
    pub projection: Option<&'a Projection>,
    /// The model's variables with their units.
    pub variables: &'a [(&'static str, &'static str)],
    /// The variable of observations that do not say it.
    pub only: Option<&'a str>,
}

/// The observations of a file that a key names: `further` columns are read beside those of all files.
///
/// Variables have the names of the columns in CSV (`x` and `y` are those of metres on the plane, as well). Numbers may be packed,
/// and where they have a fill value they are missing; `time` is in the units of the CF conventions, or text. What would
/// contradict each other in CSV may stand side by side: of `cycle` and `time` the time is read, since cycles are counted from
/// the start of another run; of places on the plane and on the Earth those on the plane, if the grid mapping of `value` says that
/// it is the same one.
pub(crate) fn observations(
    field: &Field<'_>,
    plane: &Plane<'_>,
    markers: Option<&[f64]>,
    further: FurtherColumns,
) -> Read<ObservationFile> {
    let bytes = files::read_bytes(field, "file of observations")?;
    let name = field.text()?;
    let refused = |problem: String| field.invalid(clean_lines(&problem), "this file");
    let fault = |problem: String| refused(format!("{name}: {problem}"));
    let file = NcFile::from_vec(bytes).map_err(|error| fault(error.to_string()))?;
    let Columns { names, fields } = Columns::read(&file, plane, &further).map_err(fault)?;
    let rows = fields.first().map_or(0, Vec::len);
    let mut columns: Vec<_> = fields.into_iter().map(Vec::into_iter).collect();
    let row = |_| columns.iter_mut().map(|column| column.next().unwrap_or_default()).collect();
    let rows: Vec<Vec<String>> = (0..rows).map(row).collect();
    ObservationFile::of_rows(names, rows, &name, markers, further).map_err(|error| refused(error.to_string()))
}

/// Columns of fields as they would be written in a table of text.
struct Columns {
    /// The names of all; those that are not read come last.
    names: Vec<String>,
    fields: Vec<Vec<String>>,
}

impl Columns {
    fn read(file: &NcFile, plane: &Plane<'_>, further: &FurtherColumns) -> Result<Self, String> {
        let all = file.variables().map_err(|error| error.to_string())?;
        let of_value = all.iter().find(|variable| variable.name() == "value").ok_or_else(|| {
            let names: Vec<String> = all.iter().map(|variable| clean(variable.name())).collect();
            format!("it has no variable `value`; its variables are {}", listed(names.iter().map(String::as_str)))
        })?;
        let [dimension] = of_value.dimensions() else {
            let count = of_value.ndim();
            return Err(format!("`value` has {count} dimensions, but must have one, that of the observations"));
        };
        if dimension.size > MOST_ROWS {
            return Err(format!("it has {} observations, more than the {MOST_ROWS} allowed", dimension.size));
        }
        let own = all.iter().filter(|it| it.dimensions().first().is_some_and(|first| first.name == dimension.name));
        let own = own.filter(|it| it.ndim() == 1 && *it.dtype() != NcType::Char || is_text(it));
        let mut own: Vec<(String, &NcVariable)> = own.map(|it| (column_name(it, all), it)).collect();
        let has = |name: &str| own.iter().any(|(own, _)| own == name);
        let mut left_out: Vec<&str> = Vec::new();
        if has("time") {
            left_out.push("cycle");
        }
        left_out.extend(other_place(file, of_value, plane, &own)?);
        own.retain(|(name, _)| !left_out.contains(&ObservationFile::known_name(name).unwrap_or(name)));
        let is_read = |name: &str| name == UNIT || ObservationFile::reads(name, further);
        let (read, others): (Vec<_>, Vec<_>) = own.into_iter().partition(|(name, _)| is_read(name));
        let mut columns = Self { names: Vec::new(), fields: Vec::new() };
        for (name, variable) in read {
            let fields = fields(file, variable, &name)?;
            columns.fields.push(fields);
            columns.names.push(name);
        }
        columns.check_units(text(of_value, "units"), plane)?;
        columns.names.extend(others.into_iter().map(|(name, _)| name));
        Ok(columns)
    }

    fn find(&self, name: &str) -> Option<&Vec<String>> {
        Some(&self.fields[self.names.iter().position(|own| own == name)?])
    }

    /// Refuses values in another unit than that of their variable; a file need not say it.
    fn check_units(&self, common: Option<String>, plane: &Plane<'_>) -> Result<(), String> {
        let (units, variables) = (self.find(UNIT), self.find("variable"));
        let rows = self.fields.first().map_or(0, Vec::len);
        for row in 0..rows {
            let unit = units.map(|units| &units[row]).or(common.as_ref());
            let name = variables.map(|names| names[row].as_str()).or(plane.only);
            let Some((unit, name)) = unit.zip(name) else { continue };
            let right = plane.variables.iter().find(|(own, _)| *own == name).map(|(_, unit)| *unit);
            // Most files name the unit as it is here: then nothing is rewritten for each row.
            if let Some(right) = right.filter(|right| unit != right && plain_unit(unit) != plain_unit(right)) {
                let (row, unit) = (row + 1, clean(unit));
                return Err(format!("row {row}: `value` is in `{unit}`, but {name} must be in {right}"));
            }
        }
        Ok(())
    }
}

/// The column of units, which isobar writes.
const UNIT: &str = "unit";

/// Whether a variable is text: of strings, or of characters with their number as a second dimension.
fn is_text(variable: &NcVariable) -> bool {
    match variable.dtype() {
        NcType::String => variable.ndim() == 1,
        NcType::Char => variable.ndim() == 2,
        _ => false,
    }
}

/// The column that a variable is.
fn column_name(variable: &NcVariable, all: &[NcVariable]) -> String {
    let has = |name: &str| all.iter().any(|it| it.name() == name);
    match variable.name() {
        "x" if !has("x_m") => "x_m".into(),
        "y" if !has("y_m") => "y_m".into(),
        name => name.into(),
    }
}

/// The columns of a second kind of place, which are not read.
fn other_place(
    file: &NcFile,
    value: &NcVariable,
    plane: &Plane<'_>,
    own: &[(String, &NcVariable)],
) -> Result<&'static [&'static str], String> {
    const ON_PLANE: [&str; 2] = ["x_m", "y_m"];
    const ON_EARTH: [&str; 2] = ["latitude_deg", "longitude_deg"];
    let has = |names: &[&str]| {
        names.iter().all(|name| own.iter().any(|(own, _)| ObservationFile::known_name(own) == Some(name)))
    };
    if !has(&ON_PLANE) {
        return Ok(&[]);
    }
    match (mapping(file, value, plane.projection), plane.projection) {
        (Mapping::Same, _) | (Mapping::None, None) => Ok(&ON_EARTH),
        (Mapping::None, Some(_)) if has(&ON_EARTH) => Ok(&ON_PLANE),
        (Mapping::None, Some(_)) => Ok(&[]),
        (Mapping::Other(name), _) => Err(format!(
            "its x and y are on another plane than that of the scenario, by `{}`: of such a file take x and y away, and of \
             winds along the axes of that plane u and v",
            clean(&name)
        )),
    }
}

/// On which plane places are, by the grid mapping of the values.
enum Mapping {
    /// The file does not say it.
    None,
    /// On that of the scenario.
    Same,
    /// On another one, which the variable of this name says.
    Other(String),
}

fn mapping(file: &NcFile, value: &NcVariable, projection: Option<&Projection>) -> Mapping {
    let Some(name) = text(value, "grid_mapping") else { return Mapping::None };
    let Ok(variable) = file.variable(&name) else { return Mapping::Other(name) };
    let is = |attribute: &str, right: f64, near: f64| {
        let found = variable.attribute(attribute).and_then(|attribute| attribute.value.as_f64());
        found.is_some_and(|found| (found - right).abs() <= near)
    };
    let is_same = |own: &Projection| {
        text(variable, "grid_mapping_name").is_some_and(|name| name == "lambert_azimuthal_equal_area")
            && is("latitude_of_projection_origin", own.center_latitude_deg, 1e-9)
            && is("longitude_of_projection_origin", own.center_longitude_deg, 1e-9)
            && is("false_easting", own.false_easting_m, 1e-3)
            && is("false_northing", own.false_northing_m, 1e-3)
    };
    if projection.is_some_and(is_same) { Mapping::Same } else { Mapping::Other(name) }
}

/// The fields of a column.
fn fields(file: &NcFile, variable: &NcVariable, column: &str) -> Result<Vec<String>, String> {
    let name = variable.name();
    if is_text(variable) {
        let bytes = variable.dimensions().iter().map(|dimension| dimension.size).fold(1, u64::saturating_mul);
        if bytes > MOST_TEXT {
            return Err(format!("`{}` has more than {} MB of text", clean(name), MOST_TEXT / 1_000_000));
        }
        let texts = file.read_variable_as_strings(name).map_err(|error| error.to_string())?;
        return Ok(texts.into_iter().map(|text| text.trim().to_string()).collect());
    }
    let numbers = file.read_variable_unpacked_masked(name).map_err(|error| error.to_string())?;
    let default = default_fill(variable);
    let is_missing = |value: f64| value.is_nan() || value.abs() > LARGEST || Some(value) == default;
    if column == "time" {
        let units = TimeUnits::of(variable)?;
        let shown = text(variable, "units").unwrap_or_default();
        let time = |&value: &f64| match units.time(value) {
            _ if is_missing(value) => String::new(),
            Some(time) => utc(time),
            None => format!("{value} {shown}"),
        };
        return Ok(numbers.iter().map(time).collect());
    }
    let unit = text(variable, "units");
    let scale = match (ObservationFile::known_name(column), unit.as_deref()) {
        (Some("x_m" | "y_m"), Some(unit)) => metres(unit).ok_or_else(|| {
            format!("`{}` is in `{}`, but places on the plane must be in m or km", clean(name), clean(unit))
        })?,
        (Some("latitude_deg" | "longitude_deg"), Some(unit)) if !unit.trim().starts_with("deg") => {
            return Err(format!("`{}` is in `{}`, but must be in degrees", clean(name), clean(unit)));
        }
        _ => 1.0,
    };
    let number = |&value: &f64| if is_missing(value) { String::new() } else { (value * scale).to_string() };
    Ok(numbers.iter().map(number).collect())
}

/// The number that netCDF itself puts where nothing was written, for integers; those of other types are beyond any number.
fn default_fill(variable: &NcVariable) -> Option<f64> {
    match variable.dtype() {
        _ if variable.attribute("scale_factor").is_some() => None,
        NcType::Short => Some(-32767.0),
        NcType::Int => Some(-2_147_483_647.0),
        _ => None,
    }
}
