//! What a run's maps show of the Earth.

use crate::event::RunInfo;
use crate::plot::{coast, graticule};
use isobar_obs::Projection;

/// The coastlines within the plane, as their points (x, y) \[m\]; empty if the plane has no place on the Earth.
pub fn coastlines(info: &RunInfo) -> Vec<Vec<[f64; 2]>> {
    on_earth(info, |extent_m, place| coast::lines(extent_m, place))
}

/// The parallels and meridians within the plane; empty if it has no place on the Earth.
pub fn graticule(info: &RunInfo) -> Vec<graticule::Line> {
    on_earth(info, |extent_m, place| graticule::lines(extent_m, place))
}

/// Lines by a function of the size of the plane and of the place of a latitude and longitude.
fn on_earth<T>(info: &RunInfo, of: impl Fn([f64; 2], &dyn Fn(f64, f64) -> Option<(f64, f64)>) -> Vec<T>) -> Vec<T> {
    let extent_m = [info.layout.grid.width_m(), info.layout.grid.height_m()];
    let lines = |projection: &Projection| of(extent_m, &|latitude, longitude| projection.forward(latitude, longitude));
    info.projection.as_ref().map_or_else(Vec::new, lines)
}
