//! Advection of one tracer by a given steady wind: the linear model whose solutions are known.
//!
//! ```text
//! ∂c/∂t = −∂(u c)/∂x − ∂(v c)/∂y
//! ```
//!
//! in flux form on the C grid, c at centres, u and v at faces. The wind is free of divergence on the grid, so that a
//! uniform tracer stays uniform.

use crate::error::{ModelError, require, require_finite, require_positive};
use crate::forecast::{Adjoint, Model, TangentLinear};
use crate::grid::{Boundary, Grid, Location};
use crate::halo::Halo;
use crate::scheme::{SpectralBounds, Tendency};
use crate::state::{Layout, State, Variable};
use crate::time::Duration;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// The tracer's value at a face, between cells a | b with c beyond b and d beyond a, for a wind from a to b.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdvectionScheme {
    /// a: first order, damping, monotone.
    FirstOrderUpwind,
    /// (5a + 2b − d)/6: third-order upwind-biased (Wicker & Skamarock 2002, Mon. Wea. Rev. 130, with their F₃).
    ThirdOrderUpwind,
    /// (7a + 7b − c − d)/12: fourth-order centred (Wicker & Skamarock 2002, their F₄); no damping.
    FourthOrderCentred,
}

/// A steady wind without divergence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wind {
    /// The same wind everywhere; v must be zero in a channel.
    Uniform {
        /// Zonal wind \[m s⁻¹\].
        u_m_per_s: f64,
        /// Meridional wind \[m s⁻¹\].
        v_m_per_s: f64,
    },
    /// One vortex that fills the domain and turns nearly like a solid body in the middle, from the streamfunction
    /// ψ = A sin²(πx/L_x) sin²(πy/L_y) with u = −∂ψ/∂y, v = ∂ψ/∂x (LeVeque 1996, SIAM J. Numer. Anal. 33): at rest at
    /// the domain's edges, which makes it fit both boundaries. Positive turns clockwise.
    Vortex {
        /// The highest zonal wind, A π/L_y \[m s⁻¹\].
        speed_m_per_s: f64,
    },
    /// A zonal wind with a jet: u + U cos²(π d/(2 w)) where the distance in y from the jet's middle, d, is less than its
    /// half-width w, and u elsewhere.
    Jet {
        /// The zonal wind beside the jet, u \[m s⁻¹\].
        u_m_per_s: f64,
        /// By how much it is stronger in the middle of the jet, U \[m s⁻¹\].
        jet_m_per_s: f64,
        /// y of the middle \[m\].
        center_y_m: f64,
        /// w \[m\]: positive.
        half_width_m: f64,
    },
}

/// The advection equation on a grid: a [`Tendency`] of one variable.
#[derive(Clone, Debug)]
pub struct Advection {
    layout: Arc<Layout>,
    halo: Halo,
    /// Flux through the western face over dx: Σ_m weight\[m\] c\[i + m − 2\], padded, \[s⁻¹\].
    weights_x: [Vec<f64>; 4],
    /// Flux through the southern face over dy: Σ_m weight\[m\] c\[j + m − 2\], padded, \[s⁻¹\].
    weights_y: [Vec<f64>; 4],
    bounds: SpectralBounds,
}

/// Advection by a whole number of cells in each step on a doubly periodic grid: a permutation of the cells, free of any
/// error.
#[derive(Clone, Debug)]
pub struct ExactShift {
    layout: Arc<Layout>,
    time_step: Duration,
    columns: usize,
    rows: usize,
}

/// The variable of the advection models.
pub fn layout(grid: Grid) -> Arc<Layout> {
    let tracer = Variable {
        name: "tracer",
        long_name: "concentration of a passive tracer",
        standard_name: None,
        unit: "1",
        location: Location::Center,
    };
    Arc::new(Layout { grid, variables: vec![tracer] })
}

impl AdvectionScheme {
    /// The four face weights for a wind w: of d, a, b, c if it were positive.
    fn weights(self, wind: f64) -> [f64; 4] {
        let speed = wind.abs();
        match self {
            AdvectionScheme::FirstOrderUpwind => [0.0, wind.max(0.0), wind.min(0.0), 0.0],
            AdvectionScheme::FourthOrderCentred => [-1.0, 7.0, 7.0, -1.0].map(|weight| weight * wind / 12.0),
            AdvectionScheme::ThirdOrderUpwind => {
                let [d, a, b, c] = AdvectionScheme::FourthOrderCentred.weights(wind);
                let upwind = speed / 12.0;
                [d - upwind, a + 3.0 * upwind, b - 3.0 * upwind, c + upwind]
            }
        }
    }

    /// Largest imaginary and real part of the symbol of a unit Courant rate: sin θ and 1 − cos θ for first order,
    /// (4 − cos θ) sin θ/3 and (1 − cos θ)²/3 for the others.
    fn symbol_bounds(self) -> (f64, f64) {
        match self {
            AdvectionScheme::FirstOrderUpwind => (1.0, 2.0),
            AdvectionScheme::ThirdOrderUpwind => (1.372_3, 4.0 / 3.0),
            AdvectionScheme::FourthOrderCentred => (1.372_3, 0.0),
        }
    }
}

impl Wind {
    /// The wind through the western and southern faces, `[y, x]` each \[m/s\]; without divergence on the grid.
    ///
    /// # Errors
    /// If a speed is not finite, or a uniform v blows through a channel's walls.
    pub fn at_faces(&self, grid: &Grid) -> Result<(Vec<f64>, Vec<f64>), ModelError> {
        match *self {
            Wind::Uniform { u_m_per_s, v_m_per_s } => {
                require_finite("u_m_per_s", u_m_per_s)?;
                require_finite("v_m_per_s", v_m_per_s)?;
                let walls = grid.boundary == Boundary::Channel;
                require(!walls || v_m_per_s == 0.0, "v_m_per_s", v_m_per_s, "zero in a channel")?;
                Ok((vec![u_m_per_s; grid.cells()], vec![v_m_per_s; grid.cells()]))
            }
            Wind::Vortex { speed_m_per_s } => {
                require_finite("speed_m_per_s", speed_m_per_s)?;
                let amplitude = speed_m_per_s * grid.height_m() / std::f64::consts::PI;
                // Row and column n are those of 0, exactly, so that the wind ends at the edges.
                let square_sine =
                    |index: usize, n: usize| (std::f64::consts::PI * (index % n) as f64 / n as f64).sin().powi(2);
                let psi = |j: usize, i: usize| amplitude * square_sine(i, grid.nx) * square_sine(j, grid.ny);
                let cells = || (0..grid.ny).flat_map(|j| (0..grid.nx).map(move |i| (j, i)));
                Ok((
                    cells().map(|(j, i)| -(psi(j + 1, i) - psi(j, i)) / grid.dy_m).collect(),
                    cells().map(|(j, i)| (psi(j, i + 1) - psi(j, i)) / grid.dx_m).collect(),
                ))
            }
            Wind::Jet { u_m_per_s, jet_m_per_s, center_y_m, half_width_m } => {
                require_finite("u_m_per_s", u_m_per_s)?;
                require_finite("jet_m_per_s", jet_m_per_s)?;
                require_finite("center_y_m", center_y_m)?;
                require_positive("half_width_m", half_width_m)?;
                let wind = |row: usize| {
                    let apart = (grid.y_m(Location::XFace, row) - center_y_m).abs();
                    let apart = match grid.boundary {
                        Boundary::Periodic => (apart % grid.height_m()).min(grid.height_m() - apart % grid.height_m()),
                        Boundary::Channel => apart,
                    };
                    let d = (apart / half_width_m).min(1.0);
                    u_m_per_s + jet_m_per_s * (std::f64::consts::FRAC_PI_2 * d).cos().powi(2)
                };
                let u = (0..grid.ny).flat_map(|row| std::iter::repeat_n(wind(row), grid.nx)).collect();
                Ok((u, vec![0.0; grid.cells()]))
            }
        }
    }
}

impl Advection {
    /// Advection by `wind` on `grid`.
    ///
    /// # Errors
    /// If the wind does not fit the grid or the grid has fewer than 4 × 4 cells.
    pub fn new(grid: Grid, wind: &Wind, scheme: AdvectionScheme) -> Result<Self, ModelError> {
        let halo = Halo::new(&grid, 2)?;
        let (u, v) = wind.at_faces(&grid)?;
        let weigh = |winds: &[f64], location: Location, spacing: f64| {
            [0, 1, 2, 3].map(|m| {
                let weights: Vec<f64> = winds.iter().map(|&wind| scheme.weights(wind / spacing)[m]).collect();
                let mut padded = halo.zeros();
                halo.load(location, &weights, &mut padded);
                padded
            })
        };
        let largest = |winds: &[f64]| winds.iter().fold(0.0, |largest: f64, wind| largest.max(wind.abs()));
        let (imaginary, real) = scheme.symbol_bounds();
        let rate = largest(&u) / grid.dx_m + largest(&v) / grid.dy_m;
        let bounds = SpectralBounds { oscillation_per_s: imaginary * rate, damping_per_s: real * rate };
        let weights_x = weigh(&u, Location::XFace, grid.dx_m);
        let weights_y = weigh(&v, Location::YFace, grid.dy_m);
        Ok(Self { layout: layout(grid), halo, weights_x, weights_y, bounds })
    }
}

impl Tendency for Advection {
    type Linearisation = ();

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Self> {
        let whole = &self.layout.grid;
        let grid = whole.of_rows(rows);
        let halo = Halo::new(&grid, 2).ok()?;
        let of_rows = |location: Location, weights: &[Vec<f64>; 4]| {
            [0, 1, 2, 3].map(|m| {
                let field: Vec<f64> =
                    (0..whole.ny).flat_map(|j| self.halo.row(&weights[m], j, 0, 0)).copied().collect();
                let mut padded = halo.zeros();
                halo.load(location, &whole.take_rows(rows, &field), &mut padded);
                padded
            })
        };
        let weights_x = of_rows(Location::XFace, &self.weights_x);
        let weights_y = of_rows(Location::YFace, &self.weights_y);
        Some(Self { layout: layout(grid), halo, weights_x, weights_y, bounds: self.bounds })
    }

    fn reach(&self) -> usize {
        2
    }

    fn scratch_len(&self) -> usize {
        3 * self.halo.len()
    }

    #[inline(always)]
    fn tendency(&self, x: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        let halo = &self.halo;
        let (c, fluxes) = scratch.split_at_mut(halo.len());
        let (flux_x, flux_y) = fluxes.split_at_mut(halo.len());
        halo.load(Location::Center, x, c);
        let near = |rows, columns| halo.shift(c, rows, columns);
        stencil(halo, &self.weights_x, [near(0, -2), near(0, -1), near(0, 0), near(0, 1)], flux_x);
        stencil(halo, &self.weights_y, [near(-2, 0), near(-1, 0), near(0, 0), near(1, 0)], flux_y);
        for (j, out) in out.chunks_exact_mut(halo.columns()).enumerate() {
            let (west, east) = (halo.row(flux_x, j, 0, 0), halo.row(flux_x, j, 0, 1));
            let (south, north) = (halo.row(flux_y, j, 0, 0), halo.row(flux_y, j, 1, 0));
            for i in 0..halo.columns() {
                out[i] = (west[i] - east[i]) + (south[i] - north[i]);
            }
        }
    }

    fn linearise(&self, _at: &[f64]) {}

    #[inline(always)]
    fn tendency_tl(&self, (): &(), dx: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        self.tendency(dx, out, scratch);
    }

    #[inline(always)]
    fn tendency_ad(&self, (): &(), dy: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
        let halo = &self.halo;
        let (c, fluxes) = scratch.split_at_mut(halo.len());
        let (flux_x, flux_y) = fluxes.split_at_mut(halo.len());
        halo.load_without_rim(Location::Center, dy, c);
        let (center, west, south) = (halo.core(c), halo.shift(c, 0, -1), halo.shift(c, -1, 0));
        let out = halo.core_mut(flux_x);
        for k in 0..halo.core_len() {
            out[k] = center[k] - west[k];
        }
        let out = halo.core_mut(flux_y);
        for k in 0..halo.core_len() {
            out[k] = center[k] - south[k];
        }
        let out = halo.core_mut(c);
        out.fill(0.0);
        for m in 0..4 {
            let back = 2 - m as isize;
            for (weights, flux, rows, columns) in
                [(&self.weights_x[m], &*flux_x, 0, back), (&self.weights_y[m], &*flux_y, back, 0)]
            {
                let (weights, flux) = (halo.shift(weights, rows, columns), halo.shift(flux, rows, columns));
                for k in 0..halo.core_len() {
                    out[k] += weights[k] * flux[k];
                }
            }
        }
        halo.fold(Location::Center, c, out_add);
    }

    /// Of the constant-coefficient operator with the strongest wind in either direction.
    fn spectral_bounds(&self, _x: &[f64]) -> SpectralBounds {
        self.bounds
    }
}

/// out = Σ_m weights\[m\] fields\[m\].
#[inline(always)]
fn stencil(halo: &Halo, weights: &[Vec<f64>; 4], fields: [&[f64]; 4], out: &mut [f64]) {
    let [w0, w1, w2, w3] = [0, 1, 2, 3].map(|m| halo.core(&weights[m]));
    let [c0, c1, c2, c3] = fields;
    let out = halo.core_mut(out);
    for k in 0..halo.core_len() {
        out[k] = (w0[k] * c0[k] + w1[k] * c1[k]) + (w2[k] * c2[k] + w3[k] * c3[k]);
    }
}

impl ExactShift {
    /// A shift by `columns` cells eastward and `rows` cells northward (either may be negative) per time step.
    ///
    /// # Errors
    /// If the grid is not doubly periodic, has no cells, or the time step is not positive.
    pub fn new(grid: Grid, columns: i64, rows: i64, time_step: Duration) -> Result<Self, ModelError> {
        let walls = grid.boundary == Boundary::Channel;
        require(!walls, "rows per step", rows as f64, "on a doubly periodic grid, not in a channel")?;
        require_positive("time_step_s", time_step.as_f64())?;
        if grid.cells() == 0 {
            return Err(ModelError::GridTooSmall { nx: grid.nx, ny: grid.ny, least: 1 });
        }
        let (columns, rows) = (columns.rem_euclid(grid.nx as i64) as usize, rows.rem_euclid(grid.ny as i64) as usize);
        Ok(Self { layout: layout(grid), time_step, columns, rows })
    }

    /// Moves each field, `[y, x]`, by rows and columns.
    fn shift(&self, columns: &mut [f64], shift_rows: usize, shift_columns: usize) {
        let nx = self.layout.grid.nx;
        assert_eq!(columns.len() % self.layout.len(), 0, "columns must be whole increments");
        columns.par_chunks_exact_mut(self.layout.len()).for_each(|field| {
            field.rotate_right(shift_rows * nx);
            field.chunks_exact_mut(nx).for_each(|row| row.rotate_right(shift_columns));
        });
    }
}

impl Model for ExactShift {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn time_step(&self) -> Duration {
        self.time_step
    }

    fn largest_time_step_s(&self, _x: &State) -> f64 {
        f64::INFINITY
    }

    /// Within the rows, around a ring of these.
    fn in_rows(&self, rows: &Range<isize>) -> Option<Arc<dyn Adjoint>> {
        let grid = Grid { boundary: Boundary::Periodic, ..self.layout.grid.of_rows(rows) };
        let turns = self.rows as i64 - if self.rows > self.reach() { self.layout.grid.ny as i64 } else { 0 };
        let shift = Self::new(grid, self.columns as i64, turns, self.time_step).ok()?;
        Some(Arc::new(shift))
    }

    /// By the way that is shorter.
    fn reach(&self) -> usize {
        self.rows.min(self.layout.grid.ny - self.rows)
    }

    fn step(&self, x: &mut State) {
        self.shift(x.values_mut(), self.rows, self.columns);
        x.advance(self.time_step);
    }
}

impl TangentLinear for ExactShift {
    fn step_tl(&self, _at: &State, columns: &mut [f64]) {
        self.shift(columns, self.rows, self.columns);
    }
}

impl Adjoint for ExactShift {
    /// The shift back: a permutation's transpose is its inverse.
    fn step_ad(&self, _at: &State, columns: &mut [f64]) {
        let grid = &self.layout.grid;
        self.shift(columns, (grid.ny - self.rows) % grid.ny, (grid.nx - self.columns) % grid.nx);
    }
}
