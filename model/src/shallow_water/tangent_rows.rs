//! The tangent-linear tendency row by row: the derivatives in [`super::kernel`], with the coefficients of a row of the state
//! computed once for all columns. It is used for a column alone; for eight at once [`super::tangent_lanes`] is faster.

use super::kernel::{Constants, VorticityWeights, mass_flux_tl, potential_vorticity_tl};
use super::row_coefficients::{PlaceCoefficients, RowCoefficients, VorticityCoefficients};
use super::rows::ShallowWaterRows;
use super::{ShallowWater, U, V};
use crate::grid::Boundary;
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};
use crate::scheme::strips::periodic_row;

use pulp::{Simd, WithSimd};

/// h, u and v.
const VARIABLES: usize = 3;

/// Diagnostic rows of a sweep, `[x, lane]`, arranged as those of [`ShallowWaterRows`], of `L` columns.
pub(super) struct TangentRows<'a, const L: usize> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients,
    /// δU of three rows.
    flux_x: [Vec<[f64; L]>; 3],
    /// δV of two rows.
    flux_y: [Vec<[f64; L]>; 2],
    /// δq of two rows.
    q: [Vec<[f64; L]>; 2],
    /// δB of the two rows before the last.
    bernoulli: [Vec<[f64; L]>; 2],
}

impl<'a, const L: usize> TangentRows<'a, L> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        let row = || vec![[0.0; L]; nx + 1];
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx),
            coefficients: RowCoefficients::new(model, nx, 2),
            flux_x: [row(), row(), row()],
            flux_y: [row(), row()],
            q: [row(), row()],
            bernoulli: [row(), row()],
        }
    }
}

impl<const L: usize> TangentRowStream for TangentRows<'_, L> {
    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_>) {
        self.state.begin(x);
        self.coefficients.begin(row, x);
        let ([h, u], [dh, du]) = (x.variables(), dx.variables().map(|row| row.as_chunks::<L>().0));
        let (n, flux) = (h.len(), &mut self.flux_x[2]);
        for i in 0..n {
            let thickness = 0.5 * (h[i] + h[(i + n - 1) % n]);
            for lane in 0..L {
                flux[i][lane] = mass_flux_tl(thickness, 0.5 * u[i], dh[i + 1][lane] + dh[i][lane], du[i + 1][lane]);
            }
        }
        flux[n] = flux[0];
    }

    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_>, ghost: &mut [f64], d_ghost: &mut [f64]) {
        self.state.beyond_wall(x, ghost);
        continue_evenly(dx, d_ghost);
    }

    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_>) {
        self.state.push(self.model.grid_row(row), x.south, x.north, x.tendency);
        self.flux_x.rotate_left(1);
        self.flux_y.swap(0, 1);
        self.q.swap(0, 1);
        self.bernoulli.swap(0, 1);
        self.arch.dispatch(Push { rows: self, row, x: [x.south, x.north], dx });
    }
}

/// h and u continued evenly beyond a wall, v = 0.
pub(super) fn continue_evenly(row: Row<'_>, ghost: &mut [f64]) {
    let [h, u, _] = row.variables::<VARIABLES>();
    let (ghost_h, winds) = ghost.split_at_mut(h.len());
    let (ghost_u, ghost_v) = winds.split_at_mut(u.len());
    ghost_h.copy_from_slice(h);
    ghost_u.copy_from_slice(u);
    ghost_v.fill(0.0);
}

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b, const L: usize> {
    rows: &'a mut TangentRows<'b, L>,
    row: isize,
    /// The southern and the northern row.
    x: [Row<'a>; 2],
    dx: Pushed<'a>,
}

impl<const L: usize> WithSimd for Push<'_, '_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Push { rows, row, x: [x_south, x_north], dx: Pushed { south, north, tendency } } = self;
        let TangentRows { model, state, coefficients, flux_x, flux_y, q, bernoulli, .. } = rows;
        coefficients.push(row, state, x_south, x_north);
        let coefficients = &*coefficients;
        let constants = Constants::new(model);
        let n = x_south.variable(U).len();
        let places = [row - 1, row].map(|row| coefficients.places(row, n));
        diagnose(constants, places, south, north, &mut flux_x[2], &mut flux_y[1], &mut q[1], &mut bernoulli[1]);
        let around = Around {
            flux_x_s: &flux_x[0],
            flux_x: &flux_x[1],
            flux_y: &flux_y[0],
            flux_y_n: &flux_y[1],
            q: &q[0],
            q_n: &q[1],
            b_s: &bernoulli[0],
            b: &bernoulli[1],
        };
        let stride = tendency.len() / VARIABLES;
        let (out_h, winds) = tendency.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        tendencies(constants, coefficients.vorticity_term(row - 1, n), around, out_h, out_u, out_v);
        let drag = model.parameters.drag_per_s;
        if drag != 0.0 {
            for (out, wind) in [(&mut *out_u, south.variable(U)), (&mut *out_v, south.variable(V))] {
                for (out, wind) in out.iter_mut().zip(wind) {
                    *out -= drag * wind;
                }
            }
        }
        if model.layout.grid.boundary == Boundary::Channel && row == 1 {
            out_v.fill(0.0);
        }
        for row in [out_h, out_u, out_v] {
            periodic_row(row, L);
        }
    }
}

/// δU, δV and δq of the northern row, δB of the southern, in one loop.
#[inline(always)]
fn diagnose<const L: usize>(
    constants: Constants,
    [at_s, at]: [PlaceCoefficients<'_>; 2],
    south: Row<'_>,
    north: Row<'_>,
    flux_x: &mut [[f64; L]],
    flux_y: &mut [[f64; L]],
    potential_vorticity: &mut [[f64; L]],
    bernoulli: &mut [[f64; L]],
) {
    let [h_s, u_s, v_s] = south.variables().map(|row| row.as_chunks::<L>().0);
    let [h, u, v] = north.variables().map(|row| row.as_chunks::<L>().0);
    let n = h.len() - 2;
    {
        let (thickness_x, thickness_y) = (&at.thickness_x[1..][..n], &at.thickness_y[1..][..n]);
        let (per_thickness, quarter_q) = (&at.per_thickness[1..][..n], &at.quarter_q_per_thickness[1..][..n]);
        let (half_u, half_v, half_v_s) = (&at.half_u[1..][..n], &at.half_v[1..][..n], &at_s.half_v[1..][..n]);
        let (half_u_s, half_u_se) = (&at_s.half_u[1..][..n], &at_s.half_u[2..][..n]);
        let (h, h_w, h_s, h_sw) = (&h[1..][..n], &h[..n], &h_s[1..][..n], &h_s[..n]);
        let (u, u_s, u_se) = (&u[1..][..n], &u_s[1..][..n], &u_s[2..][..n]);
        let (v, v_w, v_s) = (&v[1..][..n], &v[..n], &v_s[1..][..n]);
        let (flux_x, flux_y) = (&mut flux_x[..n], &mut flux_y[1..][..n]);
        let (q, b) = (&mut potential_vorticity[..n], &mut bernoulli[1..][..n]);
        for i in 0..n {
            for l in 0..L {
                let h_sum = h[i][l] + h_w[i][l];
                flux_x[i][l] = mass_flux_tl(thickness_x[i], half_u[i], h_sum, u[i][l]);
                flux_y[i][l] = mass_flux_tl(thickness_y[i], half_v[i], h[i][l] + h_s[i][l], v[i][l]);
                let vorticity = constants.vorticity([u[i][l], u_s[i][l]], [v[i][l], v_w[i][l]]);
                let h_sum = h_sum + (h_s[i][l] + h_sw[i][l]);
                q[i][l] = potential_vorticity_tl(per_thickness[i], quarter_q[i], vorticity, h_sum);
                let (half_u, half_v) = ([half_u_s[i], half_u_se[i]], [half_v_s[i], half_v[i]]);
                b[i][l] =
                    constants.bernoulli_tl(half_u, half_v, h_s[i][l], [u_s[i][l], u_se[i][l]], [v_s[i][l], v[i][l]]);
            }
        }
    }
    flux_x[n] = flux_x[0];
    flux_y[0] = flux_y[n];
    potential_vorticity[n] = potential_vorticity[0];
    bernoulli[0] = bernoulli[n];
}

/// The diagnostic rows around a row: δU and δB of the row and south of it, δV and δq of the row and north of it.
#[derive(Clone, Copy)]
struct Around<'a, const L: usize> {
    flux_x_s: &'a [[f64; L]],
    flux_x: &'a [[f64; L]],
    flux_y: &'a [[f64; L]],
    flux_y_n: &'a [[f64; L]],
    q: &'a [[f64; L]],
    q_n: &'a [[f64; L]],
    b_s: &'a [[f64; L]],
    b: &'a [[f64; L]],
}

/// The tendencies of a row.
#[inline(always)]
fn tendencies<const L: usize>(
    constants: Constants,
    at: VorticityCoefficients<'_>,
    around: Around<'_, L>,
    out_h: &mut [f64],
    out_u: &mut [f64],
    out_v: &mut [f64],
) {
    let [out_h, out_u, out_v] = [out_h, out_u, out_v].map(|row| row.as_chunks_mut::<L>().0);
    let Around { flux_x_s, flux_x, flux_y, flux_y_n, q, q_n, b_s, b } = around;
    let n = out_h.len() - 2;
    let [of_q, of_q_n, of_v, of_v_n] = at.x.map(|row| &row[1..][..n]);
    let [of_q_y, of_q_e, of_u, of_u_e] = at.y.map(|row| &row[1..][..n]);
    let (u, u_e, u_s, u_se) = (&flux_x[..n], &flux_x[1..][..n], &flux_x_s[..n], &flux_x_s[1..][..n]);
    let (v, v_w, v_n, v_nw) = (&flux_y[1..][..n], &flux_y[..n], &flux_y_n[1..][..n], &flux_y_n[..n]);
    let (q, q_e, q_n) = (&q[..n], &q[1..][..n], &q_n[..n]);
    let (b, b_w, b_s) = (&b[1..][..n], &b[..n], &b_s[1..][..n]);
    let (out_h, out_u, out_v) = (&mut out_h[1..][..n], &mut out_u[1..][..n], &mut out_v[1..][..n]);
    for i in 0..n {
        let x = VorticityWeights { of_q: [of_q[i], of_q_n[i]], of_flux: [of_v[i], of_v_n[i]] };
        let y = VorticityWeights { of_q: [of_q_y[i], of_q_e[i]], of_flux: [of_u[i], of_u_e[i]] };
        for l in 0..L {
            let q_v = x.apply([q[i][l], q_n[i][l]], [v[i][l] + v_w[i][l], v_n[i][l] + v_nw[i][l]]);
            let q_u = y.apply([q[i][l], q_e[i][l]], [u[i][l] + u_s[i][l], u_e[i][l] + u_se[i][l]]);
            out_h[i][l] = constants.minus_divergence([u[i][l], u_e[i][l]], [v[i][l], v_n[i][l]]);
            out_u[i][l] = constants.minus_gradient_x(b_w[i][l], b[i][l]) + q_v;
            out_v[i][l] = constants.minus_gradient_y(b_s[i][l], b[i][l]) - q_u;
        }
    }
}
