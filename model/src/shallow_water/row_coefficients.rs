//! The coefficients of f' in the rows of a sweep, computed once for all columns, in double precision, and kept in that of the
//! columns.

use super::rows::DiagnosticRows;
use super::{H, ShallowWater, U, V, VectorInvariant};
use crate::places::Places;
use crate::scheme::rows::{Ring, Row};
use crate::scheme::strips::periodic_row;
use crate::stored::Stored;

/// Of each of the latest rows, each quantity at all places, with the place before the first and that after the last.
pub(super) struct RowCoefficients<N = f64> {
    form: VectorInvariant,
    /// `[quantity, x]`.
    ring: Ring<N>,
    /// Length of a quantity in a row of the ring, and in the rows of the present sweep.
    stride: usize,
    len: usize,
}

/// Number of quantities of a row: h̄ˣ, h̄ʸ, 1/h̄ˣʸ, q/(4 h̄ˣʸ), u/2, v/2; and of the vorticity term, in the form that conserves
/// potential enstrophy, V̄ˣʸ/2 and q̄ʸ/4 at x-faces, Ūˣʸ/2 and q̄ˣ/4 at y-faces, in that which conserves energy V̄ˣ/2, q/4 and
/// Ūʸ/2 at corners.
pub(super) const QUANTITIES: usize = 10;

/// Where the vorticity term's quantities are in a row.
const OF_Q_AT_X_FACES: usize = 6;
const OF_FLUX_AT_X_FACES: usize = 7;
const OF_Q_AT_Y_FACES: usize = 8;
const OF_FLUX_AT_Y_FACES: usize = 9;

/// A coefficient of the places of a row: a value for each, or one for all.
pub(super) trait Coefficient<N>: Copy {
    /// Without the values before one.
    fn from(self, first: usize) -> Self;

    /// No more values than this.
    fn take(self, count: usize) -> Self;

    /// Those of some places.
    fn at<P: Places<N>>(self, places: P, first: usize) -> P::Number;
}

impl<N: Stored> Coefficient<N> for &[N] {
    #[inline(always)]
    fn from(self, first: usize) -> Self {
        &self[first..]
    }

    #[inline(always)]
    fn take(self, count: usize) -> Self {
        &self[..count]
    }

    #[inline(always)]
    fn at<P: Places<N>>(self, places: P, first: usize) -> P::Number {
        places.read(self, first)
    }
}

impl<N: Stored> Coefficient<N> for N {
    #[inline(always)]
    fn from(self, _first: usize) -> Self {
        self
    }

    #[inline(always)]
    fn take(self, _count: usize) -> Self {
        self
    }

    #[inline(always)]
    fn at<P: Places<N>>(self, places: P, _first: usize) -> P::Number {
        places.all(self)
    }
}

/// The coefficients of the places of a row, but for the vorticity term. With a value for each, place i is at i + 1.
#[derive(Clone, Copy)]
pub(super) struct PlaceCoefficients<C> {
    /// h̄ˣ.
    pub thickness_x: C,
    /// h̄ʸ.
    pub thickness_y: C,
    /// 1/h̄ˣʸ.
    pub per_thickness: C,
    /// q/(4 h̄ˣʸ).
    pub quarter_q_per_thickness: C,
    /// u/2.
    pub half_u: C,
    /// v/2.
    pub half_v: C,
}

/// What multiplies in ∂u/∂t of a row: δq, δq\[N\], δV + δV\[W\], δV\[N\] + δV\[NW\] (`x`), and in −∂v/∂t: δq, δq\[E\], δU + δU\[S\],
/// δU\[E\] + δU\[SE\] (`y`). With a value for each place, place i is at i + 1.
#[derive(Clone, Copy)]
pub(super) struct VorticityCoefficients<C> {
    pub x: [C; 4],
    pub y: [C; 4],
}

impl<C> PlaceCoefficients<C> {
    /// Given the quantities of the row.
    #[inline(always)]
    pub fn of(quantity: impl Fn(usize) -> C) -> Self {
        Self {
            thickness_x: quantity(0),
            thickness_y: quantity(1),
            per_thickness: quantity(2),
            quarter_q_per_thickness: quantity(3),
            half_u: quantity(4),
            half_v: quantity(5),
        }
    }
}

impl<C: Copy> VorticityCoefficients<C> {
    /// Given the quantities of the row and of the one north of it, with `lanes` values for each place.
    #[inline(always)]
    pub fn of<N>(
        form: VectorInvariant,
        lanes: usize,
        quantity: impl Fn(usize) -> C,
        of_north: impl Fn(usize) -> C,
    ) -> Self
    where
        C: Coefficient<N>,
    {
        let [a, b, c] = [OF_Q_AT_X_FACES, OF_FLUX_AT_X_FACES, OF_Q_AT_Y_FACES].map(&quantity);
        match form {
            VectorInvariant::PotentialEnstrophy => {
                let d = quantity(OF_FLUX_AT_Y_FACES);
                Self { x: [a, a, b, b], y: [c, c, d, d] }
            }
            VectorInvariant::Energy => {
                let [a_n, b_n] = [OF_Q_AT_X_FACES, OF_FLUX_AT_X_FACES].map(of_north);
                Self { x: [a, a_n, b, b_n], y: [c, c.from(lanes), b, b.from(lanes)] }
            }
        }
    }
}

impl<N: Stored> RowCoefficients<N> {
    /// For rows of at most `nx` places, of which `depth` are kept.
    pub fn new(model: &ShallowWater, nx: usize, depth: usize) -> Self {
        let stride = nx + 2;
        Self { form: model.form, ring: Ring::new(QUANTITIES * stride, depth), stride, len: stride }
    }

    /// Begins a sweep with its first row.
    pub fn begin(&mut self, row: isize, x: Row<'_>) {
        self.len = x.variable(H).len() + 2;
        let [.., half_u, half_v, _, _, _, _] = self.quantities_mut(row);
        halve(x.variable(U), half_u);
        halve(x.variable(V), half_v);
    }

    /// Takes row `row` of the state, `north`, the row south of it, and the diagnostic rows once it was pushed. The places of
    /// that row are known from now on, and the vorticity term south of it.
    #[inline(always)]
    pub fn push(&mut self, row: isize, rows: &DiagnosticRows, south: Row<'_>, north: Row<'_>) {
        let (h, h_s, form) = (north.variable(H), south.variable(H), self.form);
        let n = h.len();
        let [thickness_x, thickness_y, per_thickness, quarter_q, half_u, half_v, a, b, c, _] = self.quantities_mut(row);
        halve(north.variable(U), half_u);
        halve(north.variable(V), half_v);
        thickness_of(h, h_s, &rows.q[1], [thickness_x, thickness_y, per_thickness, quarter_q]);
        if form == VectorInvariant::Energy {
            let (u_s, u, v_w, v) =
                (&rows.flux_x[1][..n], &rows.flux_x[2][..n], &rows.flux_y[1][..n], &rows.flux_y[1][1..][..n]);
            let (q, a_own, b_own, c_own) = (&rows.q[1][..n], &mut a[1..][..n], &mut b[1..][..n], &mut c[1..][..n]);
            for i in 0..n {
                a_own[i] = N::narrow(0.25 * (v[i] + v_w[i]));
                b_own[i] = N::narrow(0.25 * q[i]);
                c_own[i] = N::narrow(0.25 * (u[i] + u_s[i]));
            }
            for row in [a, b, c] {
                periodic_row(row, 1);
            }
            return;
        }
        let [.., a, b, c, d] = self.quantities_mut(row - 1);
        let (q, q_e, q_n) = (&rows.q[0][..n], &rows.q[0][1..][..n], &rows.q[1][..n]);
        let (u_s, u_se) = (&rows.flux_x[0][..n], &rows.flux_x[0][1..][..n]);
        let (u, u_e) = (&rows.flux_x[1][..n], &rows.flux_x[1][1..][..n]);
        let (v_w, v) = (&rows.flux_y[0][..n], &rows.flux_y[0][1..][..n]);
        let (v_nw, v_n) = (&rows.flux_y[1][..n], &rows.flux_y[1][1..][..n]);
        let (a_own, b_own, c_own, d_own) = (&mut a[1..][..n], &mut b[1..][..n], &mut c[1..][..n], &mut d[1..][..n]);
        for i in 0..n {
            a_own[i] = N::narrow(0.125 * (v_w[i] + v[i] + v_nw[i] + v_n[i]));
            b_own[i] = N::narrow(0.125 * (q[i] + q_n[i]));
            c_own[i] = N::narrow(0.125 * (u[i] + u_e[i] + u_s[i] + u_se[i]));
            d_own[i] = N::narrow(0.125 * (q[i] + q_e[i]));
        }
        for row in [a, b, c, d] {
            periodic_row(row, 1);
        }
    }

    /// Those of a row, at the `n` places in its middle.
    #[inline(always)]
    pub fn places(&self, row: isize, n: usize) -> PlaceCoefficients<&[N]> {
        PlaceCoefficients::of(|quantity| self.quantity(row, quantity, n))
    }

    /// Those of a row, at the `n` places in its middle.
    #[inline(always)]
    pub fn vorticity_term(&self, row: isize, n: usize) -> VorticityCoefficients<&[N]> {
        let quantity = |row| move |quantity| self.quantity(row, quantity, n);
        VorticityCoefficients::of(self.form, 1, quantity(row), quantity(row + 1))
    }

    #[inline(always)]
    fn quantity(&self, row: isize, quantity: usize, n: usize) -> &[N] {
        &self.ring.row(row)[quantity * self.stride + (self.len - (n + 2)) / 2..][..n + 2]
    }

    #[inline(always)]
    fn quantities_mut(&mut self, row: isize) -> [&mut [N]; QUANTITIES] {
        let mut rest = self.ring.row_mut(row);
        std::array::from_fn(|_| {
            let (quantity, others) = std::mem::take(&mut rest).split_at_mut(self.stride);
            rest = others;
            &mut quantity[..self.len]
        })
    }
}

/// Half a row, periodic.
#[inline(always)]
fn halve<N: Stored>(of: &[f64], out: &mut [N]) {
    for (out, of) in out[1..].iter_mut().zip(of) {
        *out = N::narrow(0.5 * of);
    }
    periodic_row(out, 1);
}

/// h̄ˣ, h̄ʸ, 1/h̄ˣʸ and q/(4 h̄ˣʸ).
#[inline(always)]
fn thickness_of<N: Stored>(h: &[f64], h_s: &[f64], q: &[f64], out: [&mut [N]; 4]) {
    let last = h.len() - 1;
    let place = |h: f64, h_w: f64, h_s: f64, h_sw: f64, q: f64| {
        let per_sum = 1.0 / (h + h_w + h_s + h_sw);
        let (thickness_x, thickness_y) = (N::narrow(0.5 * (h + h_w)), N::narrow(0.5 * (h + h_s)));
        (thickness_x, thickness_y, N::narrow(4.0 * per_sum), N::narrow(q * per_sum))
    };
    let [thickness_x, thickness_y, per_thickness, quarter_q] = out;
    (thickness_x[1], thickness_y[1], per_thickness[1], quarter_q[1]) = place(h[0], h[last], h_s[0], h_s[last], q[0]);
    {
        let (h, h_w, h_s, h_sw, q) = (&h[1..], &h[..last], &h_s[1..][..last], &h_s[..last], &q[1..][..last]);
        let (thickness_x, thickness_y) = (&mut thickness_x[2..][..last], &mut thickness_y[2..][..last]);
        let (per_thickness, quarter_q) = (&mut per_thickness[2..][..last], &mut quarter_q[2..][..last]);
        for i in 0..last {
            (thickness_x[i], thickness_y[i], per_thickness[i], quarter_q[i]) =
                place(h[i], h_w[i], h_s[i], h_sw[i], q[i]);
        }
    }
    for row in [thickness_x, thickness_y, per_thickness, quarter_q] {
        periodic_row(row, 1);
    }
}
