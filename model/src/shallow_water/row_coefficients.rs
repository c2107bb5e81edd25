//! The coefficients of f' in the rows of a sweep, computed once for all columns, in double precision, and kept in that of the
//! columns.

use super::rows::{Around, DiagnosticRows};
use super::{H, ShallowWater, U, V, VectorInvariant};
use crate::arithmetic::Number;
use crate::places::{Coefficient, Lines, Places, at_each_place, read};
use crate::scheme::rows::{Ring, Row};
use crate::scheme::strips::periodic_row;
use crate::stored::Stored;
use pulp::Simd;

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
    /// What changes of each.
    #[inline(always)]
    pub fn each(self, change: impl Fn(C) -> C) -> Self {
        let Self { x, y } = self;
        let each = |it: [C; 4]| [change(it[0]), change(it[1]), change(it[2]), change(it[3])];
        Self { x: each(x), y: each(y) }
    }

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
        let (a, b, c) = (quantity(OF_Q_AT_X_FACES), quantity(OF_FLUX_AT_X_FACES), quantity(OF_Q_AT_Y_FACES));
        match form {
            VectorInvariant::PotentialEnstrophy => {
                let d = quantity(OF_FLUX_AT_Y_FACES);
                Self { x: [a, a, b, b], y: [c, c, d, d] }
            }
            VectorInvariant::Energy => {
                let (a_n, b_n) = (of_north(OF_Q_AT_X_FACES), of_north(OF_FLUX_AT_X_FACES));
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
        halve(pulp::Scalar::new(), x.variable(U), half_u);
        halve(pulp::Scalar::new(), x.variable(V), half_v);
    }

    /// Takes row `row` of the state, `north`, the row south of it, and the diagnostic rows once it was pushed. The places of
    /// that row are known from now on, and the vorticity term south of it.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, simd: S, row: isize, rows: &DiagnosticRows, south: Row<'_>, north: Row<'_>) {
        let (h, h_s, form) = (north.variable(H), south.variable(H), self.form);
        let n = h.len();
        let [thickness_x, thickness_y, per_thickness, quarter_q, half_u, half_v, a, b, c, _] = self.quantities_mut(row);
        halve(simd, north.variable(U), half_u);
        halve(simd, north.variable(V), half_v);
        thickness_of(simd, h, h_s, &rows.q[1], [thickness_x, thickness_y, per_thickness, quarter_q]);
        if form == VectorInvariant::Energy {
            let (flux_x_s, flux_x, flux_y) = (&rows.flux_x[1], &rows.flux_x[2], &rows.flux_y[1]);
            means(simd, 0.25, [&flux_y[1..], flux_y], a, n);
            means(simd, 0.25, [&rows.q[1]], b, n);
            means(simd, 0.25, [flux_x, flux_x_s], c, n);
            return;
        }
        let [.., a, b, c, d] = self.quantities_mut(row - 1);
        let Around { u, u_e, u_s, u_se, v, v_w, v_n, v_nw, q, q_e, q_n, .. } = rows.around(1, n);
        means(simd, 0.125, [v_w, v, v_nw, v_n], a, n);
        means(simd, 0.125, [q, q_n], b, n);
        means(simd, 0.125, [u, u_e, u_s, u_se], c, n);
        means(simd, 0.125, [q, q_e], d, n);
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
fn halve<S: Simd, N: Stored>(simd: S, of: &[f64], out: &mut [N]) {
    means(simd, 0.5, [of], out, of.len());
}

/// The sum of `n` places of some rows, in their order, times a factor, periodic.
#[inline(always)]
fn means<S: Simd, N: Stored, const ROWS: usize>(simd: S, factor: f64, rows: [&[f64]; ROWS], out: &mut [N], n: usize) {
    let mut rows = rows;
    for row in &mut rows {
        *row = &row[..n];
    }
    at_each_place(simd, n, Mean { factor, rows, out: &mut out[1..][..n] });
    periodic_row(out, 1);
}

struct Mean<'a, N, const ROWS: usize> {
    factor: f64,
    rows: [&'a [f64]; ROWS],
    out: &'a mut [N],
}

impl<N: Stored, const ROWS: usize> Lines<f64> for Mean<'_, N, ROWS> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let mut sum = places.read(self.rows[0], first);
        for row in 1..ROWS {
            sum = sum + places.read(self.rows[row], first);
        }
        places.store(self.out, first, sum.times(self.factor));
    }
}

/// h̄ˣ, h̄ʸ, 1/h̄ˣʸ and q/(4 h̄ˣʸ).
#[inline(always)]
fn thickness_of<S: Simd, N: Stored>(simd: S, h: &[f64], h_s: &[f64], q: &[f64], out: [&mut [N]; 4]) {
    let last = h.len() - 1;
    let [thickness_x, thickness_y, per_thickness, quarter_q] = out;
    // The first place, west of which the last is, and the others.
    for (own, west, count) in [(0, last, 1), (1, 0, last)] {
        let lines = Thickness {
            h: [&h[own..][..count], &h[west..][..count], &h_s[own..][..count], &h_s[west..][..count]],
            q: &q[own..][..count],
            thickness_x: &mut thickness_x[1 + own..][..count],
            thickness_y: &mut thickness_y[1 + own..][..count],
            per_thickness: &mut per_thickness[1 + own..][..count],
            quarter_q: &mut quarter_q[1 + own..][..count],
        };
        at_each_place(simd, count, lines);
    }
    for row in [thickness_x, thickness_y, per_thickness, quarter_q] {
        periodic_row(row, 1);
    }
}

/// Rows of what [`thickness_of`] takes and gives.
struct Thickness<'a, N> {
    /// Of the place, west, south and south-west of it.
    h: [&'a [f64]; 4],
    q: &'a [f64],
    thickness_x: &'a mut [N],
    thickness_y: &'a mut [N],
    per_thickness: &'a mut [N],
    quarter_q: &'a mut [N],
}

impl<N: Stored> Lines<f64> for Thickness<'_, N> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let [h, h_w, h_s, h_sw] = read(places, first, &self.h);
        let per_sum = places.all(1.0) / (h + h_w + h_s + h_sw);
        places.store(self.thickness_x, first, (h + h_w).times(0.5));
        places.store(self.thickness_y, first, (h + h_s).times(0.5));
        places.store(self.per_thickness, first, per_sum.times(4.0));
        places.store(self.quarter_q, first, places.read(self.q, first) * per_sum);
    }
}
