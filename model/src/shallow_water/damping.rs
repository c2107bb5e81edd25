//! Drag and hyperdiffusion of whole fields, which are linear and symmetric: the tangent-linear and the adjoint use the same
//! ones. Row by row they are in [`super::rows`], [`super::tangent_rows`] and [`super::hyperdiffusion`].

use super::{H, ShallowWater, U, V, padded_fields};
use crate::grid::Location;

/// Adds −r u, −r v and −ν L(L x), with L the five-point Laplacian under the boundary conditions of each variable.
///
/// Under the even continuation L has no flux through walls, so that Σ L h = 0 and mass is conserved; for v the walls
/// are zeros. Either way L is symmetric.
#[inline(always)]
pub(super) fn add_damping(model: &ShallowWater, x: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (drag, hyperdiffusion) = (model.parameters.drag_per_s, model.parameters.hyperdiffusion_m4_per_s);
    let cells = grid.cells();
    if drag != 0.0 {
        let walls = halo.first_row(Location::YFace) * grid.nx;
        for range in [U * cells..V * cells, V * cells + walls..(V + 1) * cells] {
            for (out, x) in out_add[range.clone()].iter_mut().zip(&x[range]) {
                *out -= drag * x;
            }
        }
    }
    if hyperdiffusion != 0.0 {
        let [field, laplacian] = padded_fields(halo, scratch);
        for (variable, location) in [(H, Location::Center), (U, Location::XFace), (V, Location::YFace)] {
            let range = variable * cells..(variable + 1) * cells;
            halo.load(location, &x[range.clone()], field);
            laplace(model, field, laplacian);
            halo.fill(location, laplacian);
            laplace(model, laplacian, field);
            let rows = out_add[range].chunks_exact_mut(halo.columns()).enumerate();
            for (j, out) in rows.skip(halo.first_row(location)) {
                for (out, bilaplacian) in out.iter_mut().zip(halo.row(field, j, 0, 0)) {
                    *out -= hyperdiffusion * bilaplacian;
                }
            }
        }
    }
}

/// The five-point Laplacian of a padded field.
#[inline(always)]
fn laplace(model: &ShallowWater, field: &[f64], out: &mut [f64]) {
    let (halo, grid) = (&model.halo, &model.layout.grid);
    let (x_weight, y_weight) = (grid.dx_m.powi(-2), grid.dy_m.powi(-2));
    let (center, west, east) = (halo.core(field), halo.shift(field, 0, -1), halo.shift(field, 0, 1));
    let (south, north) = (halo.shift(field, -1, 0), halo.shift(field, 1, 0));
    let out = halo.core_mut(out);
    for k in 0..halo.core_len() {
        let (x_part, y_part) =
            ((east[k] - center[k]) - (center[k] - west[k]), (north[k] - center[k]) - (center[k] - south[k]));
        out[k] = x_part * x_weight + y_part * y_weight;
    }
}
