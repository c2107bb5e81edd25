//! What becomes of a row whose slopes are known, compiled for the processor's widest vectors.

use super::rows::{Ring, Row};
use crate::stored::Stored;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// How slopes make a step.
#[derive(Clone, Copy)]
pub(crate) enum Scheme<'a> {
    /// Rows of a (below the diagonal), b, and Δt.
    RungeKutta { a: &'a [&'a [f64]], b: &'a [f64], dt: f64 },
    /// The fields are those of two levels.
    Leapfrog(Leap),
    /// No step: the fields become their own slope.
    Slope,
}

impl Scheme<'_> {
    /// Number of evaluations of the tendency.
    #[inline]
    pub fn stages(self) -> usize {
        match self {
            Scheme::RungeKutta { b, .. } => b.len(),
            Scheme::Leapfrog(_) | Scheme::Slope => 1,
        }
    }

    /// Time levels of a state.
    pub fn levels(self) -> usize {
        match self {
            Scheme::RungeKutta { .. } | Scheme::Slope => 1,
            Scheme::Leapfrog(_) => 2,
        }
    }

    /// Part of the slopes of `row` known at a stage, with the times for which they act in the state of the next stage.
    #[inline]
    pub fn terms<N: Stored>(
        self,
        stage: usize,
        slopes: &[Ring<N>],
        row: isize,
        part: Range<usize>,
    ) -> ([(N, &[N]); 8], usize) {
        let mut terms: [(N, &[N]); 8] = [(N::default(), &[]); 8];
        let mut count = 0;
        if let Scheme::RungeKutta { a, b, dt } = self {
            let weights = if stage + 1 == b.len() { b } else { a[stage + 1] };
            for (&weight, slopes) in weights.iter().zip(slopes) {
                if weight != 0.0 {
                    terms[count] = (N::narrow(dt * weight), &slopes.row(row)[part.clone()]);
                    count += 1;
                }
            }
        }
        (terms, count)
    }

    /// The terms of k* of a stage in `row`, given y and the gradients of the later stages.
    #[inline]
    pub fn terms_ad<'t>(
        self,
        stage: usize,
        y: &'t [f64],
        gradients: &'t [Ring],
        row: isize,
    ) -> ([(f64, &'t [f64]); 8], usize) {
        let mut terms: [(f64, &[f64]); 8] = [(0.0, &[]); 8];
        let mut count = 1;
        terms[0].1 = y;
        match self {
            Scheme::RungeKutta { a, b, dt } => {
                terms[0].0 = dt * b[stage];
                for (weights, gradients) in a.iter().zip(gradients).skip(stage + 1) {
                    if weights[stage] != 0.0 {
                        terms[count] = (dt * weights[stage], &gradients.row(row)[..y.len()]);
                        count += 1;
                    }
                }
            }
            Scheme::Leapfrog(leapfrog) => terms[0].0 = 2.0 * leapfrog.dt,
            Scheme::Slope => terms[0].0 = 1.0,
        }
        (terms, count)
    }
}

/// Slopes of a row, `[variable, x]`, each with the time it acts for; added up in this order.
pub(crate) type Terms<'a, 'b, N = f64> = &'a [(N, &'b [N])];

/// `out` = x + Σ weight k for one row, `[variable, x]`.
pub(crate) fn combine<N: Stored>(arch: Arch, out: &mut [N], x: Row<'_, N>, nx: usize, terms: Terms<'_, '_, N>) {
    arch.dispatch(Combine { out, x, nx, terms });
}

/// The same in place, for the row that begins at `start` in each field.
pub(crate) fn add_slopes(arch: Arch, fields: &mut [&mut [f64]], start: usize, nx: usize, terms: Terms<'_, '_>) {
    arch.dispatch(AddSlopes { fields, start, nx, terms });
}

/// (x(t), x̄(t − Δt)) to (x(t + Δt), x̄(t)) for the row that begins at `start` in each field of both levels, given its
/// slope: see [`super::leapfrog`].
pub(crate) fn leap<N: Stored>(
    arch: Arch,
    leapfrog: Leap,
    levels: &mut [&mut [N]],
    start: usize,
    nx: usize,
    slope: &[N],
) {
    arch.dispatch(LeapRow { leapfrog, levels, start, nx, slope });
}

/// `out` = Σ weight k, added up in this order.
pub(crate) fn weigh(arch: Arch, out: &mut [f64], terms: Terms<'_, '_>) {
    arch.dispatch(Weigh { out, terms });
}

struct Weigh<'a, 'b> {
    out: &'a mut [f64],
    terms: Terms<'a, 'b>,
}

impl WithSimd for Weigh<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let (n, mut rest) = (self.out.len(), self.terms);
        let out = self.out;
        if let [(weight, first), (next_weight, next), others @ ..] = rest {
            let (first, next) = (&first[..n], &next[..n]);
            for i in 0..n {
                out[i] = weight * first[i] + next_weight * next[i];
            }
            rest = others;
        } else if let [(weight, first), others @ ..] = rest {
            let first = &first[..n];
            for i in 0..n {
                out[i] = weight * first[i];
            }
            rest = others;
        }
        rest.iter().for_each(|&term| add(out, [term], 0..n));
    }
}

struct Combine<'a, 'b, N> {
    out: &'a mut [N],
    x: Row<'a, N>,
    nx: usize,
    terms: Terms<'a, 'b, N>,
}

impl<N: Stored> WithSimd for Combine<'_, '_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (variable, out) in self.out.chunks_exact_mut(self.nx).enumerate() {
            let (x, part) = (self.x.variable(variable), variable * self.nx..(variable + 1) * self.nx);
            match *self.terms {
                [a] => sum(out, x, [a], part),
                [a, b] => sum(out, x, [a, b], part),
                [a, b, c] => sum(out, x, [a, b, c], part),
                [a, b, c, d] => sum(out, x, [a, b, c, d], part),
                _ => {
                    out.copy_from_slice(x);
                    self.terms.iter().for_each(|&term| add(out, [term], part.clone()));
                }
            }
        }
    }
}

#[inline(always)]
fn sum<N: Stored, const T: usize>(out: &mut [N], x: &[N], terms: [(N, &[N]); T], part: Range<usize>) {
    let n = out.len();
    let (x, mut own) = (&x[..n], terms);
    for term in 0..T {
        own[term].1 = &terms[term].1[part.clone()][..n];
    }
    for i in 0..n {
        let mut value = x[i];
        for term in 0..T {
            value += own[term].0 * own[term].1[i];
        }
        out[i] = value;
    }
}

struct AddSlopes<'a, 'b, 'c> {
    fields: &'a mut [&'c mut [f64]],
    start: usize,
    nx: usize,
    terms: Terms<'a, 'b>,
}

impl WithSimd for AddSlopes<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (variable, field) in self.fields.iter_mut().enumerate() {
            let (x, part) = (&mut field[self.start..][..self.nx], variable * self.nx..(variable + 1) * self.nx);
            match *self.terms {
                [a, b, c] => add(x, [a, b, c], part),
                [a, b, c, d] => add(x, [a, b, c, d], part),
                _ => self.terms.iter().for_each(|&term| add(x, [term], part.clone())),
            }
        }
    }
}

#[inline(always)]
fn add<N: Stored, const T: usize>(x: &mut [N], terms: [(N, &[N]); T], part: Range<usize>) {
    let n = x.len();
    let mut own = terms;
    for term in 0..T {
        own[term].1 = &terms[term].1[part.clone()][..n];
    }
    for i in 0..n {
        let mut value = x[i];
        for term in 0..T {
            value += own[term].0 * own[term].1[i];
        }
        x[i] = value;
    }
}

/// The numbers of the leapfrog scheme.
#[derive(Clone, Copy)]
pub(crate) struct Leap {
    /// Δt.
    pub dt: f64,
    /// The filter's α.
    pub alpha: f64,
}

impl Leap {
    /// (now, before) to (new, filtered).
    #[inline(always)]
    pub fn advance<N: Stored>(self, now: &mut [N], before: &mut [N], slope: &[N]) {
        let [two_dt, alpha, two] = [2.0 * self.dt, self.alpha, 2.0].map(N::narrow);
        let n = now.len();
        let (before, slope) = (&mut before[..n], &slope[..n]);
        for i in 0..n {
            let new = before[i] + two_dt * slope[i];
            before[i] = now[i] + alpha * (new - two * now[i] + before[i]);
            now[i] = new;
        }
    }

    /// The transpose of [`Leap::advance`] on gradients (n*, f*) with respect to the new and the filtered level: (now*, before*),
    /// given m* = n* + α f* and the gradient through the slope, g = f'ᵀ 2Δt m*:
    /// now* = (1 − 2α) f* + g, before* = m* + α f*.
    pub fn take_back(self, now: &mut [f64], before: &mut [f64], new: &[f64], gradient: &[f64]) {
        let n = now.len();
        let (before, new, gradient) = (&mut before[..n], &new[..n], &gradient[..n]);
        for i in 0..n {
            now[i] = (1.0 - 2.0 * self.alpha) * before[i] + gradient[i];
            before[i] = new[i] + self.alpha * before[i];
        }
    }
}

struct LeapRow<'a, 'b, N> {
    leapfrog: Leap,
    levels: &'a mut [&'b mut [N]],
    start: usize,
    nx: usize,
    slope: &'a [N],
}

impl<N: Stored> WithSimd for LeapRow<'_, '_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let part = self.start..self.start + self.nx;
        let (now, before) = self.levels.split_at_mut(self.levels.len() / 2);
        for ((now, before), slope) in now.iter_mut().zip(before).zip(self.slope.chunks_exact(self.nx)) {
            self.leapfrog.advance(&mut now[part.clone()], &mut before[part.clone()], slope);
        }
    }
}
