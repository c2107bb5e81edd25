//! The tendency N'(x̄)(x − x̄) row by row, of one state or of several that lie interleaved: the rows of [`super::tangent_rows`]
//! with coefficients that stay as they are.

use super::hyperdiffusion::{Arrangement, Damping};
use super::kernel::Constants;
use super::row_coefficients::{PlaceCoefficients, QUANTITIES, VorticityCoefficients};
use super::rows::{continue_evenly, finish_winds};
use super::tangent_linear::{Coefficients, load_all};
use super::tangent_rows::IncrementRows;
use super::{ShallowWater, U, V, VARIABLES};
use crate::grid::Boundary;
use crate::places::{Coefficient, Lines, One, Places, at_each_place};
use crate::scheme::rows::{Row, RowStream};
use crate::scheme::strips::periodic_row;

use pulp::{Simd, WithSimd};
use std::borrow::Cow;

/// Quantities of a row of a steady state: its coefficients, h, u and v.
const ROW_QUANTITIES: usize = QUANTITIES + VARIABLES;

/// The coefficients of N' at a state that stays as it is, and that state, row by row from the one beyond the southern edge to
/// that beyond the northern.
#[derive(Clone, Debug)]
pub(super) struct SteadyRows {
    /// `[row, quantity]` of a flow that is the same all along each row, else `[row, quantity, x, lane]`, with the place before the
    /// first and that after the last, and the same value in all lanes.
    values: Vec<f64>,
    is_zonal: bool,
    /// Values of a quantity in a row.
    stride: usize,
}

impl SteadyRows {
    /// Of a state and the coefficients there.
    pub fn new(model: &ShallowWater, basic_state: &[f64], coefficients: &Coefficients) -> Self {
        let (halo, stride) = (&model.halo, model.halo.stride());
        let mut state = [halo.zeros(), halo.zeros(), halo.zeros()];
        load_all(model, basic_state, state.each_mut().map(|field| &mut field[..]));
        let quantities = coefficients.quantities().into_iter().chain(state.iter().map(|field| &field[..]));
        let fields: Vec<&[f64]> = quantities.map(|field| halo.core(field)).collect();
        let is_uniform = |row: &[f64]| row[1..=halo.columns()].iter().all(|&value| value == row[1]);
        let of_domain = stride..stride * (model.layout.grid.ny + 1);
        let is_zonal = fields.iter().all(|field| field[of_domain.clone()].chunks_exact(stride).all(is_uniform));
        let part = if is_zonal { 1..2 } else { 0..stride };
        let mut values = Vec::new();
        for row in 0..halo.core_len() / stride {
            fields.iter().for_each(|field| values.extend_from_slice(&field[row * stride..][part.clone()]));
        }
        Self { values, is_zonal, stride: part.len() }
    }

    /// The same for states that lie interleaved.
    fn interleaved(&self, lanes: usize) -> Cow<'_, Self> {
        if self.is_zonal || lanes == 1 {
            return Cow::Borrowed(self);
        }
        let values = self.values.iter().flat_map(|&value| std::iter::repeat_n(value, lanes)).collect();
        Cow::Owned(Self { values, is_zonal: false, stride: self.stride * lanes })
    }

    /// Which of the rows is the one that has this number in a sweep.
    #[inline(always)]
    fn number(model: &ShallowWater, row: isize) -> usize {
        match model.layout.grid.boundary {
            Boundary::Periodic => model.grid_row(row) + 1,
            Boundary::Channel => (row + 1) as usize,
        }
    }

    /// A quantity of a row.
    #[inline(always)]
    fn quantity(&self, row: usize, quantity: usize) -> &[f64] {
        &self.values[(row * ROW_QUANTITIES + quantity) * self.stride..][..self.stride]
    }
}

/// The tendency by rows of states that lie interleaved.
pub(super) struct LinearRows<'a> {
    model: &'a ShallowWater,
    arch: pulp::Arch,
    lanes: usize,
    steady: Cow<'a, SteadyRows>,
    derivative: Derivative,
    hyperdiffusion: Option<Damping<'a>>,
}

impl<'a> LinearRows<'a> {
    /// For rows of `nx` places of `lanes` states.
    pub fn new(model: &'a ShallowWater, steady: &'a SteadyRows, nx: usize, lanes: usize) -> Self {
        let hyperdiffused = model.parameters.hyperdiffusion_m4_per_s != 0.0;
        Self {
            model,
            arch: pulp::Arch::new(),
            lanes,
            steady: steady.interleaved(lanes),
            derivative: Derivative::new(nx, lanes),
            hyperdiffusion: hyperdiffused.then(|| Damping::new(model, Arrangement::Fields(lanes), nx)),
        }
    }
}

impl RowStream for LinearRows<'_> {
    fn reach(&self) -> usize {
        if self.hyperdiffusion.is_some() { 2 } else { 1 }
    }

    fn begin(&mut self, row: isize, first: Row<'_>) {
        let Self { model, lanes, steady, derivative, .. } = self;
        let row = SteadyRows::number(model, row);
        if steady.is_zonal {
            derivative.begin(*lanes, first, |quantity| steady.quantity(row, quantity)[0]);
        } else {
            derivative.begin(*lanes, first, |quantity| steady.quantity(row, quantity));
        }
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        continue_evenly(x, ghost);
    }

    fn push(&mut self, row: usize, _south: Row<'_>, north: Row<'_>, tendency: &mut [f64]) {
        self.arch.dispatch(Push { rows: self, row: row as isize, north, tendency });
    }

    fn finish(&mut self, tendency: &mut [f64]) {
        if let Some(hyperdiffusion) = &mut self.hyperdiffusion {
            hyperdiffusion.finish(tendency);
        }
    }
}

/// One row, for [`pulp::Arch::dispatch`].
struct Push<'a, 'b> {
    rows: &'a mut LinearRows<'b>,
    row: isize,
    north: Row<'a>,
    tendency: &'a mut [f64],
}

impl WithSimd for Push<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Push { rows, row, north, tendency } = self;
        let LinearRows { model, lanes, steady, derivative, hyperdiffusion, .. } = rows;
        let steady: &SteadyRows = steady;
        let out = match hyperdiffusion {
            None => &mut *tendency,
            Some(hyperdiffusion) => {
                hyperdiffusion.release(tendency);
                &mut hyperdiffusion.pending
            }
        };
        let (of_south, of_north) = (SteadyRows::number(model, row - 1), SteadyRows::number(model, row));
        if steady.is_zonal {
            let at = |row| move |quantity| steady.quantity(row, quantity)[0];
            derivative.push(simd, model, *lanes, north, [at(of_south), at(of_north)], out);
        } else {
            let at = |row| move |quantity| steady.quantity(row, quantity);
            derivative.push(simd, model, *lanes, north, [at(of_south), at(of_north)], out);
        }
        let n = out.len() / VARIABLES;
        let [south, north] = derivative.own_places(*lanes, n);
        let (out_u, out_v) = out[U * n..].split_at_mut(n);
        finish_winds(model, row, [south.variable(U), south.variable(V)], [out_u, out_v]);
        if let Some(hyperdiffusion) = hyperdiffusion {
            hyperdiffusion.push(row, south, north, tendency);
        }
    }
}

/// N'(x̄)(x − x̄) by rows but for damping and walls.
struct Derivative {
    /// x − x̄ of the last two rows pushed, `[variable, x, lane]`, each variable with the place before its first and the place after
    /// its last.
    increments: [Vec<f64>; 2],
    rows: IncrementRows,
}

impl Derivative {
    fn new(nx: usize, lanes: usize) -> Self {
        let increments = || vec![0.0; VARIABLES * (nx + 2) * lanes];
        Self { increments: [increments(), increments()], rows: IncrementRows::new(nx, lanes) }
    }

    /// Begins a sweep with a row, given the quantities of the steady state there.
    fn begin<C: Coefficient<f64>>(&mut self, lanes: usize, first: Row<'_>, at: impl Fn(usize) -> C) {
        self.subtract(pulp::Scalar::new(), lanes, first, &at);
        let PlaceCoefficients { thickness_x, half_u, .. } = PlaceCoefficients::of(at);
        let stride = self.increments[1].len() / VARIABLES;
        let at = |i| [thickness_x.at(One, lanes + i), half_u.at(One, lanes + i)];
        self.rows.begin(Row::of(&self.increments[1], stride), at);
    }

    /// Takes a row, given the quantities of the steady state in the row south of it and there.
    #[inline(always)]
    fn push<S: Simd, C: Coefficient<f64>>(
        &mut self,
        simd: S,
        model: &ShallowWater,
        lanes: usize,
        north: Row<'_>,
        [at_s, at]: [impl Fn(usize) -> C + Copy; 2],
        out: &mut [f64],
    ) {
        self.subtract(simd, lanes, north, at);
        let stride = self.increments[1].len() / VARIABLES;
        let [south, north] = &self.increments;
        let (south, north) = (Row::of(south, stride), Row::of(north, stride));
        let places = [PlaceCoefficients::of(at_s), PlaceCoefficients::of(at)];
        let term = VorticityCoefficients::of(model.form, lanes, at_s, at);
        let (out_h, winds) = out.split_at_mut(out.len() / VARIABLES);
        let (out_u, out_v) = winds.split_at_mut(out_h.len());
        self.rows.push(simd, Constants::new(model), places, term, [south, north], [out_h, out_u, out_v]);
    }

    /// Keeps x − x̄ of a row.
    #[inline(always)]
    fn subtract<S: Simd, C: Coefficient<f64>>(&mut self, simd: S, lanes: usize, x: Row<'_>, at: impl Fn(usize) -> C) {
        self.increments.swap(0, 1);
        let stride = self.increments[1].len() / VARIABLES;
        for (variable, out) in self.increments[1].chunks_exact_mut(stride).enumerate() {
            let x = x.variable(variable);
            let steady = at(QUANTITIES + variable).from(lanes).take(x.len());
            at_each_place(simd, x.len(), Subtract { x, steady, out: &mut out[lanes..][..x.len()] });
            periodic_row(out, lanes);
        }
    }

    /// x − x̄ of the `n` values of the southern row and of the one pushed last.
    #[inline(always)]
    fn own_places(&self, lanes: usize, n: usize) -> [Row<'_>; 2] {
        let own = |row| {
            let [h, u, v] = Row::of(row, n + 2 * lanes).variables();
            Row::each([&h[lanes..][..n], &u[lanes..][..n], &v[lanes..][..n]])
        };
        let [south, north] = &self.increments;
        [own(south), own(north)]
    }
}

/// x − x̄.
struct Subtract<'a, C> {
    x: &'a [f64],
    steady: C,
    out: &'a mut [f64],
}

impl<C: Coefficient<f64>> Lines<f64> for Subtract<'_, C> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let difference = places.read(self.x, first) - self.steady.at(places, first);
        places.write(self.out, first, difference);
    }
}
