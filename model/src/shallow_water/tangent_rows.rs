//! The tangent-linear tendency row by row for eight columns at once: the lines of [`super::tangent_linear`], with the
//! coefficients of a row of the state computed once for all columns.

use super::rows::ShallowWaterRows;
use super::{H, ShallowWater, U, V, VectorInvariant};
use crate::columns::LANES;
use crate::grid::Boundary;
use crate::scheme::MOST_PLACES;
use crate::scheme::rows::{Pushed, Row, RowStream, TangentRowStream};

use pulp::{Simd, WithSimd};

/// Values of a place of the increments: h, u and v.
const VARIABLES: usize = 3;
/// Values that a place keeps for the next row.
const KEPT: usize = 5;

/// Rows of a sweep: of the state, of its coefficients, and what the increments' next row needs.
pub(super) struct TangentRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    state: ShallowWaterRows<'a>,
    coefficients: Box<RowCoefficients>,
    /// `[x, quantity, lane]`: of the row pushed last δU, δU + δU\[S\], δV, δq; of the row south of it δB. The first
    /// place comes again at the end.
    kept: Vec<f64>,
}

/// One number for each place. (Arrays of known length, so that all are found from one address.)
type Places = [f64; MOST_PLACES];

/// Coefficients of the row pushed and of the row south of it.
struct RowCoefficients {
    /// Of the northern row.
    thickness_x: Places,
    thickness_y: Places,
    per_thickness: Places,
    quarter_q_per_thickness: Places,
    /// u/2 and v/2 of the southern and the northern row.
    half_u: [Places; 2],
    half_v: [Places; 2],
    /// Of the southern row: what multiplies δq, δq\[N\], δV + δV\[W\], δV\[N\] + δV\[NW\] in ∂u/∂t, and
    /// δq, δq\[E\], δU + δU\[S\], δU\[E\] + δU\[SE\] in −∂v/∂t.
    vorticity_term: [Places; 8],
}

impl<'a> TangentRows<'a> {
    /// For rows of at most `nx` places.
    pub fn new(model: &'a ShallowWater, nx: usize) -> Self {
        let zeros = [0.0; MOST_PLACES];
        Self {
            model,
            arch: pulp::Arch::new(),
            state: ShallowWaterRows::new(model, nx),
            coefficients: Box::new(RowCoefficients {
                thickness_x: zeros,
                thickness_y: zeros,
                per_thickness: zeros,
                quarter_q_per_thickness: zeros,
                half_u: [zeros; 2],
                half_v: [zeros; 2],
                vorticity_term: [zeros; 8],
            }),
            kept: vec![0.0; (nx + 1) * KEPT * LANES],
        }
    }
}

impl RowCoefficients {
    /// Between two rows of the state, the northern of which `rows` was told last.
    #[inline(always)]
    fn compute(&mut self, form: VectorInvariant, rows: &ShallowWaterRows<'_>, south: Row<'_>, north: Row<'_>) {
        let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
        let n = h.len();
        let ([half_u_s, half_u], [half_v_s, half_v]) = (&mut self.half_u, &mut self.half_v);
        halve(u_s, half_u_s);
        halve(u, half_u);
        halve(v_s, half_v_s);
        halve(v, half_v);
        self.thickness_of(h, h_s, &rows.q[1]);
        let q_n = &rows.q[1][..n];
        let (q, q_e) = (&rows.q[0][..n], &rows.q[0][1..][..n]);
        let (u_s, u_se) = (&rows.flux_x[0][..n], &rows.flux_x[0][1..][..n]);
        let (u, u_e) = (&rows.flux_x[1][..n], &rows.flux_x[1][1..][..n]);
        let (v_w, v) = (&rows.flux_y[0][..n], &rows.flux_y[0][1..][..n]);
        let (v_nw, v_n) = (&rows.flux_y[1][..n], &rows.flux_y[1][1..][..n]);
        let [a, a_n, b, b_n, c, c_e, d, d_e] = &mut self.vorticity_term;
        let (a, a_n, b, b_n) = (&mut a[..n], &mut a_n[..n], &mut b[..n], &mut b_n[..n]);
        let (c, c_e, d, d_e) = (&mut c[..n], &mut c_e[..n], &mut d[..n], &mut d_e[..n]);
        match form {
            VectorInvariant::PotentialEnstrophy => {
                for i in 0..n {
                    a[i] = 0.125 * (v_w[i] + v[i] + v_nw[i] + v_n[i]);
                    b[i] = 0.125 * (q[i] + q_n[i]);
                    c[i] = 0.125 * (u[i] + u_e[i] + u_s[i] + u_se[i]);
                    d[i] = 0.125 * (q[i] + q_e[i]);
                    (a_n[i], b_n[i], c_e[i], d_e[i]) = (a[i], b[i], c[i], d[i]);
                }
            }
            VectorInvariant::Energy => {
                for i in 0..n {
                    (a[i], a_n[i]) = (0.25 * (v[i] + v_w[i]), 0.25 * (v_n[i] + v_nw[i]));
                    (c[i], c_e[i]) = (0.25 * (u[i] + u_s[i]), 0.25 * (u_e[i] + u_se[i]));
                    (b[i], b_n[i], d[i], d_e[i]) = (0.25 * q[i], 0.25 * q_n[i], 0.25 * q[i], 0.25 * q_e[i]);
                }
            }
        }
    }

    /// h̄ˣ, h̄ʸ, 1/h̄ˣʸ and q/(4 h̄ˣʸ).
    #[inline(always)]
    fn thickness_of(&mut self, h: &[f64], h_s: &[f64], q: &[f64]) {
        let last = h.len() - 1;
        let place = |h: f64, h_w: f64, h_s: f64, h_sw: f64, q: f64| {
            let per_sum = 1.0 / (h + h_w + h_s + h_sw);
            (0.5 * (h + h_w), 0.5 * (h + h_s), 4.0 * per_sum, q * per_sum)
        };
        let Self { thickness_x, thickness_y, per_thickness, quarter_q_per_thickness: quarter_q, .. } = self;
        (thickness_x[0], thickness_y[0], per_thickness[0], quarter_q[0]) =
            place(h[0], h[last], h_s[0], h_s[last], q[0]);
        let (h, h_w, h_s, h_sw, q) = (&h[1..], &h[..last], &h_s[1..][..last], &h_s[..last], &q[1..][..last]);
        let (thickness_x, thickness_y) = (&mut thickness_x[1..][..last], &mut thickness_y[1..][..last]);
        let (per_thickness, quarter_q) = (&mut per_thickness[1..][..last], &mut quarter_q[1..][..last]);
        for i in 0..last {
            (thickness_x[i], thickness_y[i], per_thickness[i], quarter_q[i]) =
                place(h[i], h_w[i], h_s[i], h_sw[i], q[i]);
        }
    }
}

#[inline(always)]
fn halve(of: &[f64], out: &mut [f64]) {
    for (out, of) in out.iter_mut().zip(of) {
        *out = 0.5 * of;
    }
}

impl TangentRowStream for TangentRows<'_> {
    fn begin(&mut self, x: Row<'_>, dx: &[f64]) {
        self.state.begin(x);
        let (h, u, n) = (x.variable(H), x.variable(U), x.variable(H).len());
        let (dx, _) = dx.as_chunks::<LANES>();
        let (kept, _) = self.kept.as_chunks_mut::<LANES>();
        for i in 0..=n {
            let (i, w, out) = (i % n, (i + n - 1) % n, &mut kept[i * KEPT]);
            let (dh, dh_w, du) = (&dx[i * VARIABLES + H], &dx[w * VARIABLES + H], &dx[i * VARIABLES + U]);
            for lane in 0..LANES {
                out[lane] = 0.5 * (h[i] + h[w]) * du[lane] + 0.5 * u[i] * (dh[lane] + dh_w[lane]);
            }
        }
    }

    fn beyond_wall(&self, x: Row<'_>, dx: &[f64], ghost: &mut [f64], d_ghost: &mut [f64]) {
        self.state.beyond_wall(x, ghost);
        d_ghost.copy_from_slice(dx);
        d_ghost.as_chunks_mut::<LANES>().0.iter_mut().skip(V).step_by(VARIABLES).for_each(|v| v.fill(0.0));
    }

    fn push(&mut self, row: usize, x: Pushed<'_, Row<'_>>, dx: Pushed<'_, &[f64]>) {
        self.state.push(row, x.south, x.north, x.tendency);
        let at_wall = self.model.layout.grid.boundary == Boundary::Channel && row == 1;
        self.arch.dispatch(Push { rows: self, at_wall, x: (x.south, x.north), dx });
    }
}

/// One row of the columns, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut TangentRows<'b>,
    at_wall: bool,
    /// The southern and the northern row.
    x: (Row<'a>, Row<'a>),
    dx: Pushed<'a, &'a [f64]>,
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, at_wall, x, dx: Pushed { south, north, tendency } } = self;
        rows.coefficients.compute(rows.model.form, &rows.state, x.0, x.1);
        let vector_len = S::as_simd_f64s(&[0.0; 2 * LANES]).0.len() / 2;
        match vector_len {
            1 => push::<S, 1>(simd, rows, south, north, tendency),
            2 => push::<S, 2>(simd, rows, south, north, tendency),
            4 => push::<S, 4>(simd, rows, south, north, tendency),
            8 => push::<S, 8>(simd, rows, south, north, tendency),
            _ => panic!("no processor has vectors of which {vector_len} make eight numbers"),
        }
        let drag = rows.model.parameters.drag_per_s;
        let winds = tendency.as_chunks_mut::<{ VARIABLES * LANES }>().0.iter_mut();
        for (out, x) in winds.zip(south.as_chunks::<{ VARIABLES * LANES }>().0) {
            if drag != 0.0 {
                for k in U * LANES..VARIABLES * LANES {
                    out[k] -= drag * x[k];
                }
            }
            if at_wall {
                out[V * LANES..].fill(0.0);
            }
        }
    }
}

/// Places of `K` quantities, the lanes of each in `P` vectors.
#[inline(always)]
fn places<S: Simd, const P: usize, const K: usize>(row: &[f64]) -> &[[[S::f64s; P]; K]] {
    S::as_simd_f64s(row).0.as_chunks().0.as_chunks().0
}

/// Places of `K` quantities, the lanes of each in `P` vectors.
#[inline(always)]
fn places_mut<S: Simd, const P: usize, const K: usize>(row: &mut [f64]) -> &mut [[[S::f64s; P]; K]] {
    S::as_mut_simd_f64s(row).0.as_chunks_mut().0.as_chunks_mut().0
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
fn push<S: Simd, const P: usize>(
    simd: S,
    rows: &mut TangentRows<'_>,
    south: &[f64],
    north: &[f64],
    tendency: &mut [f64],
) {
    let grid = &rows.model.layout.grid;
    let splat = |value: f64| simd.splat_f64s(value);
    let (per_dx, per_dy) = (splat(1.0 / grid.dx_m), splat(1.0 / grid.dy_m));
    let gravity = splat(rows.model.parameters.gravity_m_per_s2);
    let (add, sub, mul) = (|a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let at = &*rows.coefficients;
    let tendency = places_mut::<S, P, VARIABLES>(tendency);
    let n = tendency.len();
    assert!((1..=MOST_PLACES).contains(&n), "a row of {n} places");
    let (south, north) = (&places::<S, P, VARIABLES>(south)[..n], &places::<S, P, VARIABLES>(north)[..n]);
    let kept = &mut places_mut::<S, P, KEPT>(&mut rows.kept)[..=n];
    let last = n - 1;
    for part in 0..P {
        // Of the place in the west, beginning with that west of the first: states, and U, U + U[S], V, q and B.
        let ([mut h_w, _, mut v_w], [mut h_sw, mut u_sw, mut v_sw]) =
            (part_of(&north[last], part), part_of(&south[last], part));
        let mut flux_y_w = add(mul(splat(at.thickness_y[last]), v_w), mul(splat(at.half_v[1][last]), add(h_w, h_sw)));
        let mut kept_w = part_of(&kept[last], part);
        let (mut q_w, mut b_ww) = (flux_y_w, flux_y_w);
        let (mut flux_y_ww, mut flux_y_sww) = (flux_y_w, flux_y_w);
        for i in 0..=n {
            let (e, w) = (if i == n { 0 } else { i }, if i == 0 { last } else { i - 1 });
            let ([h, u, v], [h_s, u_s, v_s]) = (part_of(&north[e], part), part_of(&south[e], part));
            let kept_s = part_of(&kept[i], part);
            let (sum, sum_s) = (add(h, h_w), add(h_s, h_sw));
            let flux_x = add(mul(splat(at.thickness_x[e]), u), mul(splat(at.half_u[1][e]), sum));
            let flux_y = add(mul(splat(at.thickness_y[e]), v), mul(splat(at.half_v[1][e]), add(h, h_s)));
            let vorticity = sub(mul(sub(v, v_w), per_dx), mul(sub(u, u_s), per_dy));
            let q = sub(
                mul(vorticity, splat(at.per_thickness[e])),
                mul(splat(at.quarter_q_per_thickness[e]), add(sum, sum_s)),
            );
            let kinetic_x = add(mul(splat(at.half_u[0][w]), u_sw), mul(splat(at.half_u[0][e]), u_s));
            let kinetic_y = add(mul(splat(at.half_v[0][w]), v_sw), mul(splat(at.half_v[1][w]), v_w));
            let b_w = add(mul(gravity, h_sw), add(kinetic_x, kinetic_y));
            let keep = &mut kept[i];
            (keep[0][part], keep[1][part]) = (flux_x, add(flux_x, kept_s[0]));
            (keep[2][part], keep[3][part]) = (flux_y, q);
            if i > 0 {
                let [flux_x_sw, sum_x_sw, flux_y_sw, q_sw, b_sw] = kept_w;
                let [a, a_n, m, m_n, c, c_e, d, d_e] = &at.vorticity_term;
                let (a, a_n, m, m_n) = (splat(a[w]), splat(a_n[w]), splat(m[w]), splat(m_n[w]));
                let (c, c_e, d, d_e) = (splat(c[w]), splat(c_e[w]), splat(d[w]), splat(d_e[w]));
                kept[w][4][part] = b_w;
                let out = &mut tendency[w];
                out[H][part] = add(mul(sub(flux_x_sw, kept_s[0]), per_dx), mul(sub(flux_y_sw, flux_y_w), per_dy));
                let of_q = add(mul(a, q_sw), mul(a_n, q_w));
                let of_flux = add(mul(m, add(flux_y_sw, flux_y_sww)), mul(m_n, add(flux_y_w, flux_y_ww)));
                out[U][part] = add(mul(sub(b_ww, b_w), per_dx), add(of_q, of_flux));
                let of_q = add(mul(c, q_sw), mul(c_e, kept_s[3]));
                let of_flux = add(mul(d, sum_x_sw), mul(d_e, kept_s[1]));
                out[V][part] = sub(mul(sub(b_sw, b_w), per_dy), add(of_q, of_flux));
            }
            (h_w, v_w, h_sw, u_sw, v_sw) = (h, v, h_s, u_s, v_s);
            (flux_y_ww, flux_y_w, flux_y_sww) = (flux_y_w, flux_y, kept_w[2]);
            (q_w, b_ww, kept_w) = (q, b_w, kept_s);
        }
    }
}
