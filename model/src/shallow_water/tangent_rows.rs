//! The tangent-linear tendency row by row for a column alone: the derivatives in [`super::kernel`].

use super::kernel::{Constants, VorticityWeights, mass_flux_tl, potential_vorticity_tl};
use super::row_coefficients::{PlaceCoefficients, RowCoefficients, VorticityCoefficients};
use super::rows::{Around, DiagnosticRows, ShallowWaterRows, continue_evenly, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};
use crate::stored::Stored;

use pulp::{Simd, WithSimd};

/// Rows of a sweep with one column: of the state, of its coefficients, and the diagnostic rows' increments.
pub(super) struct TangentRows<'a, N> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients<N>,
    increments: DiagnosticRows<N>,
}

impl<'a, N: Stored> TangentRows<'a, N> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx, 1),
            coefficients: RowCoefficients::new(model, nx, 2),
            increments: DiagnosticRows::new(nx, 1),
        }
    }
}

impl<N: Stored> TangentRowStream<N> for TangentRows<'_, N> {
    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>) {
        self.state.begin(x);
        self.coefficients.begin(row, x);
        let ([h, u], [dh, du]) = (x.variables(), dx.variables());
        let (n, flux) = (h.len(), &mut self.increments.flux_x[2]);
        for i in 0..n {
            let [thickness, half_u] = [0.5 * (h[i] + h[(i + n - 1) % n]), 0.5 * u[i]].map(N::narrow);
            flux[i] = mass_flux_tl(thickness, half_u, dh[i + 1] + dh[i], du[i + 1]);
        }
        flux[n] = flux[0];
    }

    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_, N>, ghost: &mut [f64], d_ghost: &mut [N]) {
        self.state.beyond_wall(x, ghost);
        continue_evenly(dx, d_ghost);
    }

    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_, N>) {
        self.state.push(self.model.grid_row(row), x.south, x.north, x.tendency);
        self.increments.advance();
        self.arch.dispatch(Push { rows: self, row, x: [x.south, x.north], dx });
    }
}

/// One row of the column, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b, N> {
    rows: &'a mut TangentRows<'b, N>,
    row: isize,
    /// The southern and the northern row.
    x: [Row<'a>; 2],
    dx: Pushed<'a, N>,
}

impl<N: Stored> WithSimd for Push<'_, '_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Push { rows, row, x: [x_south, x_north], dx: Pushed { south, north, tendency } } = self;
        let TangentRows { model, state, coefficients, increments, .. } = rows;
        coefficients.push(row, &state.diagnostics, x_south, x_north);
        let coefficients = &*coefficients;
        let constants = Constants::new(model);
        let stride = tendency.len() / VARIABLES;
        let n = stride - 2;
        let places = [row - 1, row].map(|row| coefficients.places(row, n));
        let DiagnosticRows { flux_x, flux_y, q, bernoulli } = increments;
        diagnose(constants, places, south, north, &mut flux_x[2], &mut flux_y[1], &mut q[1], &mut bernoulli[1]);
        let (out_h, winds) = tendency.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        let term = coefficients.vorticity_term(row - 1, n);
        tendencies(constants, term, increments.around(), out_h, out_u, out_v);
        finish_columns(model, row, south, tendency, 1);
    }
}

/// δU, δV and δq of the northern row, δB of the southern, in one loop.
#[inline(always)]
fn diagnose<N: Stored>(
    constants: Constants<N>,
    [at_s, at]: [PlaceCoefficients<'_, N>; 2],
    south: Row<'_, N>,
    north: Row<'_, N>,
    flux_x: &mut [N],
    flux_y: &mut [N],
    potential_vorticity: &mut [N],
    bernoulli: &mut [N],
) {
    let [h_s, u_s, v_s] = south.variables();
    let [h, u, v] = north.variables();
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
            let h_sum = h[i] + h_w[i];
            flux_x[i] = mass_flux_tl(thickness_x[i], half_u[i], h_sum, u[i]);
            flux_y[i] = mass_flux_tl(thickness_y[i], half_v[i], h[i] + h_s[i], v[i]);
            let vorticity = constants.vorticity([u[i], u_s[i]], [v[i], v_w[i]]);
            let h_sum = h_sum + (h_s[i] + h_sw[i]);
            q[i] = potential_vorticity_tl(per_thickness[i], quarter_q[i], vorticity, h_sum);
            let (half_u, half_v) = ([half_u_s[i], half_u_se[i]], [half_v_s[i], half_v[i]]);
            b[i] = constants.bernoulli_tl(half_u, half_v, h_s[i], [u_s[i], u_se[i]], [v_s[i], v[i]]);
        }
    }
    flux_x[n] = flux_x[0];
    flux_y[0] = flux_y[n];
    potential_vorticity[n] = potential_vorticity[0];
    bernoulli[0] = bernoulli[n];
}

/// The tendencies of a row.
#[inline(always)]
fn tendencies<N: Stored>(
    constants: Constants<N>,
    at: VorticityCoefficients<'_, N>,
    around: Around<'_, N>,
    out_h: &mut [N],
    out_u: &mut [N],
    out_v: &mut [N],
) {
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
        let q_v = x.apply([q[i], q_n[i]], [v[i] + v_w[i], v_n[i] + v_nw[i]]);
        let q_u = y.apply([q[i], q_e[i]], [u[i] + u_s[i], u_e[i] + u_se[i]]);
        out_h[i] = constants.minus_divergence([u[i], u_e[i]], [v[i], v_n[i]]);
        out_u[i] = constants.minus_gradient_x(b_w[i], b[i]) + q_v;
        out_v[i] = constants.minus_gradient_y(b_s[i], b[i]) - q_u;
    }
}
