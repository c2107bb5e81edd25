//! What shallow water without drag and hyperdiffusion conserves, as the C grid has it.

use crate::grid::Boundary;
use crate::shallow_water::{H, ShallowWater, U, V};
use crate::state::State;

/// Volume Σ h dx dy \[m³\] (mass over density): conserved to rounding by both forms and boundaries.
pub fn mass_m3(model: &ShallowWater, x: &State) -> f64 {
    x.field(H).sum() * cell_area_m2(model)
}

/// Total energy ½ Σ (g h² + h̄ˣ u² + h̄ʸ v²) dx dy \[m⁵ s⁻²\] (energy over density): conserved by the
/// [`Energy`](crate::shallow_water::VectorInvariant::Energy) form but for the time scheme's error.
pub fn total_energy(model: &ShallowWater, x: &State) -> f64 {
    let (h, u, v) = (x.field(H), x.field(U), x.field(V));
    let (ny, nx) = h.dim();
    let gravity = model.parameters().gravity_m_per_s2;
    let mut sum = 0.0;
    for j in 0..ny {
        let south = (j + ny - 1) % ny;
        for i in 0..nx {
            let west = (i + nx - 1) % nx;
            // At a southern wall v = 0: the value of h south of it does not matter.
            let (thickness_x, thickness_y) = (0.5 * (h[[j, i]] + h[[j, west]]), 0.5 * (h[[j, i]] + h[[south, i]]));
            sum += gravity * h[[j, i]].powi(2) + thickness_x * u[[j, i]].powi(2) + thickness_y * v[[j, i]].powi(2);
        }
    }
    0.5 * sum * cell_area_m2(model)
}

/// Potential enstrophy ½ Σ h̄ˣʸ q² dx dy over the corners \[m s⁻²\], corners on walls counted half: conserved on a doubly
/// periodic domain by the
/// [`PotentialEnstrophy`](crate::shallow_water::VectorInvariant::PotentialEnstrophy) form but for the time scheme's
/// error.
pub fn potential_enstrophy(model: &ShallowWater, x: &State) -> f64 {
    let grid = &x.layout().grid;
    let (h, u, v) = (x.field(H), x.field(U), x.field(V));
    let (ny, nx) = h.dim();
    let walls = grid.boundary == Boundary::Channel;
    let mut sum = 0.0;
    for j in 0..if walls { ny + 1 } else { ny } {
        let at_wall = walls && (j == 0 || j == ny);
        let (south, north) = match (at_wall, j) {
            (true, 0) => (0, 0),
            (true, _) => (ny - 1, ny - 1),
            (false, _) => ((j + ny - 1) % ny, j),
        };
        for i in 0..nx {
            let west = (i + nx - 1) % nx;
            let thickness = 0.25 * (h[[north, i]] + h[[north, west]] + h[[south, i]] + h[[south, west]]);
            let vorticity = if at_wall {
                0.0
            } else {
                (v[[j, i]] - v[[j, west]]) / grid.dx_m - (u[[north, i]] - u[[south, i]]) / grid.dy_m
            };
            let weight = if at_wall { 0.5 } else { 1.0 };
            sum += weight * (model.coriolis_per_s(j) + vorticity).powi(2) / thickness;
        }
    }
    0.5 * sum * cell_area_m2(model)
}

fn cell_area_m2(model: &ShallowWater) -> f64 {
    let grid = &crate::scheme::Tendency::layout(model).grid;
    grid.dx_m * grid.dy_m
}
