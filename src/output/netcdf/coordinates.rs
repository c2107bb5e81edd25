//! What the netCDF files have in common: global attributes, time, the staggered grid and its place on the Earth, and
//! the calibration parameters.

use super::file::{Definition, FILL_VALUE, Values, Variable};
use crate::event::RunInfo;
use isobar_model::{Layout, Location};
use isobar_obs::projection::EARTH_RADIUS_M;
use isobar_obs::{Calibration, Projection};

/// Name of the grid-mapping variable.
pub const GRID_MAPPING: &str = "lambert_azimuthal_equal_area";

/// The attributes that every file has.
pub fn add_global_attributes(definition: &mut Definition, info: &RunInfo, content: &str) {
    let version = env!("CARGO_PKG_VERSION");
    definition.attribute("Conventions", "CF-1.8");
    definition.attribute("title", format!("{}: {content}", info.title));
    let recorded = info.networks.iter().filter(|network| network.is_recorded).map(|network| &*network.name);
    let data = match recorded.collect::<Vec<_>>() {
        recorded if recorded.is_empty() => None,
        recorded => Some(format!("recorded observations: {}", recorded.join(", "))),
    };
    let truth = info.truth_file.as_ref().map(|file| format!("truth: the states of {file}"));
    let data: Vec<String> = truth.into_iter().chain(data).collect();
    let data = if data.is_empty() { "all data are synthetic".to_string() } else { data.join("; ") };
    definition.attribute("source", format!("isobar {version}, a data-assimilation testbed; {data}"));
    definition.attribute(
        "history",
        format!("written by isobar {version} from scenario {} with seed {}", info.scenario, info.seed),
    );
    definition.attribute("references", env!("CARGO_PKG_REPOSITORY"));
    definition.attribute("scenario", info.scenario.as_str());
    definition.attribute("seed", info.seed.to_string());
    definition.attribute("scenario_text", info.scenario_text.as_str());
}

/// Attributes of a variable of valid times.
pub fn time(variable: Variable) -> Variable {
    variable
        .with("standard_name", "time")
        .with("long_name", "valid time")
        .with("units", "seconds since 1970-01-01 00:00:00")
        .with("calendar", "standard")
        .with("axis", "T")
}

/// Attributes of a variable of x on the plane.
pub fn x(variable: Variable, long_name: &str) -> Variable {
    variable.with("standard_name", "projection_x_coordinate").with("long_name", long_name).with("units", "m")
}

/// Attributes of a variable of y on the plane.
pub fn y(variable: Variable, long_name: &str) -> Variable {
    variable.with("standard_name", "projection_y_coordinate").with("long_name", long_name).with("units", "m")
}

/// The unlimited dimension `time` and its coordinate.
pub fn add_time(definition: &mut Definition) {
    definition.record_dimension("time");
    definition.record(time(Variable::new("time", &[])));
}

/// The dimensions (y, x) of a variable at `location`: faces have coordinates of their own.
pub fn dimensions(location: Location) -> [&'static str; 2] {
    match location {
        Location::Center => ["y", "x"],
        Location::XFace => ["y", "x_u"],
        Location::YFace => ["y_v", "x"],
        Location::Corner => ["y_v", "x_u"],
    }
}

/// Names of latitude and longitude of the points at `location`.
fn geographic(location: Location) -> [&'static str; 2] {
    match location {
        Location::Center => ["latitude", "longitude"],
        Location::XFace => ["latitude_u", "longitude_u"],
        Location::YFace => ["latitude_v", "longitude_v"],
        Location::Corner => ["latitude_q", "longitude_q"],
    }
}

/// The coordinates of all places in the cell at which variables live.
///
/// Where the plane has a place on the Earth, only cell centres are related to it by the grid mapping: checkers of the
/// conventions hold that it applies to exactly one variable of each standard name. Faces have latitudes and
/// longitudes, as centres do.
pub fn add_grid(definition: &mut Definition, layout: &Layout, projection: Option<&Projection>) {
    let grid = &layout.grid;
    if let Some(projection) = projection {
        add_grid_mapping(definition, projection);
    }
    for location in [Location::Center, Location::XFace, Location::YFace, Location::Corner] {
        if location != Location::Center && layout.variables.iter().all(|variable| variable.location != location) {
            continue;
        }
        let [rows, columns] = dimensions(location);
        let ys = (0..grid.ny).map(|j| grid.y_m(location, j)).collect();
        add_axis(definition, rows, y, ys, projection.is_some());
        let xs = (0..grid.nx).map(|i| grid.x_m(location, i)).collect();
        add_axis(definition, columns, x, xs, projection.is_some());
        if let Some(projection) = projection {
            let places = (0..grid.cells())
                .map(|cell| projection.inverse(grid.x_m(location, cell % grid.nx), grid.y_m(location, cell / grid.nx)));
            let names = geographic(location);
            add_places(definition, names, &[rows, columns], places.collect());
        }
    }
}

/// A dimension of the grid and its coordinate, unless they are there.
fn add_axis(
    definition: &mut Definition,
    name: &str,
    attributes: fn(Variable, &str) -> Variable,
    values: Vec<f64>,
    projected: bool,
) {
    if definition.has_variable(name) {
        return;
    }
    let (axis, long_name) = match name {
        "y" => ("Y", "y of cell centres"),
        "x" => ("X", "x of cell centres"),
        "y_v" => ("Y", "y of the cells' southern faces, on the plane of y"),
        _ => ("X", "x of the cells' western faces, on the plane of x"),
    };
    definition.dimension(name, values.len());
    let variable = Variable::new(name, &[name]);
    let variable = if projected && name.len() > 1 {
        variable.with("long_name", long_name).with("units", "m")
    } else {
        attributes(variable, long_name)
    };
    definition.fixed(variable.with("axis", axis), Values::Numbers(values));
}

/// The grid-mapping variable.
pub fn add_grid_mapping(definition: &mut Definition, projection: &Projection) {
    let variable = Variable::new(GRID_MAPPING, &[])
        .with("grid_mapping_name", GRID_MAPPING)
        .with("latitude_of_projection_origin", projection.center_latitude_deg)
        .with("longitude_of_projection_origin", projection.center_longitude_deg)
        .with("false_easting", projection.false_easting_m)
        .with("false_northing", projection.false_northing_m)
        .with("earth_radius", EARTH_RADIUS_M);
    definition.fixed(variable, Values::Integers(vec![0]));
}

/// Latitude and longitude of points; missing where the plane leaves the sphere.
pub fn add_places(
    definition: &mut Definition,
    [latitude, longitude]: [&str; 2],
    dimensions: &[&str],
    places: Vec<Option<(f64, f64)>>,
) {
    let fill = places.contains(&None).then_some(FILL_VALUE);
    let (latitudes, longitudes) = places.into_iter().map(|place| place.unwrap_or((FILL_VALUE, FILL_VALUE))).unzip();
    for (name, standard_name, unit, values) in
        [(latitude, "latitude", "degrees_north", latitudes), (longitude, "longitude", "degrees_east", longitudes)]
    {
        let variable = Variable::new(name, dimensions)
            .with("standard_name", standard_name)
            .with("long_name", standard_name)
            .with("units", unit)
            .with_some("_FillValue", fill);
        definition.fixed(variable, Values::Numbers(values));
    }
}

/// A record variable on the grid, without standard name.
pub fn field(name: &str, long_name: &str, unit: &str, location: Location, projected: bool) -> Variable {
    Variable::new(name, &dimensions(location))
        .with("long_name", long_name)
        .with("units", unit)
        .with_some("coordinates", projected.then(|| geographic(location).join(" ")))
        .with_some("grid_mapping", (projected && location == Location::Center).then_some(GRID_MAPPING))
        .with("_FillValue", FILL_VALUE)
}

/// The dimension of the calibration parameters, with their names and units.
pub fn add_parameters(definition: &mut Definition, calibration: &Calibration) {
    definition.dimension("parameter", calibration.len());
    let names = calibration.parameters.iter().map(|parameter| parameter.name.as_str());
    let variable = Variable::new("parameter_name", &[]).with("long_name", "name of the calibration parameter");
    definition.texts(variable, "parameter", names);
    let units = calibration.parameters.iter().map(|parameter| parameter.unit.as_str());
    let variable = Variable::new("parameter_unit", &[]).with("long_name", "unit of the calibration parameter");
    definition.texts(variable, "parameter", units);
}

/// A record variable of the calibration parameters. Its attribute `units` is there if they share one.
pub fn parameters(name: &str, long_name: &str, calibration: &Calibration) -> Variable {
    let unit = common(calibration.parameters.iter().map(|parameter| parameter.unit.as_str()));
    let elsewhere = "each parameter has the unit that parameter_unit says";
    Variable::new(name, &["parameter"])
        .with("long_name", long_name)
        .with_some("units", unit)
        .with_some("comment", unit.is_none().then_some(elsewhere))
        .with("coordinates", "parameter_name parameter_unit")
        .with("_FillValue", FILL_VALUE)
}

/// The text that all have in common, if they do.
pub fn common<'a>(mut texts: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let first = texts.next()?;
    texts.all(|text| text == first).then_some(first)
}

/// A name that is good for files and netCDF variables: letters, digits and `_` only, and `keep`.
pub fn safe_name(name: &str, keep: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() || keep.contains(c) { c } else { '_' };
    name.chars().map(safe).collect()
}
