//! A zonal jet in balance with the discrete equations.

use super::{check_thickness, displacement_m};
use crate::error::{ModelError, require_finite, require_positive};
use crate::grid::{Boundary, Grid, Location};
use crate::scheme::Tendency;
use crate::shallow_water::{H, ShallowWater, U};
use crate::state::State;

/// A jet u = u₀ sech²((y − y₀)/width), and a bump of h to set off its instability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JetConfig {
    /// Mean of h, without the perturbation \[m\].
    pub mean_depth_m: f64,
    /// Speed u₀ of the jet's axis \[m s⁻¹\].
    pub speed_m_per_s: f64,
    /// y₀ of the jet's axis \[m\].
    pub center_y_m: f64,
    /// Half-width of the jet \[m\].
    pub width_m: f64,
    /// A perturbation of h, out of balance.
    pub perturbation: Option<HeightPerturbation>,
}

/// A bump a exp(−(x/α)²) exp(−(y/β)²) of h, after Galewsky, Scott & Polvani (2004, Tellus 56A).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightPerturbation {
    /// Height a \[m\].
    pub amplitude_m: f64,
    /// x of the top \[m\].
    pub center_x_m: f64,
    /// y of the top \[m\].
    pub center_y_m: f64,
    /// α, the width in x \[m\].
    pub width_x_m: f64,
    /// β, the width in y \[m\].
    pub width_y_m: f64,
}

/// A zonal jet; without perturbation a steady solution of the discrete equations (to rounding, without drag and
/// hyperdiffusion).
///
/// For v = 0 and zonal symmetry all tendencies vanish but that of v, which is the same in both forms of the vorticity
/// term: at the y-face between rows s and n (h, u at centres and x-faces)
///
/// ```text
/// F(h_n) = (f − (u_n − u_s)/dy) (h_s u_s + h_n u_n)/(h_s + h_n) + [g (h_n − h_s) + (u_n² − u_s²)/2]/dy = 0,
/// ```
///
/// solved for h_n row by row from the south by Newton's method, and for the southernmost h by secants so that the mean
/// depth comes out. On a doubly periodic domain the rows must close: a uniform counterflow is subtracted
/// from the jet, such that they do.
///
/// # Errors
/// If a parameter is outside of its range, or no positive thickness balances the jet.
pub fn geostrophic_jet(model: &ShallowWater, config: &JetConfig) -> Result<State, ModelError> {
    require_positive("mean_depth_m", config.mean_depth_m)?;
    require_finite("speed_m_per_s", config.speed_m_per_s)?;
    require_finite("center_y_m", config.center_y_m)?;
    require_positive("width_m", config.width_m)?;
    let grid = &model.layout().grid;
    let jet: Vec<f64> = (0..grid.ny).map(|j| jet_profile(grid, config, grid.y_m(Location::XFace, j))).collect();
    let (h, u) = match grid.boundary {
        Boundary::Channel => (balanced_depth(model, &jet, config.mean_depth_m)?.0, jet),
        Boundary::Periodic => close_periodically(model, &jet, config.mean_depth_m)?,
    };
    let mut x = State::zeros(model.layout());
    for j in 0..grid.ny {
        x.field_mut(H)[j * grid.nx..(j + 1) * grid.nx].fill(h[j]);
        x.field_mut(U)[j * grid.nx..(j + 1) * grid.nx].fill(u[j]);
    }
    if let Some(perturbation) = &config.perturbation {
        add_perturbation(&mut x, perturbation)?;
    }
    check_thickness(&x)?;
    Ok(x)
}

fn jet_profile(grid: &Grid, config: &JetConfig, y_m: f64) -> f64 {
    let (_, y) = displacement_m(grid, (0.0, config.center_y_m), (0.0, y_m));
    let images = if grid.boundary == Boundary::Periodic { -2..=2 } else { 0..=0 };
    let sech_squared = |image: i32| ((y + f64::from(image) * grid.height_m()) / config.width_m).cosh().powi(-2);
    config.speed_m_per_s * images.map(sech_squared).sum::<f64>()
}

/// h of each row in balance with u, of the given mean, and by how much the row beyond the northernmost, with the u of
/// the southernmost, would be higher than the southernmost.
fn balanced_depth(model: &ShallowWater, u: &[f64], mean_depth_m: f64) -> Result<(Vec<f64>, f64), ModelError> {
    let ny = u.len();
    let integrate = |southernmost: f64| -> Result<(Vec<f64>, f64), ModelError> {
        let mut h = vec![southernmost];
        for j in 1..ny {
            h.push(balance_row(model, j, (h[j - 1], u[j - 1]), u[j])?);
        }
        let beyond = match model.layout().grid.boundary {
            Boundary::Periodic => balance_row(model, ny, (h[ny - 1], u[ny - 1]), u[0])?,
            Boundary::Channel => southernmost,
        };
        Ok((h, beyond - southernmost))
    };
    let mean = |h: &[f64]| h.iter().sum::<f64>() / ny as f64;
    // The anomaly depends but weakly on the depth: nearly dh/d(southernmost) = 1.
    let mut southernmost = mean_depth_m;
    let mut best = integrate(southernmost)?;
    for _ in 0..50 {
        let error = mean(&best.0) - mean_depth_m;
        if error.abs() <= 1e-14 * mean_depth_m {
            break;
        }
        southernmost -= error;
        best = integrate(southernmost)?;
    }
    Ok(best)
}

/// The thickness of row `j` that balances its wind `u_n` with the thickness and wind south of it.
fn balance_row(model: &ShallowWater, j: usize, (h_s, u_s): (f64, f64), u_n: f64) -> Result<f64, ModelError> {
    let dy = model.layout().grid.dy_m;
    let gravity = model.parameters().gravity_m_per_s2;
    let absolute_vorticity = model.coriolis_per_s(j % model.layout().grid.ny) - (u_n - u_s) / dy;
    let mut h_n = h_s;
    let mut last_change = f64::INFINITY;
    for _ in 0..100 {
        let sum = h_s + h_n;
        let f = absolute_vorticity * (h_s * u_s + h_n * u_n) / sum
            + (gravity * (h_n - h_s) + 0.5 * (u_n * u_n - u_s * u_s)) / dy;
        let slope = absolute_vorticity * h_s * (u_n - u_s) / (sum * sum) + gravity / dy;
        let change = f / slope;
        h_n -= change;
        if !(h_n.is_finite() && h_n > 0.0) {
            break;
        }
        // Quadratic convergence ends where rounding makes the changes stop falling.
        if change == 0.0 || (change.abs() < 1e-12 * h_n && change.abs() >= last_change) {
            return Ok(h_n);
        }
        last_change = change.abs();
    }
    Err(ModelError::NoBalance { row: j, wind_m_per_s: u_n })
}

/// h and u = jet − counterflow such that the rows close, by secants over the counterflow.
fn close_periodically(
    model: &ShallowWater,
    jet: &[f64],
    mean_depth_m: f64,
) -> Result<(Vec<f64>, Vec<f64>), ModelError> {
    let attempt = |counterflow: f64| -> Result<(Vec<f64>, Vec<f64>, f64), ModelError> {
        let u: Vec<f64> = jet.iter().map(|u| u - counterflow).collect();
        let (h, gap) = balanced_depth(model, &u, mean_depth_m)?;
        Ok((h, u, gap))
    };
    let mean_jet = jet.iter().sum::<f64>() / jet.len() as f64;
    let (mut previous, mut counterflow) = (1.01 * mean_jet, mean_jet);
    let mut gap_before = attempt(previous)?.2;
    let mut best = attempt(counterflow)?;
    for _ in 0..50 {
        if best.2 == gap_before || best.2.abs() <= 1e-15 * mean_depth_m {
            break;
        }
        let next = counterflow - best.2 * (counterflow - previous) / (best.2 - gap_before);
        (previous, gap_before) = (counterflow, best.2);
        counterflow = next;
        let candidate = attempt(counterflow)?;
        if candidate.2.abs() >= best.2.abs() && best.2.abs() < 1e-12 * mean_depth_m {
            break;
        }
        best = candidate;
    }
    if best.2.abs() <= 1e-12 * mean_depth_m {
        Ok((best.0, best.1))
    } else {
        Err(ModelError::NoBalance { row: 0, wind_m_per_s: best.1[0] })
    }
}

fn add_perturbation(x: &mut State, bump: &HeightPerturbation) -> Result<(), ModelError> {
    require_finite("amplitude_m", bump.amplitude_m)?;
    require_finite("center_x_m", bump.center_x_m)?;
    require_finite("center_y_m", bump.center_y_m)?;
    require_positive("width_x_m", bump.width_x_m)?;
    require_positive("width_y_m", bump.width_y_m)?;
    let grid = x.layout().grid.clone();
    for j in 0..grid.ny {
        for i in 0..grid.nx {
            let point = (grid.x_m(Location::Center, i), grid.y_m(Location::Center, j));
            let (dx, dy) = displacement_m(&grid, (bump.center_x_m, bump.center_y_m), point);
            x.field_mut(H)[j * grid.nx + i] +=
                bump.amplitude_m * (-(dx / bump.width_x_m).powi(2) - (dy / bump.width_y_m).powi(2)).exp();
        }
    }
    Ok(())
}
