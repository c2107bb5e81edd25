//! The nonlinear tendency row by row: the equations of [`super::kernel`] in one pass over memory, with the diagnostic
//! quantities of two or three rows in cache.

use super::kernel::{Constants, Diagnosed, mass_flux};
use super::{H, ShallowWater, U, V, VARIABLES, VectorInvariant};
use crate::grid::Boundary;
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

    /// Those around the row south of the one pushed last.
    #[inline(always)]
    pub fn around(&self) -> Around<'_, N> {
        Around {
            flux_x_s: &self.flux_x[0],
            flux_x: &self.flux_x[1],
            flux_y: &self.flux_y[0],
            flux_y_n: &self.flux_y[1],
            q: &self.q[0],
            q_n: &self.q[1],
            b_s: &self.bernoulli[0],
            b: &self.bernoulli[1],
        }
    }
}

/// The diagnostic rows around a row: U and B of the row and south of it, V and q of the row and north of it.
#[derive(Clone, Copy)]
pub(super) struct Around<'a, N = f64> {
    pub flux_x_s: &'a [N],
    pub flux_x: &'a [N],
    pub flux_y: &'a [N],
    pub flux_y_n: &'a [N],
    pub q: &'a [N],
    pub q_n: &'a [N],
    pub b_s: &'a [N],
    pub b: &'a [N],
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
    fn with_simd<S: Simd>(self, _simd: S) {
        match self.rows.lanes {
            // With a constant in the place of it the ends of a row are no loops.
            1 => self.run(1),
            lanes => self.run(lanes),
        }
    }
}

impl Push<'_, '_> {
    #[inline(always)]
    fn run(self, lanes: usize) {
        let Push { rows, row, south, north, tendency } = self;
        let ShallowWaterRows { model, diagnostics, .. } = rows;
        let constants = Constants::new(model);
        let coriolis = model.coriolis_per_s(row);
        let DiagnosticRows { flux_x, flux_y, q, bernoulli } = diagnostics;
        let (flux_x, flux_y, q, b) = (&mut flux_x[2], &mut flux_y[1], &mut q[1], &mut bernoulli[1]);
        diagnose(constants, coriolis, lanes, south, north, flux_x, flux_y, q, b);
        let nx = north.variable(H).len();
        let (k_h, winds) = tendency.split_at_mut(nx);
        let (k_u, k_v) = winds.split_at_mut(nx);
        let around = diagnostics.around();
        // One loop for each form.
        match model.form {
            VectorInvariant::PotentialEnstrophy => {
                tendencies(constants, VectorInvariant::PotentialEnstrophy, lanes, around, k_h, k_u, k_v);
            }
            VectorInvariant::Energy => tendencies(constants, VectorInvariant::Energy, lanes, around, k_h, k_u, k_v),
        }
        finish_winds(model, row as isize, [south.variable(U), south.variable(V)], [k_u, k_v]);
    }
}

/// U, V and q of the northern row, B of the southern, in one loop. (Rows to be written are arguments and not fields of a
/// struct: only of arguments the compiler knows that they do not overlap, else it compares them before every row.)
#[inline(always)]
fn diagnose(
    constants: Constants,
    coriolis: f64,
    lanes: usize,
    south: Row<'_>,
    north: Row<'_>,
    mass_flux_x: &mut [f64],
    mass_flux_y: &mut [f64],
    potential_vorticity: &mut [f64],
    bernoulli: &mut [f64],
) {
    let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
    // Where the last place begins, which is west of the first.
    let last = h.len() - lanes;
    for lane in 0..lanes {
        let west = last + lane;
        let first = constants.place(
            coriolis,
            [h[lane], h[west], h_s[lane], h_s[west]],
            [u[lane], u_s[lane], u_s[west]],
            [v[lane], v[west], v_s[west]],
        );
        mass_flux_x[lane] = first.mass_flux_x;
        mass_flux_y[lanes + lane] = first.mass_flux_y;
        potential_vorticity[lane] = first.potential_vorticity;
        bernoulli[lanes + west] = first.bernoulli;
    }
    let n = last;
    let (h, h_w, h_s, h_sw) = (&h[lanes..][..n], &h[..n], &h_s[lanes..][..n], &h_s[..n]);
    let (u, u_s, u_sw) = (&u[lanes..][..n], &u_s[lanes..][..n], &u_s[..n]);
    let (v, v_w, v_sw) = (&v[lanes..][..n], &v[..n], &v_s[..n]);
    {
        let (flux_x, flux_y) = (&mut mass_flux_x[lanes..][..n], &mut mass_flux_y[2 * lanes..][..n]);
        let (q, b) = (&mut potential_vorticity[lanes..][..n], &mut bernoulli[lanes..][..n]);
        for i in 0..n {
            let Diagnosed { mass_flux_x, mass_flux_y, potential_vorticity, bernoulli } = constants.place(
                coriolis,
                [h[i], h_w[i], h_s[i], h_sw[i]],
                [u[i], u_s[i], u_sw[i]],
                [v[i], v_w[i], v_sw[i]],
            );
            (flux_x[i], flux_y[i], q[i], b[i]) = (mass_flux_x, mass_flux_y, potential_vorticity, bernoulli);
        }
    }
    let end = last + lanes;
    mass_flux_x.copy_within(..lanes, end);
    mass_flux_y.copy_within(end..end + lanes, 0);
    potential_vorticity.copy_within(..lanes, end);
    bernoulli.copy_within(end..end + lanes, 0);
}

/// The tendencies of a row.
#[inline(always)]
fn tendencies(
    constants: Constants,
    form: VectorInvariant,
    lanes: usize,
    around: Around<'_>,
    out_h: &mut [f64],
    out_u: &mut [f64],
    out_v: &mut [f64],
) {
    let Around { flux_x_s, flux_x, flux_y, flux_y_n, q, q_n, b_s, b } = around;
    let n = out_h.len();
    let (u, u_e, u_s, u_se) = (&flux_x[..n], &flux_x[lanes..][..n], &flux_x_s[..n], &flux_x_s[lanes..][..n]);
    let (v, v_w, v_n, v_nw) = (&flux_y[lanes..][..n], &flux_y[..n], &flux_y_n[lanes..][..n], &flux_y_n[..n]);
    let (q, q_e, q_n) = (&q[..n], &q[lanes..][..n], &q_n[..n]);
    let (b, b_w, b_s) = (&b[lanes..][..n], &b[..n], &b_s[lanes..][..n]);
    let (out_u, out_v) = (&mut out_u[..n], &mut out_v[..n]);
    for i in 0..n {
        let q_v = form.q_v([q[i], q_n[i]], [v[i], v_w[i], v_n[i], v_nw[i]]);
        let q_u = form.q_u([q[i], q_e[i]], [u[i], u_e[i], u_s[i], u_se[i]]);
        out_h[i] = constants.minus_divergence([u[i], u_e[i]], [v[i], v_n[i]]);
        out_u[i] = constants.minus_gradient_x(b_w[i], b[i]) + q_v;
        out_v[i] = constants.minus_gradient_y(b_s[i], b[i]) - q_u;
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
