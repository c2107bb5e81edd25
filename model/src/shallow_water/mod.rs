//! Rotating shallow water in vector-invariant form on the C grid, after Sadourny (1975).
//!
//! ```text
//! ∂u/∂t =  q V − ∂B/∂x − r u − ν ∇⁴u        U = h u,  V = h v          mass fluxes
//! ∂v/∂t = −q U − ∂B/∂y − r v − ν ∇⁴v        q = (f + ζ)/h              potential vorticity, ζ = ∂v/∂x − ∂u/∂y
//! ∂h/∂t = −∂U/∂x − ∂V/∂y     − ν ∇⁴h        B = g h + (u² + v²)/2      Bernoulli function
//! ```
//!
//! With δ a difference and an overbar a mean of neighbours, in the directions they carry:
//!
//! ```text
//! U = h̄ˣ u,  V = h̄ʸ v,  q = (f + δx v/dx − δy u/dy) / h̄ˣʸ,  B = g h + mean_x(u²)/2 + mean_y(v²)/2
//! ```
//!
//! and the vorticity term either conserves potential enstrophy (q̄ʸ V̄ˣʸ, −q̄ˣ Ūˣʸ) or energy (mean_y(q V̄ˣ),
//! −mean_x(q Ūʸ)). Signs and arrangement are those of NCAR's shallow-water model "SWM". f = f0 + β (y − y_mid) is
//! taken at the corners.
//!
//! In a channel v = 0 at the walls, and all else is continued evenly beyond them: ζ = 0 there (free slip), and the
//! thickness at a wall's corner is the mean of the two cells beside it.
//!
//! R. Sadourny (1975): The dynamics of finite-difference models of the shallow-water equations. J. Atmos. Sci. 32.

mod adjoint;
mod adjoint_lines;
mod adjoint_rows;
mod damping;
mod hyperdiffusion;
mod kernel;
mod lanes;
mod linear;
mod linear_rows;
mod row_coefficients;
mod rows;
mod tangent_lanes;
mod tangent_linear;
mod tangent_rows;

pub use linear::LinearShallowWater;
pub use tangent_linear::Coefficients;

use crate::error::{ModelError, require, require_finite, require_non_negative, require_positive};
use crate::grid::{Boundary, Grid, Location};
use crate::halo::Halo;
use crate::scheme::sweep::tendency_by_rows;
use crate::scheme::{AdjointRowStream, Lanes, RowStream, SpectralBounds, TangentRowStream, Tendency};
use crate::state::{Layout, Variable};
use crate::stored::Stored;

use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;
use std::sync::Arc;

/// Number of the thickness h among the variables.
pub const H: usize = 0;
/// Number of the zonal wind u among the variables.
pub const U: usize = 1;
/// Number of the meridional wind v among the variables.
pub const V: usize = 2;
/// h, u and v.
const VARIABLES: usize = 3;

/// The physical parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShallowWaterParameters {
    /// Gravity g (reduced gravity for an active layer) \[m s⁻²\]: positive.
    pub gravity_m_per_s2: f64,
    /// Coriolis parameter f0 in the middle of the domain \[s⁻¹\].
    pub coriolis_per_s: f64,
    /// Its northward gradient β \[m⁻¹ s⁻¹\]: zero on a doubly periodic domain, where f must be periodic.
    pub beta_per_m_per_s: f64,
    /// Rayleigh drag r on u and v \[s⁻¹\]: not negative.
    pub drag_per_s: f64,
    /// Biharmonic hyperdiffusion ν of h, u and v \[m⁴ s⁻¹\]: not negative.
    pub hyperdiffusion_m4_per_s: f64,
}

/// How the vorticity term is discretised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VectorInvariant {
    /// Conserves potential enstrophy Σ h̄ˣʸ q²/2 (on a doubly periodic domain).
    PotentialEnstrophy,
    /// Conserves energy Σ (g h² + U u + V v)/2.
    Energy,
}

/// The shallow-water equations on a grid: a [`Tendency`] of h, u and v.
#[derive(Clone, Debug)]
pub struct ShallowWater {
    layout: Arc<Layout>,
    parameters: ShallowWaterParameters,
    form: VectorInvariant,
    halo: Halo,
    /// The row, counted like the others, at which f = f0: in the middle of the whole domain, also where the grid is some of its rows.
    middle_row: f64,
    /// Whether the domain goes on beyond the southern and the northern end of the grid.
    open_ends: [bool; 2],
    /// f at the corners, padded.
    coriolis: Vec<f64>,
}

/// The variables of shallow water on a grid, in the order [`H`], [`U`], [`V`].
pub fn layout(grid: Grid) -> Arc<Layout> {
    let variables = vec![
        Variable {
            name: "h",
            long_name: "thickness of the fluid layer",
            standard_name: Some("geopotential_height"),
            unit: "m",
            location: Location::Center,
        },
        Variable {
            name: "u",
            long_name: "zonal wind",
            standard_name: Some("x_wind"),
            unit: "m s-1",
            location: Location::XFace,
        },
        Variable {
            name: "v",
            long_name: "meridional wind",
            standard_name: Some("y_wind"),
            unit: "m s-1",
            location: Location::YFace,
        },
    ];
    Arc::new(Layout { grid, variables })
}

/// Those of the Earth's gravity without rotation and damping: whoever names only what matters here is not concerned by a term
/// that is added later.
impl Default for ShallowWaterParameters {
    fn default() -> Self {
        Self {
            gravity_m_per_s2: 9.81,
            coriolis_per_s: 0.0,
            beta_per_m_per_s: 0.0,
            drag_per_s: 0.0,
            hyperdiffusion_m4_per_s: 0.0,
        }
    }
}

impl ShallowWaterParameters {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`ModelError::Parameter`] for the first parameter outside of its range.
    pub fn validate(&self, boundary: Boundary) -> Result<(), ModelError> {
        require_positive("gravity_m_per_s2", self.gravity_m_per_s2)?;
        require_finite("coriolis_per_s", self.coriolis_per_s)?;
        require_finite("beta_per_m_per_s", self.beta_per_m_per_s)?;
        let periodic = boundary == Boundary::Periodic;
        let beta = self.beta_per_m_per_s;
        require(!periodic || beta == 0.0, "beta_per_m_per_s", beta, "zero on a doubly periodic domain")?;
        require_non_negative("drag_per_s", self.drag_per_s)?;
        require_non_negative("hyperdiffusion_m4_per_s", self.hyperdiffusion_m4_per_s)
    }
}

impl ShallowWater {
    /// The equations on `grid`.
    ///
    /// # Errors
    /// If a parameter is outside of its range or the grid has fewer than 4 × 4 cells.
    pub fn new(grid: Grid, parameters: ShallowWaterParameters, form: VectorInvariant) -> Result<Self, ModelError> {
        parameters.validate(grid.boundary)?;
        let middle_row = 0.5 * grid.ny as f64;
        Self::about_row(grid, parameters, form, middle_row, [false; 2])
    }

    /// The equations with f = f0 at a row.
    fn about_row(
        grid: Grid,
        parameters: ShallowWaterParameters,
        form: VectorInvariant,
        middle_row: f64,
        open_ends: [bool; 2],
    ) -> Result<Self, ModelError> {
        let halo = Halo::new(&grid, 1)?;
        let coriolis = halo.zeros();
        let mut equations = Self { layout: layout(grid), parameters, form, halo, middle_row, open_ends, coriolis };
        for row in 0..equations.halo.core_len() / equations.halo.stride() {
            let coriolis = equations.coriolis_at(row as f64 - 1.0);
            let stride = equations.halo.stride();
            equations.halo.core_mut(&mut equations.coriolis)[row * stride..][..stride].fill(coriolis);
        }
        Ok(equations)
    }

    /// The physical parameters.
    pub fn parameters(&self) -> &ShallowWaterParameters {
        &self.parameters
    }

    /// The form of the vorticity term.
    pub fn form(&self) -> VectorInvariant {
        self.form
    }

    /// f at the corners of row `j` \[s⁻¹\] (row 0 is the southern edge, row `ny` the northern).
    pub fn coriolis_per_s(&self, j: usize) -> f64 {
        self.coriolis_at(j as f64)
    }

    /// f at the corners of a row, which may lie outside of the domain.
    fn coriolis_at(&self, row: f64) -> f64 {
        let ShallowWaterParameters { coriolis_per_s, beta_per_m_per_s, .. } = self.parameters;
        coriolis_per_s + beta_per_m_per_s * (row - self.middle_row) * self.layout.grid.dy_m
    }

    /// The number of a row that may be beyond a periodic edge; in a channel row `ny` lies beyond the northern wall.
    #[inline]
    fn grid_row(&self, row: isize) -> usize {
        let ny = self.layout.grid.ny as isize;
        if (0..=ny).contains(&row) { row as usize } else { row.rem_euclid(ny) as usize }
    }

    /// The fields of h, u and v in a slice `[variable, y, x]`.
    #[inline(always)]
    fn fields<'a>(&self, x: &'a [f64]) -> [&'a [f64]; 3] {
        let cells = self.layout.grid.cells();
        [&x[..cells], &x[cells..2 * cells], &x[2 * cells..3 * cells]]
    }
}

impl Tendency for ShallowWater {
    type Linearisation = Coefficients;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Self> {
        let (whole, middle_row) = (&self.layout.grid, self.middle_row - rows.start as f64);
        let [south, north] = self.open_ends.map(|is_open| is_open || whole.boundary == Boundary::Periodic);
        let open_ends = [south || rows.start > 0, north || rows.end < whole.ny as isize];
        Self::about_row(whole.of_rows(rows), self.parameters, self.form, middle_row, open_ends).ok()
    }

    fn open_ends(&self) -> [bool; 2] {
        self.open_ends
    }

    /// With hyperdiffusion two rows.
    fn reach(&self) -> usize {
        if self.parameters.hyperdiffusion_m4_per_s == 0.0 { 1 } else { 2 }
    }

    fn scratch_len(&self) -> usize {
        10 * self.halo.len()
    }

    /// v = 0 at the walls.
    #[inline(always)]
    fn constrain<N: Stored>(&self, x: &mut [N]) {
        let walls = self.halo.first_row(Location::YFace) * self.layout.grid.nx;
        x[2 * self.layout.grid.cells()..][..walls].fill(N::default());
    }

    /// The thickness must be positive everywhere.
    fn check(&self, x: &[f64]) -> Result<(), ModelError> {
        let [h, _, _] = self.fields(x);
        match h.iter().position(|&h| h.is_nan() || h <= 0.0) {
            None => Ok(()),
            Some(index) => {
                let (_, row, column) = self.layout.place(index);
                Err(ModelError::Thickness { row, column, thickness_m: h[index] })
            }
        }
    }

    fn tendency(&self, x: &[f64], out: &mut [f64], _scratch: &mut [f64]) {
        tendency_by_rows(self, x, out);
    }

    fn row_stream(&self, nx: usize, lanes: usize) -> Option<Box<dyn RowStream + '_>> {
        Some(if self.parameters.hyperdiffusion_m4_per_s == 0.0 {
            Box::new(rows::ShallowWaterRows::new(self, nx, lanes))
        } else {
            Box::new(hyperdiffusion::HyperdiffusedRows::new(self, nx, lanes))
        })
    }

    fn tangent_row_stream<N: Stored>(&self, nx: usize, lanes: Lanes) -> Option<Box<dyn TangentRowStream<N> + '_>> {
        let rows: Box<dyn TangentRowStream<N> + '_> = match lanes {
            Lanes::One => Box::new(tangent_rows::TangentRows::new(self, nx)),
            Lanes::Group => Box::new(tangent_lanes::TangentLanes::new(self, nx)),
        };
        if self.parameters.hyperdiffusion_m4_per_s == 0.0 {
            return Some(rows);
        }
        Some(Box::new(hyperdiffusion::HyperdiffusedTangentRows::new(self, nx, lanes, rows)))
    }

    fn adjoint_row_stream(&self, nx: usize, lanes: Lanes, delay: usize) -> Option<Box<dyn AdjointRowStream + '_>> {
        Some(if self.parameters.hyperdiffusion_m4_per_s == 0.0 {
            Box::new(adjoint_rows::AdjointRows::new(self, nx, lanes, delay))
        } else {
            Box::new(hyperdiffusion::HyperdiffusedAdjointRows::new(self, nx, lanes, delay))
        })
    }

    fn linearise(&self, at: &[f64]) -> Coefficients {
        Coefficients::new(self, at)
    }

    #[inline(always)]
    fn tendency_tl(&self, at: &Coefficients, dx: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        tangent_linear::tendency_tl(self, at, dx, out, scratch);
    }

    #[inline(always)]
    fn tendency_ad(&self, at: &Coefficients, dy: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
        adjoint::tendency_ad(self, at, dy, out_add, scratch);
    }

    /// On the C grid, ω² = f² cos²(k dx/2) cos²(l dy/2) + 4 g H (sin²(k dx/2)/dx² + sin²(l dy/2)/dy²), which is linear
    /// in either sin², so that its maximum over all waves is at a corner: max(f², 4 g H (1/dx² + 1/dy²)). Advection by
    /// centred differences adds at most |u|/dx + |v|/dy. Damping: drag, and ν times the square of the Laplacian's
    /// largest eigenvalue 4 (1/dx² + 1/dy²).
    fn spectral_bounds(&self, x: &[f64]) -> SpectralBounds {
        let (grid, parameters) = (&self.layout.grid, &self.parameters);
        let [h, u, v] = self.fields(x);
        let gravity_waves = 2.0 * (parameters.gravity_m_per_s2 * largest(h)).sqrt();
        let inverse_squares = grid.dx_m.powi(-2) + grid.dy_m.powi(-2);
        let coriolis = self.coriolis_per_s(0).abs().max(self.coriolis_per_s(grid.ny).abs());
        let advection = largest(u) / grid.dx_m + largest(v) / grid.dy_m;
        SpectralBounds {
            oscillation_per_s: coriolis.max(gravity_waves * inverse_squares.sqrt()) + advection,
            damping_per_s: parameters.drag_per_s + parameters.hyperdiffusion_m4_per_s * (4.0 * inverse_squares).powi(2),
        }
    }
}

/// The largest absolute value, leaving out what is not a number.
fn largest(field: &[f64]) -> f64 {
    Arch::new().dispatch(Largest(field))
}

struct Largest<'a>(&'a [f64]);

impl WithSimd for Largest<'_> {
    type Output = f64;

    /// In eight lanes, as one running maximum would wait for each comparison.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> f64 {
        let mut lanes = [0.0_f64; 8];
        let (chunks, rest) = self.0.as_chunks::<8>();
        for chunk in chunks {
            for lane in 0..8 {
                let size = chunk[lane].abs();
                lanes[lane] = if size > lanes[lane] { size } else { lanes[lane] };
            }
        }
        lanes.iter().chain(rest).fold(0.0, |largest: f64, value| largest.max(value.abs()))
    }
}

/// Cuts scratch space into padded fields.
#[inline(always)]
fn padded_fields<'a, const N: usize>(halo: &Halo, scratch: &'a mut [f64]) -> [&'a mut [f64]; N] {
    let mut rest = scratch;
    std::array::from_fn(|_| {
        let (field, remainder) = std::mem::take(&mut rest).split_at_mut(halo.len());
        rest = remainder;
        field
    })
}
