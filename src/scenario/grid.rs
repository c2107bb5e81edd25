//! `[grid]`: the plane, and its place on the Earth.

use crate::kinds::models;
use crate::reader::{Limits, Read, Section};
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

pub(super) fn read(root: &Section<'_>) -> Read<GridSettings> {
    const KEYS: &[&str] = &["nx", "ny", "dx_km", "dy_km", "boundary", "center_latitude_deg", "center_longitude_deg"];
    const SPACING: Limits = Limits::Between(1e-3, 1e4);
    let least = if models::needs_neighbours(root) { 4 } else { 1 };
    let section = root.required("grid")?.section(KEYS)?;
    let dx_km = section.number("dx_km", SPACING)?;
    let grid = Grid {
        nx: section.required("nx")?.whole(least, 4096)?,
        ny: section.required("ny")?.whole(least, 4096)?,
        dx_m: dx_km * 1e3,
        dy_m: section.number_or("dy_km", dx_km, SPACING)? * 1e3,
        boundary: section
            .required("boundary")?
            .choice(&[("periodic", Boundary::Periodic), ("channel", Boundary::Channel)])?,
    };
    let latitude = section.optional("center_latitude_deg");
    let longitude = section.optional("center_longitude_deg");
    let projection =
        match (latitude, longitude) {
            (None, None) => None,
            (Some(latitude), Some(longitude)) => Some(Projection {
                center_latitude_deg: latitude.number(Limits::Between(-90.0, 90.0))?,
                center_longitude_deg: longitude.number(Limits::Between(-180.0, 360.0))?,
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
