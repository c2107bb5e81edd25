//! States from netCDF files, of version 3 or 4: fields on the grid, by name or by the standard names of the CF conventions.

use super::attributes::{TimeUnits, metres, plain_unit, text};
use crate::calendar::utc;
use crate::reader::{Field, Read, files};
use crate::text::{clean, clean_lines, listed};
use isobar_model::{Layout, Time, Variable};
use isobar_obs::table::LARGEST;
use netcdf_reader::{NcFile, NcSliceInfo, NcSliceInfoElem, NcVariable};
use std::collections::BTreeMap;
use std::fmt::{self, Debug, Formatter};
use std::sync::Arc;

/// How far coordinates may be from those of the grid, in cells.
const NEAR: f64 = 1e-3;

/// A netCDF file that has all variables of a model's state, perhaps at several times.
pub(crate) struct StateFile {
    file: NcFile,
    layout: Arc<Layout>,
    /// The variables of the file, in the order of the layout's.
    names: Vec<String>,
    /// The times of its states, ascending; `None` if it has one state without a time.
    times: Option<Times>,
}

impl Debug for StateFile {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "the states of {:?} in a netCDF file", self.names)
    }
}

struct Times {
    /// The dimension.
    dimension: String,
    /// At least one.
    valid: Vec<Time>,
}

impl Times {
    /// The number of a time.
    fn number(&self, time: Time) -> Result<usize, String> {
        self.valid.binary_search(&time).map_err(|_| {
            let [first, last] = [self.valid[0], self.valid[self.valid.len() - 1]].map(utc);
            format!("it has no state at {}; its {} times are from {first} to {last}", utc(time), self.valid.len())
        })
    }
}

impl StateFile {
    /// Opens the file that a key names. `names` are those of variables in the file by those of the layout; others are found by
    /// the same name, or else by their standard name.
    pub fn open(field: &Field<'_>, layout: Arc<Layout>, names: &BTreeMap<String, String>) -> Read<Self> {
        let bytes = files::read_bytes(field, "netCDF file")?;
        let shown = clean(&field.text()?);
        let fault = |problem: String| field.invalid(clean_lines(&format!("{shown}: {problem}")), "cannot be used");
        let file = NcFile::from_vec(bytes).map_err(|error| fault(error.to_string()))?;
        Self::of(file, layout, names).map_err(fault)
    }

    fn of(file: NcFile, layout: Arc<Layout>, names: &BTreeMap<String, String>) -> Result<Self, String> {
        let found =
            layout.variables.iter().map(|variable| find(&file, variable, names)).collect::<Result<Vec<_>, _>>()?;
        let mut times: Option<Times> = None;
        for (number, (variable, name)) in layout.variables.iter().zip(&found).enumerate() {
            let field = file.variable(name).map_err(|error| error.to_string())?;
            check_unit(field, variable)?;
            check_grid(&file, field, &layout, variable)?;
            let dimension = time_dimension(&file, field)?;
            match (&times, dimension) {
                (None, Some(dimension)) if number == 0 => {
                    let valid = valid_times(&file, &dimension)?;
                    times = Some(Times { dimension, valid });
                }
                (Some(times), Some(dimension)) if times.dimension == dimension => {}
                (None, None) => {}
                _ => return Err(format!("`{}` and `{name}` are not of the same times", found[0])),
            }
        }
        Ok(Self { file, layout, names: found, times })
    }

    /// The layout of its states.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// The times of its states; `None` if it has one state without a time.
    pub fn times(&self) -> Option<&[Time]> {
        self.times.as_ref().map(|times| times.valid.as_slice())
    }

    /// The values of the state at a time, `[variable, y, x]`; of a file without times those that it has.
    ///
    /// # Errors
    /// There is no state at this time; a value is missing, or not finite.
    pub fn values(&self, time: Option<Time>) -> Result<Vec<f64>, String> {
        let record = match (&self.times, time) {
            (Some(times), Some(time)) => times.number(time)?,
            _ => 0,
        };
        let mut values = Vec::with_capacity(self.layout.len());
        for name in &self.names {
            values.extend(self.field(name, record)?);
        }
        Ok(values)
    }

    fn field(&self, name: &str, record: usize) -> Result<Vec<f64>, String> {
        let variable = self.file.variable(name).map_err(|error| error.to_string())?;
        let dimensions = variable.dimensions();
        let is_time = |name: &str| self.times.as_ref().is_some_and(|times| times.dimension == name);
        let selection = dimensions.iter().enumerate().map(|(number, dimension)| {
            if number + 2 >= dimensions.len() {
                NcSliceInfoElem::Slice { start: 0, end: u64::MAX, step: 1 }
            } else {
                NcSliceInfoElem::Index(if is_time(&dimension.name) { record as u64 } else { 0 })
            }
        });
        let selection = NcSliceInfo { selections: selection.collect() };
        let values =
            self.file.read_variable_slice_unpacked_masked(name, &selection).map_err(|error| error.to_string())?;
        let values: Vec<f64> = values.iter().copied().collect();
        let grid = &self.layout.grid;
        if values.len() != grid.cells() {
            return Err(format!("`{name}` has {} values at a time, but the grid has {}", values.len(), grid.cells()));
        }
        // Beyond what any number may be are netCDF's own fill values, which a variable need not name.
        if let Some(cell) = values.iter().position(|value| value.is_nan() || value.abs() > LARGEST) {
            let (column, row) = (cell % grid.nx + 1, cell / grid.nx + 1);
            let at = self.times.as_ref().map_or(String::new(), |times| format!(" at {}", utc(times.valid[record])));
            return Err(format!("`{name}` has no value{at} in column {column}, row {row} of the grid"));
        }
        Ok(values)
    }
}

/// The name in the file of a variable.
fn find(file: &NcFile, variable: &Variable, names: &BTreeMap<String, String>) -> Result<String, String> {
    let all = file.variables().map_err(|error| error.to_string())?;
    let fields = || {
        let names: Vec<String> = all.iter().filter(|it| it.ndim() >= 2).map(|it| clean(it.name())).collect();
        if names.is_empty() { "none".to_string() } else { listed(names.iter().map(String::as_str)) }
    };
    let wanted = variable.name;
    if let Some(name) = names.get(wanted) {
        let is_there = all.iter().any(|it| it.name() == name);
        return if is_there {
            Ok(name.clone())
        } else {
            Err(format!("it has no variable `{}`; its fields are {}", clean(name), fields()))
        };
    }
    if all.iter().any(|it| it.name() == wanted) {
        return Ok(wanted.to_string());
    }
    let by_standard_name: Vec<&NcVariable> = match variable.standard_name {
        Some(standard_name) => {
            let is_it = |it: &&NcVariable| text(it, "standard_name").is_some_and(|name| name == standard_name);
            all.iter().filter(is_it).collect()
        }
        None => Vec::new(),
    };
    match by_standard_name.as_slice() {
        [only] => Ok(only.name().to_string()),
        several => {
            let named =
                variable.standard_name.map_or(String::new(), |name| format!(", and none of standard name {name}"));
            let problem = if several.is_empty() {
                format!("it has no variable `{wanted}`{named}; its fields are {}", fields())
            } else {
                let names: Vec<String> = several.iter().map(|it| clean(it.name())).collect();
                format!("for `{wanted}` it has {}", listed(names.iter().map(String::as_str)))
            };
            Err(format!("{problem}: give `variables = {{ {wanted} = \"…\" }}`"))
        }
    }
}

/// Refuses another unit than the variable's; a file need not say it.
fn check_unit(field: &NcVariable, variable: &Variable) -> Result<(), String> {
    let Some(unit) = text(field, "units") else { return Ok(()) };
    if plain_unit(&unit) == plain_unit(variable.unit) {
        return Ok(());
    }
    Err(format!("`{}` is in `{}`, but must be in {}", clean(field.name()), clean(&unit), variable.unit))
}

/// Refuses fields that are not on the grid.
fn check_grid(file: &NcFile, field: &NcVariable, layout: &Layout, variable: &Variable) -> Result<(), String> {
    let (grid, location, name) = (&layout.grid, variable.location, clean(field.name()));
    let dimensions = field.dimensions();
    let [.., rows, columns] = dimensions else {
        return Err(format!(
            "`{name}` has {} dimensions, but must be a field, (y, x) or (time, y, x)",
            dimensions.len()
        ));
    };
    if (rows.size, columns.size) != (grid.ny as u64, grid.nx as u64) {
        return Err(format!(
            "`{name}` is of {} × {} points, but the grid of {} × {}: isobar does not interpolate fields",
            columns.size, rows.size, grid.nx, grid.ny
        ));
    }
    let x: Vec<f64> = (0..grid.nx).map(|i| grid.x_m(location, i)).collect();
    let y: Vec<f64> = (0..grid.ny).map(|j| grid.y_m(location, j)).collect();
    for (dimension, wanted, cell_m) in [(columns, x, grid.dx_m), (rows, y, grid.dy_m)] {
        let Ok(coordinate) = file.variable(&dimension.name) else { continue };
        let unit = text(coordinate, "units");
        let unit = unit.as_deref().map(str::trim);
        let scale = match (unit, unit.and_then(metres)) {
            (_, Some(scale)) => scale,
            (Some(unit), None) if unit.to_ascii_lowercase().starts_with("degree") => {
                return Err(format!(
                    "`{name}` is on latitudes and longitudes (`{}` in {}), but must be on the grid of the plane",
                    clean(&dimension.name),
                    clean(unit)
                ));
            }
            _ => continue,
        };
        let found = file.read_variable_as_f64(&dimension.name).map_err(|error| error.to_string())?;
        for (number, (found, wanted)) in found.iter().zip(&wanted).enumerate() {
            let found = found * scale;
            if (found - wanted).abs() > NEAR * cell_m || !found.is_finite() {
                return Err(format!(
                    "`{name}` is not on the grid: `{}` is {found} m at its point {}, and {wanted} m in the grid",
                    clean(&dimension.name),
                    number + 1
                ));
            }
        }
    }
    Ok(())
}

/// The dimension of times among those before rows and columns, of which all others have one value.
fn time_dimension(file: &NcFile, field: &NcVariable) -> Result<Option<String>, String> {
    let dimensions = field.dimensions();
    let mut found = None;
    for dimension in &dimensions[..dimensions.len() - 2] {
        let units = file.variable(&dimension.name).ok().and_then(|coordinate| text(coordinate, "units"));
        if found.is_none() && units.is_some_and(|units| units.contains(" since ")) {
            found = Some(dimension.name.clone());
        } else if dimension.size != 1 {
            return Err(format!(
                "`{}` has a dimension `{}` of {}, which is not of times: choose one of them, and write it to another file",
                clean(field.name()),
                clean(&dimension.name),
                dimension.size
            ));
        }
    }
    Ok(found)
}

/// The valid times of a dimension.
fn valid_times(file: &NcFile, dimension: &str) -> Result<Vec<Time>, String> {
    let variable = file.variable(dimension).map_err(|error| error.to_string())?;
    let (units, name) = (TimeUnits::of(variable)?, clean(dimension));
    let values = file.read_variable_as_f64(dimension).map_err(|error| error.to_string())?;
    let mut valid: Vec<Time> = Vec::with_capacity(values.len());
    for &value in &values {
        let time = units.time(value);
        let time =
            time.ok_or_else(|| format!("`{name}` has the value {value}, which is not a whole number of seconds"))?;
        if valid.last().is_some_and(|last| *last >= time) {
            return Err(format!("the times of `{name}` do not ascend at {}", utc(time)));
        }
        valid.push(time);
    }
    if valid.is_empty() {
        return Err(format!("`{name}` has no times"));
    }
    Ok(valid)
}
