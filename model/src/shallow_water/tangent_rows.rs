//! The tangent-linear tendency row by row for a column alone: the derivatives in [`super::kernel`].

use super::kernel::{Constants, VorticityWeights, mass_flux_tl, potential_vorticity_tl};
use super::row_coefficients::{PlaceCoefficients, RowCoefficients, VorticityCoefficients};
use super::rows::{Around, DiagnosticRows, ShallowWaterRows, continue_evenly, finish_columns};
use super::{ShallowWater, VARIABLES};
use crate::places::{Coefficient, Lines, Places, at_each_place, read};
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
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, row, x: [x_south, x_north], dx: Pushed { south, north, tendency } } = self;
        let TangentRows { model, state, coefficients, increments, .. } = rows;
        coefficients.push(simd, row, &state.diagnostics, x_south, x_north);
        let coefficients = &*coefficients;
        let stride = tendency.len() / VARIABLES;
        let n = stride - 2;
        let places = [coefficients.places(row - 1, n), coefficients.places(row, n)];
        let (out_h, winds) = tendency.split_at_mut(stride);
        let (out_u, out_v) = winds.split_at_mut(stride);
        let out = [&mut out_h[1..][..n], &mut out_u[1..][..n], &mut out_v[1..][..n]];
        let term = coefficients.vorticity_term(row - 1, n);
        increments.push(simd, Constants::new(model), places, term, [south, north], out);
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
    pub fn push<S: Simd, C: Coefficient<N>>(
        &mut self,
        simd: S,
        constants: Constants<N>,
        places: [PlaceCoefficients<C>; 2],
        term: VorticityCoefficients<C>,
        rows: [Row<'_, N>; 2],
        out: [&mut [N]; VARIABLES],
    ) {
        match self.lanes {
            // With a constant in the place of it the ends of a row are no loops.
            1 => self.push_lanes(simd, 1, constants, places, term, rows, out),
            lanes => self.push_lanes(simd, lanes, constants, places, term, rows, out),
        }
    }

    #[inline(always)]
    fn push_lanes<'a, S: Simd, C: Coefficient<N>>(
        &mut self,
        simd: S,
        lanes: usize,
        constants: Constants<N>,
        [at_s, at]: [PlaceCoefficients<C>; 2],
        term: VorticityCoefficients<C>,
        [south, north]: [Row<'a, N>; 2],
        out: [&mut [N]; VARIABLES],
    ) {
        self.diagnostics.advance();
        let DiagnosticRows { flux_x: [.., flux_x], flux_y: [_, flux_y], q: [_, q], bernoulli: [_, b] } =
            &mut self.diagnostics;
        let count = out[0].len();
        let own = |coefficient: C| coefficient.from(lanes).take(count);
        let part = |row: &'a [N], first: usize| &row[first..][..count];
        let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
        let lines = Diagnose {
            constants,
            thickness_x: own(at.thickness_x),
            thickness_y: own(at.thickness_y),
            per_thickness: own(at.per_thickness),
            quarter_q: own(at.quarter_q_per_thickness),
            half_u: own(at.half_u),
            half_u_s: own(at_s.half_u),
            half_u_se: own(at_s.half_u.from(lanes)),
            half_v: own(at.half_v),
            half_v_s: own(at_s.half_v),
            h: [part(h, lanes), part(h, 0), part(h_s, lanes), part(h_s, 0)],
            u: [part(u, lanes), part(u_s, lanes), part(u_s, 2 * lanes)],
            v: [part(v, lanes), part(v, 0), part(v_s, lanes)],
            flux_x: &mut flux_x[..count],
            flux_y: &mut flux_y[lanes..][..count],
            q: &mut q[..count],
            b: &mut b[lanes..][..count],
        };
        at_each_place(simd, count, lines);
        flux_x.copy_within(..lanes, count);
        flux_y.copy_within(count..count + lanes, 0);
        q.copy_within(..lanes, count);
        b.copy_within(count..count + lanes, 0);
        let around = self.diagnostics.around(lanes, count);
        at_each_place(simd, count, Tendencies { constants, at: term.each(own), around, out });
    }
}

/// δU, δV and δq of the northern row, δB of the southern.
struct Diagnose<'a, N, C> {
    constants: Constants<N>,
    thickness_x: C,
    thickness_y: C,
    per_thickness: C,
    quarter_q: C,
    half_u: C,
    half_u_s: C,
    half_u_se: C,
    half_v: C,
    half_v_s: C,
    /// Of the place, west, south and south-west of it.
    h: [&'a [N]; 4],
    /// Of the place, south and south-east of it.
    u: [&'a [N]; 3],
    /// Of the place, west and south of it.
    v: [&'a [N]; 3],
    flux_x: &'a mut [N],
    flux_y: &'a mut [N],
    q: &'a mut [N],
    b: &'a mut [N],
}

impl<N: Stored, C: Coefficient<N>> Lines<N> for Diagnose<'_, N, C> {
    #[inline(always)]
    fn at<P: Places<N>>(&mut self, places: P, first: usize) {
        let Self { constants, h, u, v, .. } = self;
        let constants = constants.at(places);
        let [h, h_w, h_s, h_sw] = read(places, first, h);
        let [u, u_s, u_se] = read(places, first, u);
        let [v, v_w, v_s] = read(places, first, v);
        let at = |coefficient: C| coefficient.at(places, first);
        let (sum, half_v) = (h + h_w, at(self.half_v));
        let flux_x = mass_flux_tl(at(self.thickness_x), at(self.half_u), sum, u);
        let flux_y = mass_flux_tl(at(self.thickness_y), half_v, h + h_s, v);
        let vorticity = constants.vorticity([u, u_s], [v, v_w]);
        let q = potential_vorticity_tl(at(self.per_thickness), at(self.quarter_q), vorticity, sum + (h_s + h_sw));
        let (half_u, half_v) = ([at(self.half_u_s), at(self.half_u_se)], [at(self.half_v_s), half_v]);
        let b = constants.bernoulli_tl(half_u, half_v, h_s, [u_s, u_se], [v_s, v]);
        places.write(self.flux_x, first, flux_x);
        places.write(self.flux_y, first, flux_y);
        places.write(self.q, first, q);
        places.write(self.b, first, b);
    }
}

/// The tendencies of a row.
struct Tendencies<'a, N, C> {
    constants: Constants<N>,
    at: VorticityCoefficients<C>,
    around: Around<&'a [N]>,
    out: [&'a mut [N]; VARIABLES],
}

impl<N: Stored, C: Coefficient<N>> Lines<N> for Tendencies<'_, N, C> {
    #[inline(always)]
    fn at<P: Places<N>>(&mut self, places: P, first: usize) {
        let constants = self.constants.at(places);
        let at = |pair: &[C]| [pair[0].at(places, first), pair[1].at(places, first)];
        let VorticityCoefficients { x, y } = &self.at;
        let x = VorticityWeights { of_q: at(&x[..2]), of_flux: at(&x[2..]) };
        let y = VorticityWeights { of_q: at(&y[..2]), of_flux: at(&y[2..]) };
        let Around { u, u_e, u_s, u_se, v, v_w, v_n, v_nw, q, q_e, q_n, b, b_w, b_s } = self.around.at(places, first);
        let of_u = constants.minus_gradient_x(b_w, b) + x.apply([q, q_n], [v + v_w, v_n + v_nw]);
        let of_v = constants.minus_gradient_y(b_s, b) - y.apply([q, q_e], [u + u_s, u_e + u_se]);
        let [out_h, out_u, out_v] = &mut self.out;
        places.write(out_h, first, constants.minus_divergence([u, u_e], [v, v_n]));
        places.write(out_u, first, of_u);
        places.write(out_v, first, of_v);
    }
}
