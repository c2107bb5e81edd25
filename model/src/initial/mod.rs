//! Initial states: rest, jets, vortices and balanced random fields of shallow water; hills and waves of a tracer.

mod jet;
mod streamfunction;
mod tracer;

pub use jet::{HeightPerturbation, JetConfig, geostrophic_jet};
pub use streamfunction::{RandomConfig, Vortex, random_balanced, vortices};
pub use tracer::{CosineWave, GaussianHill, cosine_wave, gaussian_hills};

use crate::error::{ModelError, require_positive};
use crate::grid::{Boundary, Grid};
use crate::scheme::Tendency;
use crate::shallow_water::{H, ShallowWater};
use crate::state::State;

/// Shallow water at rest.
///
/// # Errors
/// If the mean depth is not positive.
pub fn rest(model: &ShallowWater, mean_depth_m: f64) -> Result<State, ModelError> {
    require_positive("mean_depth_m", mean_depth_m)?;
    let mut x = State::zeros(model.layout());
    x.field_mut(H).fill(mean_depth_m);
    Ok(x)
}

/// Fails at the first thickness that is not positive.
fn check_thickness(x: &State) -> Result<(), ModelError> {
    for ((row, column), &thickness_m) in x.field(H).indexed_iter() {
        if !(thickness_m.is_finite() && thickness_m > 0.0) {
            return Err(ModelError::Thickness { row, column, thickness_m });
        }
    }
    Ok(())
}

/// From a centre to a point \[m\], to the nearest image in a periodic direction.
fn displacement_m(grid: &Grid, center: (f64, f64), point: (f64, f64)) -> (f64, f64) {
    let nearest = |distance: f64, period: f64| distance - period * (distance / period).round();
    let (x, y) = (point.0 - center.0, point.1 - center.1);
    match grid.boundary {
        Boundary::Periodic => (nearest(x, grid.width_m()), nearest(y, grid.height_m())),
        Boundary::Channel => (nearest(x, grid.width_m()), y),
    }
}
