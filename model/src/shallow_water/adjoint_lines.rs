//! The lines of [`super::adjoint`] at the places of a row, for [`super::adjoint_rows`].

use super::adjoint_rows::Gradients;
use super::kernel::Constants;
use super::row_coefficients::RowCoefficients;
use crate::places::{Lines, Places, coefficients, read};
use crate::scheme::rows::Row;

/// Rows with `lanes` values for each place, `count` places of which are wanted. In rows place i is at i + 1.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub count: usize,
    pub lanes: usize,
}

impl Shape {
    /// The values of a row at the places, or at those west (0) or east (2) of them.
    #[inline(always)]
    fn part<N>(self, row: &[N], first: usize) -> &[N] {
        &row[first * self.lanes..][..self.count * self.lanes]
    }

    /// As [`Shape::part`].
    #[inline(always)]
    fn part_mut<N>(self, row: &mut [N], first: usize) -> &mut [N] {
        &mut row[first * self.lanes..][..self.count * self.lanes]
    }

    /// As [`Shape::part`], of coefficients, which are the same in all lanes.
    #[inline(always)]
    fn of_place<N>(self, row: &[N], first: usize) -> &[N] {
        &row[first..][..self.count]
    }
}

/// V*, q*/h̄ˣʸ and q q*/(4 h̄ˣʸ) of the northern row, U* and B* of the southern.
pub(super) struct Diagnostics<'a> {
    constants: Constants,
    /// In the northern row, south of it and south-west of it.
    h: [&'a [f64]; 3],
    /// In the northern row, east of it, south and south-east.
    u: [&'a [f64]; 4],
    /// In the northern row, west of it, south and south-west.
    v: [&'a [f64]; 4],
    per_thickness: [&'a [f64]; 2],
    /// Of u, u\[S\], v and v\[W\] in q*.
    of_q: [&'a [f64]; 4],
    /// Of u, u\[E\], u\[S\] and u\[SE\] in V*.
    of_v: [&'a [f64]; 4],
    /// Of v\[S\], v\[SW\], v and v\[W\] in U*.
    of_u: [&'a [f64]; 4],
    flux_x: &'a mut [f64],
    flux_y: &'a mut [f64],
    vorticity: &'a mut [f64],
    thickness: &'a mut [f64],
    bernoulli: &'a mut [f64],
}

impl<'a> Diagnostics<'a> {
    /// When row `row`, `north`, is pushed.
    #[inline(always)]
    pub fn new(
        shape: Shape,
        constants: Constants,
        at: &'a RowCoefficients,
        row: isize,
        [south, north]: [Row<'a>; 2],
        gradients: &'a mut Gradients,
    ) -> Self {
        let n = shape.count;
        let (places, x, y) = (at.places(row, n), at.vorticity_term(row, n).x, at.vorticity_term(row, n).y);
        let (x_s, y_s) = (at.vorticity_term(row - 1, n).x, at.vorticity_term(row - 1, n).y);
        let ([h_s, u_s, v_s], [h, u, v]) = (south.variables(), north.variables());
        let part = |row, first| shape.part(row, first);
        let of = |row, first| shape.of_place(row, first);
        let Gradients { flux_x, flux_y: [_, flux_y], vorticity: [_, vorticity], thickness, bernoulli } = gradients;
        let ([_, thickness], [_, bernoulli]) = (thickness, bernoulli);
        Self {
            constants,
            h: [part(h, 1), part(h_s, 1), part(h_s, 0)],
            u: [part(u, 1), part(u, 2), part(u_s, 1), part(u_s, 2)],
            v: [part(v, 1), part(v, 0), part(v_s, 1), part(v_s, 0)],
            per_thickness: [of(places.per_thickness, 1), of(places.quarter_q_per_thickness, 1)],
            of_q: [of(x[0], 1), of(x_s[1], 1), of(y[0], 1), of(y[1], 0)],
            of_v: [of(x[2], 1), of(x[2], 2), of(x_s[3], 1), of(x_s[3], 2)],
            of_u: [of(y_s[2], 1), of(y_s[3], 0), of(y[2], 1), of(y[3], 0)],
            flux_x: shape.part_mut(flux_x, 1),
            flux_y: shape.part_mut(flux_y, 1),
            vorticity: shape.part_mut(vorticity, 1),
            thickness: shape.part_mut(thickness, 1),
            bernoulli: shape.part_mut(bernoulli, 1),
        }
    }
}

impl Lines<f64> for Diagnostics<'_> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let constants = self.constants.at(places);
        let [h, h_s, h_sw] = read(places, first, &self.h);
        let [u, u_e, u_s, u_se] = read(places, first, &self.u);
        let [v, v_w, v_s, v_sw] = read(places, first, &self.v);
        let [per_thickness, quarter_q] = coefficients(places, first, &self.per_thickness);
        let [a, b, c, d] = coefficients(places, first, &self.of_q);
        let q = (a * u + b * u_s) - (c * v + d * v_w);
        let [a, b, c, d] = coefficients(places, first, &self.of_v);
        let flux_y = constants.minus_gradient_y(h, h_s) + ((a * u + b * u_e) + (c * u_s + d * u_se));
        let [a, b, c, d] = coefficients(places, first, &self.of_u);
        let flux_x = constants.minus_gradient_x(h_s, h_sw) - ((a * v_s + b * v_sw) + (c * v + d * v_w));
        let bernoulli = constants.minus_divergence([u_se, u_s], [v, v_s]);
        places.write(self.vorticity, first, per_thickness * q);
        places.write(self.thickness, first, quarter_q * q);
        places.write(self.flux_y, first, flux_y);
        places.write(self.flux_x, first, flux_x);
        places.write(self.bernoulli, first, bernoulli);
    }
}

/// h*, u* and v* of a row.
pub(super) struct Prognostics<'a> {
    constants: Constants,
    thickness: [&'a [f64]; 2],
    /// At the place and east of it.
    half_u: [&'a [f64]; 2],
    /// At the place and north of it.
    half_v: [&'a [f64]; 2],
    /// At the place and east of it.
    flux_x: [&'a [f64]; 2],
    /// At the place and north of it.
    flux_y: [&'a [f64]; 2],
    /// At the place, north and east of it.
    vorticity: [&'a [f64]; 3],
    /// At the place, east, north and north-east of it.
    corners: [&'a [f64]; 4],
    /// At the place, west and south of it.
    bernoulli: [&'a [f64]; 3],
    out_h: &'a mut [f64],
    out_u: &'a mut [f64],
    out_v: &'a mut [f64],
}

impl<'a> Prognostics<'a> {
    /// Of row `row`, when the one north of it was pushed.
    #[inline(always)]
    pub fn new(
        shape: Shape,
        constants: Constants,
        at: &'a RowCoefficients,
        row: isize,
        gradients: &'a Gradients,
        [out_h, out_u, out_v]: [&'a mut [f64]; 3],
    ) -> Self {
        let n = shape.count;
        let (places, half_v_n) = (at.places(row, n), at.places(row + 1, n).half_v);
        let part = |row, first| shape.part(row, first);
        let of = |row, first| shape.of_place(row, first);
        let Gradients { flux_x, flux_y: [y, y_n], vorticity: [z, z_n], thickness: [q, q_n], bernoulli: [b_s, b] } =
            gradients;
        Self {
            constants,
            thickness: [of(places.thickness_x, 1), of(places.thickness_y, 1)],
            half_u: [of(places.half_u, 1), of(places.half_u, 2)],
            half_v: [of(places.half_v, 1), of(half_v_n, 1)],
            flux_x: [part(flux_x, 1), part(flux_x, 2)],
            flux_y: [part(y, 1), part(y_n, 1)],
            vorticity: [part(z, 1), part(z_n, 1), part(z, 2)],
            corners: [part(q, 1), part(q, 2), part(q_n, 1), part(q_n, 2)],
            bernoulli: [part(b, 1), part(b, 0), part(b_s, 1)],
            out_h: shape.part_mut(out_h, 1),
            out_u: shape.part_mut(out_u, 1),
            out_v: shape.part_mut(out_v, 1),
        }
    }
}

impl Lines<f64> for Prognostics<'_> {
    #[inline(always)]
    fn at<P: Places<f64>>(&mut self, places: P, first: usize) {
        let constants = self.constants.at(places);
        let [thickness_x, thickness_y] = coefficients(places, first, &self.thickness);
        let [half_u, half_u_e] = coefficients(places, first, &self.half_u);
        let [half_v, half_v_n] = coefficients(places, first, &self.half_v);
        let [x, x_e] = read(places, first, &self.flux_x);
        let [y, y_n] = read(places, first, &self.flux_y);
        let [z, z_n, z_e] = read(places, first, &self.vorticity);
        let [q, q_e, q_n, q_ne] = read(places, first, &self.corners);
        let [b, b_w, b_s] = read(places, first, &self.bernoulli);
        let kinetic = (half_u * x + half_u_e * x_e) + (half_v * y + half_v_n * y_n);
        let of_h = (constants.gravity * b + kinetic) - ((q + q_e) + (q_n + q_ne));
        let of_u = (thickness_x * x + half_u * (b + b_w)) - constants.minus_gradient_y(z, z_n);
        let of_v = (thickness_y * y + half_v * (b + b_s)) + constants.minus_gradient_x(z, z_e);
        places.write(self.out_h, first, of_h);
        places.write(self.out_u, first, of_u);
        places.write(self.out_v, first, of_v);
    }
}
