//! The tangent-linear tendency row by row for a group of columns at once: the lines of [`super::tangent_rows`] in vector
//! operations, in one pass from west to east, with the same bits.
//!
//! The same lines over arrays of eight lanes were measured to take about half as long again, and dual numbers of eight
//! directions in the lines of f three times as long (AVX-512; other programs were running on the machine, so the ratios are
//! rough).

use super::kernel::{Constants, mass_flux_tl};
use super::lanes::{for_vectors, places, places_mut};
use super::row_coefficients::RowCoefficients;
use super::rows::{ShallowWaterRows, continue_evenly, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};
use crate::stored::Stored;

use pulp::{Simd, WithSimd};

/// Values that a place keeps for the next row.
const KEPT: usize = 5;

/// Rows of a sweep: of the state, of its coefficients, and what the increments' next row needs.
pub(super) struct TangentLanes<'a, N> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: RowCoefficients<N>,
    /// `[x, quantity, lane]`: of the row pushed last δU, δU + δU\[S\], δV, δq; of the row south of it δB. The first
    /// place comes again at the end.
    kept: Vec<N>,
}

impl<'a, N: Stored> TangentLanes<'a, N> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx, 1),
            coefficients: RowCoefficients::new(model, nx, 2),
            kept: vec![N::default(); (nx + 1) * KEPT * N::COLUMNS],
        }
    }
}

impl<N: Stored> TangentRowStream<N> for TangentLanes<'_, N> {
    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>) {
        self.state.begin(row, x);
        self.coefficients.begin(row, x);
        let ([h, u], [dh, du]) = (x.variables(), dx.variables().map(N::as_places));
        let (n, kept) = (h.len(), N::as_places_mut(&mut self.kept));
        for place in 0..=n {
            let (i, out) = (place % n, kept[place * KEPT].as_mut());
            let [thickness, half_u] = [0.5 * (h[i] + h[(i + n - 1) % n]), 0.5 * u[i]].map(N::narrow);
            let (dh, dh_w, du) = (dh[i + 1].as_ref(), dh[i].as_ref(), du[i + 1].as_ref());
            for lane in 0..N::COLUMNS {
                out[lane] = mass_flux_tl(thickness, half_u, dh[lane] + dh_w[lane], du[lane]);
            }
        }
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

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b, N> {
    rows: &'a mut TangentLanes<'b, N>,
    row: isize,
    /// The southern and the northern row.
    x: [Row<'a>; 2],
    dx: Pushed<'a, N>,
}

impl<N: Stored> WithSimd for Push<'_, '_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, row, x: [x_south, x_north], dx: Pushed { south, north, tendency } } = self;
        rows.coefficients.push(simd, row, &rows.state.diagnostics, x_south, x_north);
        for_vectors!(S, N, P => push::<S, N, P>(simd, rows, row, south, north, tendency));
        finish_columns(rows.model, row, south, tendency, N::COLUMNS);
    }
}

/// One vector of each quantity of a place.
#[inline(always)]
fn part_of<V: Copy, const P: usize, const K: usize>(place: &[[V; P]; K], part: usize) -> [V; K] {
    let mut vectors = [place[0][part]; K];
    for quantity in 1..K {
        vectors[quantity] = place[quantity][part];
    }
    vectors
}

/// The tendency of the southern row, and what the next will need, in one pass from west to east. What the stencils
/// reach for in the west is carried along.
#[inline(always)]
fn push<S: Simd, N: Stored, const P: usize>(
    simd: S,
    rows: &mut TangentLanes<'_, N>,
    row: isize,
    south: Row<'_, N>,
    north: Row<'_, N>,
    tendency: &mut [N],
) {
    let [gravity, per_dx, per_dy] = Constants::<N>::new(rows.model).splat(simd);
    let splat = |value: N| N::splat(simd, value);
    let add = |a, b| N::sum(simd, a, b);
    let (sub, mul) = (|a, b| N::difference(simd, a, b), |a, b| N::product(simd, a, b));
    let (out_h, winds) = tendency.split_at_mut(tendency.len() / VARIABLES);
    let (out_u, out_v) = winds.split_at_mut(out_h.len());
    let [out_h, out_u, out_v] = [out_h, out_u, out_v].map(places_mut::<S, N, P>);
    // Place i is at i + 1.
    let padded = out_h.len();
    let n = padded - 2;
    let (out_u, out_v) = (&mut out_u[..padded], &mut out_v[..padded]);
    let [north_h, north_u, north_v] = north.variables().map(|row| &places::<S, N, P>(row)[..padded]);
    let [south_h, south_u, south_v] = south.variables().map(|row| &places::<S, N, P>(row)[..padded]);
    let (at_s, at) = (rows.coefficients.places(row - 1, n), rows.coefficients.places(row, n));
    let (thickness_x, thickness_y) = (&at.thickness_x[..padded], &at.thickness_y[..padded]);
    let (per_thickness, quarter_q) = (&at.per_thickness[..padded], &at.quarter_q_per_thickness[..padded]);
    let (half_u, half_u_s) = (&at.half_u[..padded], &at_s.half_u[..padded]);
    let (half_v, half_v_s) = (&at.half_v[..padded], &at_s.half_v[..padded]);
    let term = rows.coefficients.vorticity_term(row - 1, n);
    let [a, a_n, m, m_n] = term.x.map(|row| &row[..=n]);
    let [c, c_e, d, d_e] = term.y.map(|row| &row[..=n]);
    let kept = &mut places_mut::<S, N, P>(&mut rows.kept).as_chunks_mut::<KEPT>().0[..=n];
    for part in 0..P {
        // Of the place in the west, beginning with that west of the first: states, and U, U + U[S], V, q and B.
        let (mut h_w, mut v_w) = (north_h[0][part], north_v[0][part]);
        let (mut h_sw, mut u_sw, mut v_sw) = (south_h[0][part], south_u[0][part], south_v[0][part]);
        let mut flux_y_w = add(mul(splat(thickness_y[0]), v_w), mul(splat(half_v[0]), add(h_w, h_sw)));
        let mut kept_w = part_of(&kept[n - 1], part);
        let (mut q_w, mut b_ww) = (flux_y_w, flux_y_w);
        let (mut flux_y_ww, mut flux_y_sww) = (flux_y_w, flux_y_w);
        for w in 0..=n {
            let e = w + 1;
            let (h, u, v) = (north_h[e][part], north_u[e][part], north_v[e][part]);
            let (h_s, u_s, v_s) = (south_h[e][part], south_u[e][part], south_v[e][part]);
            let kept_s = part_of(&kept[w], part);
            let (sum, sum_s) = (add(h, h_w), add(h_s, h_sw));
            let flux_x = add(mul(splat(thickness_x[e]), u), mul(splat(half_u[e]), sum));
            let flux_y = add(mul(splat(thickness_y[e]), v), mul(splat(half_v[e]), add(h, h_s)));
            let vorticity = sub(mul(sub(v, v_w), per_dx), mul(sub(u, u_s), per_dy));
            let q = sub(mul(vorticity, splat(per_thickness[e])), mul(splat(quarter_q[e]), add(sum, sum_s)));
            let kinetic_x = add(mul(splat(half_u_s[w]), u_sw), mul(splat(half_u_s[e]), u_s));
            let kinetic_y = add(mul(splat(half_v_s[w]), v_sw), mul(splat(half_v[w]), v_w));
            let b_w = add(mul(gravity, h_sw), add(kinetic_x, kinetic_y));
            let keep = &mut kept[w];
            (keep[0][part], keep[1][part]) = (flux_x, add(flux_x, kept_s[0]));
            (keep[2][part], keep[3][part]) = (flux_y, q);
            if w > 0 {
                let [flux_x_sw, sum_x_sw, flux_y_sw, q_sw, b_sw] = kept_w;
                let (a, a_n, m, m_n) = (splat(a[w]), splat(a_n[w]), splat(m[w]), splat(m_n[w]));
                let (c, c_e, d, d_e) = (splat(c[w]), splat(c_e[w]), splat(d[w]), splat(d_e[w]));
                kept[w - 1][4][part] = b_w;
                out_h[w][part] = add(mul(sub(flux_x_sw, kept_s[0]), per_dx), mul(sub(flux_y_sw, flux_y_w), per_dy));
                let of_q = add(mul(a, q_sw), mul(a_n, q_w));
                let of_flux = add(mul(m, add(flux_y_sw, flux_y_sww)), mul(m_n, add(flux_y_w, flux_y_ww)));
                out_u[w][part] = add(mul(sub(b_ww, b_w), per_dx), add(of_q, of_flux));
                let of_q = add(mul(c, q_sw), mul(c_e, kept_s[3]));
                let of_flux = add(mul(d, sum_x_sw), mul(d_e, kept_s[1]));
                out_v[w][part] = sub(mul(sub(b_sw, b_w), per_dy), add(of_q, of_flux));
            }
            (h_w, v_w, h_sw, u_sw, v_sw) = (h, v, h_s, u_s, v_s);
            (flux_y_ww, flux_y_w, flux_y_sww) = (flux_y_w, flux_y, kept_w[2]);
            (q_w, b_ww, kept_w) = (q, b_w, kept_s);
        }
    }
}
