//! `[grid]`: the plane, and its place on the Earth.

use crate::kinds::Domain;
use crate::kinds::models::{self, Model};
use crate::reader::{Absent, AnyKey, Choice, Key, Limits, Read, Section, Whole};
use isobar_model::{Boundary, Grid};
use isobar_obs::Projection;

/// The grid and where on the Earth it lies, if anywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSettings {
    /// The grid.
    pub grid: Grid,
    /// The projection whose centre is the middle of the domain.
    pub projection: Option<Projection>,
}

impl GridSettings {
    /// The plane with a model.
    pub(super) fn domain(&self, model: &Model) -> Domain {
        Domain { grid: self.grid.clone(), projection: self.projection.clone(), model: model.clone() }
    }
}

const SPACING: Limits = Limits::Between(1e-3, 1e4);

/// The most cells in a direction.
const MOST_CELLS: usize = 4096;

const NX: Key<Whole> =
    Key::required("nx", "cells", Whole(1, MOST_CELLS), "columns; at least 4 with models that have neighbours");

const NY: Key<Whole> =
    Key::required("ny", "cells", Whole(1, MOST_CELLS), "rows; at least 4 with models that have neighbours");

const DX_KM: Key<Limits> = Key::required("dx_km", "km", SPACING, "width of a cell from west to east");

const DY_KM: Key<Limits> =
    Key::absent("dy_km", "km", SPACING, Absent::Explained("`dx_km`"), "width of a cell from south to north");

const BOUNDARY: Key<Choice<Boundary>> = Key::required(
    "boundary",
    "",
    Choice(&[("periodic", Boundary::Periodic), ("channel", Boundary::Channel)]),
    "what is at the edges: nothing, as the plane goes round in both directions, or walls in the south and north",
);

const CENTER_LATITUDE: Key<Limits> = Key::absent(
    "center_latitude_deg",
    "degrees north",
    Limits::Between(-90.0, 90.0),
    Absent::Explained("the plane has no place on the Earth"),
    "latitude of the middle of the plane; with `center_longitude_deg`",
);

const CENTER_LONGITUDE: Key<Limits> = Key::absent(
    "center_longitude_deg",
    "degrees east",
    Limits::Between(-180.0, 360.0),
    Absent::Explained("the plane has no place on the Earth"),
    "longitude of the middle of the plane; with `center_latitude_deg`",
);

/// The keys.
pub(super) const KEYS: &[&dyn AnyKey] = &[&NX, &NY, &DX_KM, &DY_KM, &BOUNDARY, &CENTER_LATITUDE, &CENTER_LONGITUDE];

pub(super) fn read(root: &Section<'_>) -> Read<GridSettings> {
    let least = if models::needs_neighbours(root) { 4 } else { 1 };
    let section = root.required("grid")?.section_with(KEYS)?;
    let dx_km = section.get(&DX_KM)?;
    let grid = Grid {
        nx: section.required(NX.name)?.whole(least, MOST_CELLS)?,
        ny: section.required(NY.name)?.whole(least, MOST_CELLS)?,
        dx_m: dx_km * 1e3,
        dy_m: section.find(&DY_KM)?.unwrap_or(dx_km) * 1e3,
        boundary: section.get(&BOUNDARY)?,
    };
    let latitude = section.optional(CENTER_LATITUDE.name);
    let longitude = section.optional(CENTER_LONGITUDE.name);
    let projection =
        match (latitude, longitude) {
            (None, None) => None,
            (Some(latitude), Some(longitude)) => Some(Projection {
                center_latitude_deg: latitude.number(CENTER_LATITUDE.allowed)?,
                center_longitude_deg: longitude.number(CENTER_LONGITUDE.allowed)?,
                false_easting_m: 0.5 * grid.width_m(),
                false_northing_m: 0.5 * grid.height_m(),
            }),
            (Some(alone), None) => {
                return Err(alone
                    .misplaced(format!("`{}` is given alone", alone.title()), "center_longitude_deg belongs with it"));
            }
            (None, Some(alone)) => {
                return Err(alone
                    .misplaced(format!("`{}` is given alone", alone.title()), "center_latitude_deg belongs with it"));
            }
        };
    Ok(GridSettings { grid, projection })
}
