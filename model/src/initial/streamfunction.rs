//! Geostrophically balanced states from a streamfunction at the corners: vortices and random fields.
//!
//! ```text
//! u = −δy ψ/dy,  v = δx ψ/dx,  h = H + (f0/g) mean_xy(ψ)
//! ```
//!
//! On the C grid this is without divergence and in exact balance, f mean_xy(v) = g δx h/dx and
//! f mean_xy(u) = −g δy h/dy, on an f-plane with f = f0 and without the nonlinear terms. ψ = 0 at walls, where ψ is
//! continued oddly.

use super::{check_thickness, displacement_m};
use crate::error::{ModelError, require, require_finite, require_non_negative, require_positive};
use crate::grid::{Boundary, Grid, Location};
use crate::random::standard_normals;
use crate::scheme::Tendency;
use crate::shallow_water::{H, ShallowWater, U, V};
use crate::state::State;
use rand_chacha::ChaCha8Rng;

/// A Gaussian vortex, height anomaly a exp(−r²/(2 R²)): a high for positive a, a low for negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vortex {
    /// x of the centre \[m\].
    pub center_x_m: f64,
    /// y of the centre \[m\].
    pub center_y_m: f64,
    /// Height anomaly a in the centre \[m\].
    pub amplitude_m: f64,
    /// Radius R \[m\].
    pub radius_m: f64,
}

/// A random balanced field, statistically homogeneous away from walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomConfig {
    /// Mean of h \[m\].
    pub mean_depth_m: f64,
    /// Expected standard deviation of h \[m\], its domain mean included, which the state then leaves out: that matters
    /// if L is not small against the domain.
    pub height_standard_deviation_m: f64,
    /// L of the streamfunction's correlation exp(−r²/(2 L²)) \[m\].
    pub length_scale_m: f64,
}

/// Balanced vortices in a fluid otherwise at rest; distances are to the nearest periodic image, and walls mirror each
/// vortex as one of the opposite sign.
///
/// # Errors
/// If f0 is zero, a parameter is outside of its range, or the thickness is somewhere not positive.
pub fn vortices(model: &ShallowWater, mean_depth_m: f64, vortices: &[Vortex]) -> Result<State, ModelError> {
    require_positive("mean_depth_m", mean_depth_m)?;
    for vortex in vortices {
        require_finite("center_x_m", vortex.center_x_m)?;
        require_finite("center_y_m", vortex.center_y_m)?;
        require_finite("amplitude_m", vortex.amplitude_m)?;
        require_positive("radius_m", vortex.radius_m)?;
    }
    let grid = &model.layout().grid;
    let height = |x_m: f64, y_m: f64| -> f64 {
        let anomaly = |vortex: &Vortex| {
            let (x, y) = displacement_m(grid, (vortex.center_x_m, vortex.center_y_m), (x_m, y_m));
            vortex.amplitude_m * (-(x * x + y * y) / (2.0 * vortex.radius_m.powi(2))).exp()
        };
        vortices.iter().map(anomaly).sum()
    };
    let per_height = streamfunction_per_height(model)?;
    let psi = corner_field(grid, |j, i| {
        let (x_m, y_m) = (grid.x_m(Location::Corner, i), grid.y_m(Location::Corner, j));
        let images = match grid.boundary {
            Boundary::Periodic => 0.0,
            Boundary::Channel => height(x_m, -y_m) + height(x_m, 2.0 * grid.height_m() - y_m),
        };
        per_height * (height(x_m, y_m) - images)
    });
    balanced(model, mean_depth_m, &psi)
}

/// A balanced state of random streamfunction: Gaussian, with correlation exp(−r²/(2 L²)), made of white noise by a
/// separable periodic convolution with exp(−r²/L²). The mean of h is exactly the mean depth on each draw.
///
/// In a channel the field is that of a doubly periodic domain of twice the height, made odd about the walls: its
/// variance falls to zero within about L of them.
///
/// # Errors
/// If f0 is zero, a parameter is outside of its range, or the thickness is somewhere not positive.
pub fn random_balanced(
    model: &ShallowWater,
    config: &RandomConfig,
    random: &mut ChaCha8Rng,
) -> Result<State, ModelError> {
    require_positive("mean_depth_m", config.mean_depth_m)?;
    require_non_negative("height_standard_deviation_m", config.height_standard_deviation_m)?;
    require_positive("length_scale_m", config.length_scale_m)?;
    let grid = &model.layout().grid;
    let rows = match grid.boundary {
        Boundary::Periodic => grid.ny,
        Boundary::Channel => 2 * grid.ny,
    };
    let kernel_x = periodic_kernel(grid.nx, grid.dx_m / config.length_scale_m);
    let kernel_y = periodic_kernel(rows, grid.dy_m / config.length_scale_m);
    let noise = standard_normals(random, rows * grid.nx);
    let smooth = convolve(&noise, grid.nx, &kernel_x, &kernel_y);
    let at = |j: usize, i: usize| smooth[(j % rows) * grid.nx + i];
    let factor = streamfunction_per_height(model)? * config.height_standard_deviation_m
        / (variance_of_means(&kernel_x) * variance_of_means(&kernel_y)).sqrt();
    let psi = corner_field(grid, |j, i| match grid.boundary {
        Boundary::Periodic => factor * at(j, i),
        Boundary::Channel => factor * (at(j, i) - at(rows - j, i)) * std::f64::consts::FRAC_1_SQRT_2,
    });
    balanced(model, config.mean_depth_m, &psi).map(|mut x| {
        let excess = x.field(H).mean().unwrap_or(0.0) - config.mean_depth_m;
        x.field_mut(H).iter_mut().for_each(|h| *h -= excess);
        x
    })
}

/// ψ for a height anomaly of one metre, g/f0 \[m s⁻¹\].
fn streamfunction_per_height(model: &ShallowWater) -> Result<f64, ModelError> {
    let parameters = model.parameters();
    let coriolis = parameters.coriolis_per_s;
    require(coriolis != 0.0, "coriolis_per_s", coriolis, "other than zero for geostrophic balance")?;
    Ok(parameters.gravity_m_per_s2 / coriolis)
}

/// ψ at the corners of rows 0 to `ny` and columns 0 to `nx − 1`; zero at walls, row `ny` being row 0 without walls.
fn corner_field(grid: &Grid, value: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    let walls = grid.boundary == Boundary::Channel;
    (0..=grid.ny)
        .flat_map(|j| (0..grid.nx).map(move |i| (j, i)))
        .map(|(j, i)| if walls && (j == 0 || j == grid.ny) { 0.0 } else { value(j % grid.ny, i) })
        .collect()
}

/// The balanced state of a streamfunction given by [`corner_field`].
fn balanced(model: &ShallowWater, mean_depth_m: f64, psi: &[f64]) -> Result<State, ModelError> {
    let height_per_psi = 1.0 / streamfunction_per_height(model)?;
    let grid = &model.layout().grid;
    let mut x = State::zeros(model.layout());
    for j in 0..grid.ny {
        for i in 0..grid.nx {
            let east = (i + 1) % grid.nx;
            let [sw, se, nw, ne] = [(j, i), (j, east), (j + 1, i), (j + 1, east)].map(|(j, i)| psi[j * grid.nx + i]);
            let k = j * grid.nx + i;
            x.field_mut(H)[k] = mean_depth_m + height_per_psi * 0.25 * (sw + se + nw + ne);
            x.field_mut(U)[k] = -(nw - sw) / grid.dy_m;
            x.field_mut(V)[k] = (se - sw) / grid.dx_m;
        }
    }
    check_thickness(&x)?;
    Ok(x)
}

/// exp(−d²) at the n points of a ring, `spacing` apart in units of L, summed over images.
fn periodic_kernel(n: usize, spacing: f64) -> Vec<f64> {
    let images = (6.0 / (n as f64 * spacing)).ceil().min(1e4) as i64 + 1;
    (0..n as i64)
        .map(|k| (-images..=images).map(|m| (-((k + m * n as i64) as f64 * spacing).powi(2)).exp()).sum())
        .collect()
}

/// Variance of the mean of two neighbours of white noise convolved with a kernel on a ring.
fn variance_of_means(kernel: &[f64]) -> f64 {
    let n = kernel.len();
    (0..n).map(|k| (0.5 * (kernel[k] + kernel[(k + 1) % n])).powi(2)).sum()
}

/// Periodic convolution of a field of rows of `nx` values with a kernel in x and one in y.
fn convolve(field: &[f64], nx: usize, kernel_x: &[f64], kernel_y: &[f64]) -> Vec<f64> {
    let ny = kernel_y.len();
    let mut in_x = vec![0.0; field.len()];
    for (out, row) in in_x.chunks_exact_mut(nx).zip(field.chunks_exact(nx)) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = (0..nx).map(|k| kernel_x[(i + nx - k) % nx] * row[k]).sum();
        }
    }
    let mut out = vec![0.0; field.len()];
    for (j, out) in out.chunks_exact_mut(nx).enumerate() {
        for (k, row) in in_x.chunks_exact(nx).enumerate() {
            let weight = kernel_y[(j + ny - k) % ny];
            out.iter_mut().zip(row).for_each(|(out, value)| *out += weight * value);
        }
    }
    out
}
