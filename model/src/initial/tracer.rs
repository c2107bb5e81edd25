//! Tracer states for the advection models.

use super::displacement_m;
use crate::error::{ModelError, require_finite, require_positive};
use crate::state::{Layout, State};
use std::f64::consts::TAU;
use std::sync::Arc;

/// A hill a exp(−r²/(2 R²)) of tracer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianHill {
    /// x of the top \[m\].
    pub center_x_m: f64,
    /// y of the top \[m\].
    pub center_y_m: f64,
    /// Height a of the top \[1\].
    pub amplitude: f64,
    /// Radius R \[m\].
    pub radius_m: f64,
}

/// A wave mean + a cos(2π (m x/L_x + n y/L_y) + φ) of tracer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CosineWave {
    /// Mean value \[1\].
    pub mean: f64,
    /// Amplitude a \[1\].
    pub amplitude: f64,
    /// Number m of wavelengths in the domain's width.
    pub waves_x: i32,
    /// Number n of wavelengths in the domain's height.
    pub waves_y: i32,
    /// Phase φ \[rad\].
    pub phase: f64,
}

/// A background value and hills on it, at the variable's points; distances are to the nearest periodic image.
///
/// # Errors
/// If a radius is not positive or a number not finite.
///
/// # Panics
/// If the layout has more than one variable.
pub fn gaussian_hills(layout: &Arc<Layout>, background: f64, hills: &[GaussianHill]) -> Result<State, ModelError> {
    require_finite("background", background)?;
    for hill in hills {
        require_finite("center_x_m", hill.center_x_m)?;
        require_finite("center_y_m", hill.center_y_m)?;
        require_finite("amplitude", hill.amplitude)?;
        require_positive("radius_m", hill.radius_m)?;
    }
    Ok(tracer(layout, |x_m, y_m| {
        let height = |hill: &GaussianHill| {
            let (x, y) = displacement_m(&layout.grid, (hill.center_x_m, hill.center_y_m), (x_m, y_m));
            hill.amplitude * (-(x * x + y * y) / (2.0 * hill.radius_m.powi(2))).exp()
        };
        background + hills.iter().map(height).sum::<f64>()
    }))
}

/// A cosine wave at the variable's points.
///
/// # Errors
/// If a number is not finite.
///
/// # Panics
/// If the layout has more than one variable.
pub fn cosine_wave(layout: &Arc<Layout>, wave: &CosineWave) -> Result<State, ModelError> {
    require_finite("mean", wave.mean)?;
    require_finite("amplitude", wave.amplitude)?;
    require_finite("phase", wave.phase)?;
    let grid = &layout.grid;
    Ok(tracer(layout, |x_m, y_m| {
        let (m, n) = (f64::from(wave.waves_x), f64::from(wave.waves_y));
        wave.mean + wave.amplitude * (TAU * (m * x_m / grid.width_m() + n * y_m / grid.height_m()) + wave.phase).cos()
    }))
}

fn tracer(layout: &Arc<Layout>, value: impl Fn(f64, f64) -> f64) -> State {
    assert_eq!(layout.variables.len(), 1, "a tracer state has one variable");
    let (grid, location) = (&layout.grid, layout.variables[0].location);
    let points = (0..grid.ny).flat_map(|j| (0..grid.nx).map(move |i| (j, i)));
    let values = points.map(|(j, i)| value(grid.x_m(location, i), grid.y_m(location, j))).collect();
    State::from_values(layout, values)
}
