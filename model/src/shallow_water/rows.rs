//! The nonlinear tendency row by row: the equations of [`super::kernel`] in one pass over memory, with the diagnostic
//! quantities of two or three rows in cache.

use super::kernel::{Constants, mass_flux};
use super::{H, ShallowWater, U, V, VARIABLES, VectorInvariant};
use crate::grid::Boundary;
use crate::places::{Lines, Places, at_each_place, read};
use crate::scheme::rows::{Row, RowStream};
use crate::scheme::strips::periodic_row;
use crate::stored::Stored;
use pulp::{Simd, WithSimd};

/// Diagnostic rows of a sweep, or their increments: the last is that of the row pushed last, unless said otherwise.
///
/// Stencils reach east in U and q, whose rows have their first place again at the end, and west in V and B, whose rows
/// have their last place also at the beginning.
pub(super) struct DiagnosticRows<N = f64> {
    /// U of three rows.
    pub flux_x: [Vec<N>; 3],
    /// V of two rows.
    pub flux_y: [Vec<N>; 2],
    /// q of two rows.
    pub q: [Vec<N>; 2],
    /// B of the two rows before the last.
    pub bernoulli: [Vec<N>; 2],
}

impl<N: Stored> DiagnosticRows<N> {
    /// For rows of at most `nx` places of `lanes` values.
    pub fn new(nx: usize, lanes: usize) -> Self {
        let row = || vec![N::default(); (nx + 1) * lanes];
        Self { flux_x: [row(), row(), row()], flux_y: [row(), row()], q: [row(), row()], bernoulli: [row(), row()] }
    }

    /// Makes room for the next row.
    pub fn advance(&mut self) {
        self.flux_x.rotate_left(1);
        self.flux_y.swap(0, 1);
        self.q.swap(0, 1);
        self.bernoulli.swap(0, 1);
    }

    /// Those around the row south of the one pushed last, of `count` values, with `lanes` for each place.
    #[inline(always)]
    pub fn around(&self, lanes: usize, count: usize) -> Around<&[N]> {
        let [flux_x_s, flux_x, _] = &self.flux_x;
        let ([flux_y, flux_y_n], [q, q_n], [b_s, b]) = (&self.flux_y, &self.q, &self.bernoulli);
        Around {
            u: &flux_x[..count],
            u_e: &flux_x[lanes..][..count],
            u_s: &flux_x_s[..count],
            u_se: &flux_x_s[lanes..][..count],
            v: &flux_y[lanes..][..count],
            v_w: &flux_y[..count],
            v_n: &flux_y_n[lanes..][..count],
            v_nw: &flux_y_n[..count],
            q: &q[..count],
            q_e: &q[lanes..][..count],
            q_n: &q_n[..count],
            b: &b[lanes..][..count],
            b_w: &b[..count],
            b_s: &b_s[lanes..][..count],
        }
    }
}

/// Diagnostic quantities at the places of a row and around them, or those rows: U as u and V as v, q and B.
#[derive(Clone, Copy)]
pub(super) struct Around<T> {
    pub u: T,
    pub u_e: T,
    pub u_s: T,
    pub u_se: T,
    pub v: T,
    pub v_w: T,
    pub v_n: T,
    pub v_nw: T,
    pub q: T,
    pub q_e: T,
    pub q_n: T,
    pub b: T,
    pub b_w: T,
    pub b_s: T,
}

impl<N> Around<&[N]> {
    /// Those of some places.
    #[inline(always)]
    pub fn at<P: Places<N>>(&self, places: P, first: usize) -> Around<P::Number> {
        let read = |row| places.read(row, first);
        Around {
            u: read(self.u),
            u_e: read(self.u_e),
            u_s: read(self.u_s),
            u_se: read(self.u_se),
            v: read(self.v),
            v_w: read(self.v_w),
            v_n: read(self.v_n),
            v_nw: read(self.v_nw),
            q: read(self.q),
            q_e: read(self.q_e),
            q_n: read(self.q_n),
            b: read(self.b),
            b_w: read(self.b_w),
            b_s: read(self.b_s),
        }
    }
}

/// The tendency by rows of states that lie interleaved: a place has a value of each, and stencils reach from a value as many on as
/// there are states.
pub(super) struct ShallowWaterRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    lanes: usize,
    pub(super) diagnostics: DiagnosticRows,
}

impl<'a> ShallowWaterRows<'a> {
    /// For rows of at most `nx` places of `lanes` states.
    pub fn new(model: &'a ShallowWater, nx: usize, lanes: usize) -> Self {
        Self { model, arch: pulp::Arch::new(), lanes, diagnostics: DiagnosticRows::new(nx, lanes) }
    }
}

impl RowStream for ShallowWaterRows<'_> {
    fn begin(&mut self, _row: isize, first: Row<'_>) {
        let (h, u, flux) = (first.variable(H), first.variable(U), &mut self.diagnostics.flux_x[2]);
        let (n, lanes) = (h.len(), self.lanes);
        for i in 0..n {
            flux[i] = mass_flux([h[i], h[if i < lanes { n - lanes + i } else { i - lanes }]], u[i]);
        }
        flux.copy_within(..lanes, n);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        continue_evenly(x, ghost);
    }

    fn push(&mut self, row: usize, south: Row<'_>, north: Row<'_>, tendency: &mut [f64]) {
        self.diagnostics.advance();
        self.arch.dispatch(Push { rows: self, row, south, north, tendency });
    }
}

/// One row, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut ShallowWaterRows<'b>,
    row: usize,
    south: Row<'a>,
    north: Row<'a>,
    tendency: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.rows.lanes {
            // With a constant in the place of it the ends of a row are no loops.
            1 => self.run(simd, 1),
            lanes => self.run(simd, lanes),
        }
    }
}

impl Push<'_, '_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S, lanes: usize) {
        let Push { rows, row, south, north, tendency } = self;
        let ShallowWaterRows { model, diagnostics, .. } = rows;
        let constants = Constants::new(model);
        diagnose(simd, constants, model.coriolis_per_s(row), lanes, [south, north], diagnostics);
        let count = north.variable(H).len();
        let (out_h, winds) = tendency.split_at_mut(count);
        let (out_u, out_v) = winds.split_at_mut(count);
        let around = diagnostics.around(lanes, count);
        let mut lines = Tendencies { constants, form: model.form, around, out: [out_h, &mut *out_u, &mut *out_v] };
        // One loop for each form.
        match model.form {
            VectorInvariant::PotentialEnstrophy => {
                lines.form = VectorInvariant::PotentialEnstrophy;
                at_each_place(simd, count, lines);
            }
            VectorInvariant::Energy => {
                lines.form = VectorInvariant::Energy;
                at_each_place(simd, count, lines);
            }
        }
        finish_winds(model, row as isize, [south.variable(U), south.variable(V)], [out_u, out_v]);
    }
}

/// U, V and q of the northern row, B of the southern.
#[inline(always)]
fn diagnose<S: Simd>(
    simd: S,
    constants: Constants,
    coriolis: f64,
    lanes: usize,
    [south, north]: [Row<'_>; 2],
    diagnostics: &mut DiagnosticRows,
) {
    let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
    let DiagnosticRows { flux_x: [.., flux_x], flux_y: [_, flux_y], q: [_, q], bernoulli: [_, b] } = diagnostics;
    // Where the last place begins, which is west of the first.
    let last = h.len() - lanes;
    for (own, west, count) in [(0, last, lanes), (lanes, 0, last)] {
        let lines = Diagnose {
            constants,
            coriolis,
            h: [&h[own..][..count], &h[west..][..count], &h_s[own..][..count], &h_s[west..][..count]],
            u: [&u[own..][..count], &u_s[own..][..count], &u_s[west..][..count]],
            v: [&v[own..][..count], &v[west..][..count], &v_s[west..][..count]],
            flux_x: &mut flux_x[own..][..count],
            flux_y: &mut flux_y[lanes + own..][..count],
            q: &mut q[own..][..count],
            b: &mut b[lanes + west..][..count],
        };
        at_each_place(simd, count, lines);
    }
    let end = last + lanes;
    flux_x.copy_within(..lanes, end);
    flux_y.copy_within(end..end + lanes, 0);
    q.copy_within(..lanes, end);
    b.copy_within(end..end + lanes, 0);
}

/// Rows of what [`Constants::place`] takes and gives.
struct Diagnose<'a> {
    constants: Constants,
    coriolis: f64,
    h: [&'a [f64]; 4],
    u: [&'a [f64]; 3],
    v: [&'a [f64]; 3],
    flux_x: &'a mut [f64],
    flux_y: &'a mut [f64],
    q: &'a mut [f64],
    b: &'a mut [f64],
}

impl Lines<f64> for Diagnose<'_> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let (h, u, v) = (read(places, first, &self.h), read(places, first, &self.u), read(places, first, &self.v));
        let diagnosed = self.constants.at(places).place(places.all(self.coriolis), h, u, v);
        places.write(self.flux_x, first, diagnosed.mass_flux_x);
        places.write(self.flux_y, first, diagnosed.mass_flux_y);
        places.write(self.q, first, diagnosed.potential_vorticity);
        places.write(self.b, first, diagnosed.bernoulli);
    }
}

/// The tendencies of a row.
struct Tendencies<'a> {
    constants: Constants,
    form: VectorInvariant,
    around: Around<&'a [f64]>,
    out: [&'a mut [f64]; VARIABLES],
}

impl Lines<f64> for Tendencies<'_> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let (constants, form) = (self.constants.at(places), self.form);
        let Around { u, u_e, u_s, u_se, v, v_w, v_n, v_nw, q, q_e, q_n, b, b_w, b_s } = self.around.at(places, first);
        let of_u = constants.minus_gradient_x(b_w, b) + form.q_v([q, q_n], [v, v_w, v_n, v_nw]);
        let of_v = constants.minus_gradient_y(b_s, b) - form.q_u([q, q_e], [u, u_e, u_s, u_se]);
        let [out_h, out_u, out_v] = &mut self.out;
        places.write(out_h, first, constants.minus_divergence([u, u_e], [v, v_n]));
        places.write(out_u, first, of_u);
        places.write(out_v, first, of_v);
    }
}

/// What is the same for f, its derivative and its transpose once a row was pushed: drag on the winds of the row south of it,
/// `south`, and no change of the flow through a wall.
#[inline(always)]
pub(super) fn finish_winds<N: Stored>(model: &ShallowWater, row: isize, south: [&[N]; 2], out: [&mut [N]; 2]) {
    let ([u, v], [out_u, out_v], drag) = (south, out, model.parameters.drag_per_s);
    if drag != 0.0 {
        add_drag(N::narrow(drag), u, out_u);
        add_drag(N::narrow(drag), v, out_v);
    }
    if model.layout.grid.boundary == Boundary::Channel && row == 1 {
        out_v.fill(N::default());
    }
}

/// −r u.
#[inline(always)]
fn add_drag<N: Stored>(drag: N, wind: &[N], out: &mut [N]) {
    for (out, &wind) in out.iter_mut().zip(wind) {
        *out -= drag * wind;
    }
}

/// h and u continued evenly beyond a wall, v = 0, of the state or of columns.
pub(super) fn continue_evenly<N: Stored>(row: Row<'_, N>, ghost: &mut [N]) {
    let [h, u, _] = row.variables::<VARIABLES>();
    let (ghost_h, winds) = ghost.split_at_mut(h.len());
    let (ghost_u, ghost_v) = winds.split_at_mut(u.len());
    ghost_h.copy_from_slice(h);
    ghost_u.copy_from_slice(u);
    ghost_v.fill(N::default());
}

/// [`finish_winds`] of a row of columns, `[variable, x, lane]`, and the places at its ends.
#[inline(always)]
pub(super) fn finish_columns<N: Stored>(
    model: &ShallowWater,
    row: isize,
    south: Row<'_, N>,
    out: &mut [N],
    lanes: usize,
) {
    let stride = out.len() / VARIABLES;
    let (out_u, out_v) = out[U * stride..].split_at_mut(stride);
    finish_winds(model, row, [south.variable(U), south.variable(V)], [out_u, out_v]);
    out.chunks_exact_mut(stride).for_each(|row| periodic_row(row, lanes));
}
