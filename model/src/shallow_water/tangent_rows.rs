//! The tangent-linear tendency row by row for a column alone: the derivatives in [`super::kernel`].

use super::kernel::{Constants, VorticityWeights, mass_flux_tl, potential_vorticity_tl};
use super::row_coefficients::{Coefficient, PlaceCoefficients, RowCoefficients, VorticityCoefficients};
use super::rows::{Around, DiagnosticRows, ShallowWaterRows, continue_evenly, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};
use crate::stored::Stored;

use pulp::{Simd, WithSimd};

/// Rows of a sweep with one column: of the state, of its coefficients, and of increments.
pub(super) struct TangentRows<'a, N> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients<N>,
    increments: IncrementRows<N>,
}

impl<'a, N: Stored> TangentRows<'a, N> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx, 1),
            coefficients: RowCoefficients::new(model, nx, 2),
            increments: IncrementRows::new(nx, 1),
        }
    }
}

impl<N: Stored> TangentRowStream<N> for TangentRows<'_, N> {
    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>) {
        self.state.begin(row, x);
        self.coefficients.begin(row, x);
        let [h, u] = x.variables();
        let n = h.len();
        self.increments.begin(dx, |i| [0.5 * (h[i] + h[(i + n - 1) % n]), 0.5 * u[i]].map(N::narrow));
    }

    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_, N>, ghost: &mut [f64], d_ghost: &mut [N]) {
        self.state.beyond_wall(x, ghost);
        continue_evenly(dx, d_ghost);
    }

    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_, N>) {
        self.state.push(self.model.grid_row(row), x.south, x.north, x.tendency);
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
        let stride = tendency.len() / VARIABLES;
        let n = stride - 2;
        let places = [row - 1, row].map(|row| coefficients.places(row, n));
        let (out_h, winds) = tendency.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        let out = [out_h, out_u, out_v].map(|out| &mut out[1..][..n]);
        let term = coefficients.vorticity_term(row - 1, n);
        increments.push(Constants::new(model), places, term, south, north, out);
        finish_columns(model, row, south, tendency, 1);
    }
}

/// The derivative of the tendency by rows of increments that lie interleaved, `[variable, x, lane]`, each variable with the place
/// before its first and the place after its last. Coefficients lie in the same way, the same in all lanes, or are the same at all
/// places.
pub(super) struct IncrementRows<N = f64> {
    lanes: usize,
    diagnostics: DiagnosticRows<N>,
}

impl<N: Stored> IncrementRows<N> {
    /// For rows of at most `nx` places of `lanes` increments.
    pub fn new(nx: usize, lanes: usize) -> Self {
        Self { lanes, diagnostics: DiagnosticRows::new(nx, lanes) }
    }

    /// Begins a sweep with its first row, given h̄ˣ and u/2 of each value.
    pub fn begin(&mut self, dx: Row<'_, N>, at: impl Fn(usize) -> [N; 2]) {
        let ([h, u], lanes, flux) = (dx.variables(), self.lanes, &mut self.diagnostics.flux_x[2]);
        let n = h.len() - 2 * lanes;
        for i in 0..n {
            let [thickness, half_u] = at(i);
            flux[i] = mass_flux_tl(thickness, half_u, h[lanes + i] + h[i], u[lanes + i]);
        }
        flux.copy_within(..lanes, n);
    }

    /// Takes a row, `north`, and the row south of it, the coefficients of both rows' places and those of the vorticity term of the
    /// southern row. Writes the derivative of the tendency of the southern row, of h, u and v, without the places at its ends,
    /// damping and walls.
    #[inline(always)]
    pub fn push<C: Coefficient<N>>(
        &mut self,
        constants: Constants<N>,
        places: [PlaceCoefficients<C>; 2],
        term: VorticityCoefficients<C>,
        south: Row<'_, N>,
        north: Row<'_, N>,
        out: [&mut [N]; VARIABLES],
    ) {
        match self.lanes {
            // With a constant in the place of it the ends of a row are no loops.
            1 => self.push_lanes(1, constants, places, term, south, north, out),
            lanes => self.push_lanes(lanes, constants, places, term, south, north, out),
        }
    }

    #[inline(always)]
    fn push_lanes<C: Coefficient<N>>(
        &mut self,
        lanes: usize,
        constants: Constants<N>,
        places: [PlaceCoefficients<C>; 2],
        term: VorticityCoefficients<C>,
        south: Row<'_, N>,
        north: Row<'_, N>,
        [out_h, out_u, out_v]: [&mut [N]; VARIABLES],
    ) {
        self.diagnostics.advance();
        let DiagnosticRows { flux_x, flux_y, q, bernoulli } = &mut self.diagnostics;
        let (flux_x, flux_y, q, b) = (&mut flux_x[2], &mut flux_y[1], &mut q[1], &mut bernoulli[1]);
        diagnose(constants, lanes, places, south, north, flux_x, flux_y, q, b);
        tendencies(constants, lanes, term, self.diagnostics.around(), out_h, out_u, out_v);
    }
}

/// δU, δV and δq of the northern row, δB of the southern, in one loop.
#[inline(always)]
fn diagnose<N: Stored, C: Coefficient<N>>(
    constants: Constants<N>,
    lanes: usize,
    [at_s, at]: [PlaceCoefficients<C>; 2],
    south: Row<'_, N>,
    north: Row<'_, N>,
    flux_x: &mut [N],
    flux_y: &mut [N],
    potential_vorticity: &mut [N],
    bernoulli: &mut [N],
) {
    let [h_s, u_s, v_s] = south.variables();
    let [h, u, v] = north.variables();
    let n = h.len() - 2 * lanes;
    {
        let own = |coefficient: C| coefficient.from(lanes).take(n);
        let (thickness_x, thickness_y) = (own(at.thickness_x), own(at.thickness_y));
        let (per_thickness, quarter_q) = (own(at.per_thickness), own(at.quarter_q_per_thickness));
        let (half_u, half_v, half_v_s) = (own(at.half_u), own(at.half_v), own(at_s.half_v));
        let (half_u_s, half_u_se) = (own(at_s.half_u), own(at_s.half_u.from(lanes)));
        let (h, h_w, h_s, h_sw) = (&h[lanes..][..n], &h[..n], &h_s[lanes..][..n], &h_s[..n]);
        let (u, u_s, u_se) = (&u[lanes..][..n], &u_s[lanes..][..n], &u_s[2 * lanes..][..n]);
        let (v, v_w, v_s) = (&v[lanes..][..n], &v[..n], &v_s[lanes..][..n]);
        let (flux_x, flux_y) = (&mut flux_x[..n], &mut flux_y[lanes..][..n]);
        let (q, b) = (&mut potential_vorticity[..n], &mut bernoulli[lanes..][..n]);
        // What is written comes last, so that what is read is read once.
        for i in 0..n {
            let sum_x = h[i] + h_w[i];
            let of_x = mass_flux_tl(thickness_x.at(i), half_u.at(i), sum_x, u[i]);
            let of_y = mass_flux_tl(thickness_y.at(i), half_v.at(i), h[i] + h_s[i], v[i]);
            let vorticity = constants.vorticity([u[i], u_s[i]], [v[i], v_w[i]]);
            let h_sum = sum_x + (h_s[i] + h_sw[i]);
            let of_q = potential_vorticity_tl(per_thickness.at(i), quarter_q.at(i), vorticity, h_sum);
            let (half_u, half_v) = ([half_u_s.at(i), half_u_se.at(i)], [half_v_s.at(i), half_v.at(i)]);
            let of_b = constants.bernoulli_tl(half_u, half_v, h_s[i], [u_s[i], u_se[i]], [v_s[i], v[i]]);
            (flux_x[i], flux_y[i], q[i], b[i]) = (of_x, of_y, of_q, of_b);
        }
    }
    flux_x.copy_within(..lanes, n);
    flux_y.copy_within(n..n + lanes, 0);
    potential_vorticity.copy_within(..lanes, n);
    bernoulli.copy_within(n..n + lanes, 0);
}

/// The tendencies of a row.
#[inline(always)]
fn tendencies<N: Stored, C: Coefficient<N>>(
    constants: Constants<N>,
    lanes: usize,
    at: VorticityCoefficients<C>,
    around: Around<'_, N>,
    out_h: &mut [N],
    out_u: &mut [N],
    out_v: &mut [N],
) {
    let Around { flux_x_s, flux_x, flux_y, flux_y_n, q, q_n, b_s, b } = around;
    let n = out_h.len();
    let [of_q, of_q_n, of_v, of_v_n] = at.x.map(|coefficient| coefficient.from(lanes).take(n));
    let [of_q_y, of_q_e, of_u, of_u_e] = at.y.map(|coefficient| coefficient.from(lanes).take(n));
    let (u, u_e, u_s, u_se) = (&flux_x[..n], &flux_x[lanes..][..n], &flux_x_s[..n], &flux_x_s[lanes..][..n]);
    let (v, v_w, v_n, v_nw) = (&flux_y[lanes..][..n], &flux_y[..n], &flux_y_n[lanes..][..n], &flux_y_n[..n]);
    let (q, q_e, q_n) = (&q[..n], &q[lanes..][..n], &q_n[..n]);
    let (b, b_w, b_s) = (&b[lanes..][..n], &b[..n], &b_s[lanes..][..n]);
    let (out_u, out_v) = (&mut out_u[..n], &mut out_v[..n]);
    for i in 0..n {
        let x = VorticityWeights { of_q: [of_q.at(i), of_q_n.at(i)], of_flux: [of_v.at(i), of_v_n.at(i)] };
        let y = VorticityWeights { of_q: [of_q_y.at(i), of_q_e.at(i)], of_flux: [of_u.at(i), of_u_e.at(i)] };
        let q_v = x.apply([q[i], q_n[i]], [v[i] + v_w[i], v_n[i] + v_nw[i]]);
        let q_u = y.apply([q[i], q_e[i]], [u[i] + u_s[i], u_e[i] + u_se[i]]);
        let of_h = constants.minus_divergence([u[i], u_e[i]], [v[i], v_n[i]]);
        let of_u = constants.minus_gradient_x(b_w[i], b[i]) + q_v;
        let of_v = constants.minus_gradient_y(b_s[i], b[i]) - q_u;
        (out_h[i], out_u[i], out_v[i]) = (of_h, of_u, of_v);
    }
}
