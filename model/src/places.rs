//! Lines evaluated at all places of a row, as many at a time as a vector of the processor holds.
//!
//! A plain loop is as fast where a row is long. Where it is short, a compiler that cannot tell whether what is written overlaps
//! what is read compares them before every row, or takes the places one after another.
//!
//! Of several states that lie interleaved in a row, `[x, lane]`, each value counts as a place.

use crate::arithmetic::{Arithmetic, Number};
use crate::stored::Stored;
use pulp::Simd;
use std::ops::{Add, Div, Mul, Sub};

/// Numbers of places beside each other.
#[derive(Clone, Copy)]
pub(crate) struct Vector<S: Simd, N: Arithmetic> {
    simd: S,
    numbers: N::Vector<S>,
}

impl<S: Simd, N: Stored> Number for Vector<S, N> {
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        self * Vectors(self.simd).all(N::narrow(factor))
    }
}

/// Implements an operator of vectors by a function of their numbers.
macro_rules! operator {
    ($operator:ident, $method:ident, $function:ident) => {
        impl<S: Simd, N: Arithmetic> $operator for Vector<S, N> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { numbers: N::$function(self.simd, self.numbers, other.numbers), ..self }
            }
        }
    };
}

operator!(Add, add, sum);
operator!(Sub, sub, difference);
operator!(Mul, mul, product);
operator!(Div, div, quotient);

/// One place, or several beside each other.
pub(crate) trait Places<N>: Copy {
    /// The numbers of these places.
    type Number: Number;

    /// The same number for all of them.
    fn all(self, number: N) -> Self::Number;

    /// Those of a row, from one of its values on.
    fn read(self, row: &[N], first: usize) -> Self::Number;

    /// Those of a row of coefficients, which has one for each place, whatever the values of a place in other rows.
    #[inline(always)]
    fn coefficient(self, row: &[N], first: usize) -> Self::Number {
        self.read(row, first)
    }

    /// Puts them into a row, from one of its values on.
    fn write(self, row: &mut [N], first: usize, numbers: Self::Number);

    /// The same in the precision of the row.
    fn store<M: Stored>(self, row: &mut [M], first: usize, numbers: Self::Number);
}

/// One place.
#[derive(Clone, Copy)]
pub(crate) struct One;

impl<N: Stored> Places<N> for One {
    type Number = N;

    #[inline(always)]
    fn all(self, number: N) -> N {
        number
    }

    #[inline(always)]
    fn read(self, row: &[N], first: usize) -> N {
        row[first]
    }

    #[inline(always)]
    fn write(self, row: &mut [N], first: usize, number: N) {
        row[first] = number;
    }

    #[inline(always)]
    fn store<M: Stored>(self, row: &mut [M], first: usize, number: N) {
        row[first] = M::narrow(number.widen());
    }
}

/// As many places as a vector has lanes.
#[derive(Clone, Copy)]
struct Vectors<S>(S);

impl<S: Simd, N: Stored> Places<N> for Vectors<S> {
    type Number = Vector<S, N>;

    #[inline(always)]
    fn all(self, number: N) -> Vector<S, N> {
        Vector { simd: self.0, numbers: N::splat(self.0, number) }
    }

    #[inline(always)]
    fn read(self, row: &[N], first: usize) -> Vector<S, N> {
        Vector { simd: self.0, numbers: N::as_vectors::<S>(&row[first..first + N::lanes::<S>()])[0] }
    }

    #[inline(always)]
    fn write(self, row: &mut [N], first: usize, numbers: Vector<S, N>) {
        N::as_vectors_mut::<S>(&mut row[first..first + N::lanes::<S>()])[0] = numbers.numbers;
    }

    #[inline(always)]
    fn store<M: Stored>(self, row: &mut [M], first: usize, numbers: Vector<S, N>) {
        let row = &mut row[first..first + N::lanes::<S>()];
        row.iter_mut()
            .zip(N::numbers::<S>(&numbers.numbers))
            .for_each(|(out, number)| *out = M::narrow(number.widen()));
    }
}

/// Some of the columns of a group at one place.
#[derive(Clone, Copy)]
struct OfGroup<S>(Vectors<S>);

impl<S: Simd, N: Stored> Places<N> for OfGroup<S> {
    type Number = Vector<S, N>;

    #[inline(always)]
    fn all(self, number: N) -> Vector<S, N> {
        self.0.all(number)
    }

    #[inline(always)]
    fn read(self, row: &[N], first: usize) -> Vector<S, N> {
        self.0.read(row, first)
    }

    #[inline(always)]
    fn coefficient(self, row: &[N], first: usize) -> Vector<S, N> {
        self.0.all(row[first / N::COLUMNS])
    }

    #[inline(always)]
    fn write(self, row: &mut [N], first: usize, numbers: Vector<S, N>) {
        self.0.write(row, first, numbers);
    }

    #[inline(always)]
    fn store<M: Stored>(self, row: &mut [M], first: usize, numbers: Vector<S, N>) {
        self.0.store(row, first, numbers);
    }
}

/// A coefficient of the places of a row: a value for each, or one for all.
pub(crate) trait Coefficient<N>: Copy {
    /// Without the values before one.
    fn from(self, first: usize) -> Self;

    /// No more values than this.
    fn take(self, count: usize) -> Self;

    /// Those of some places, as [`Places::read`].
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

/// Numbers of several rows. (A loop and not [`array::map`], which need not be inlined, and is then compiled for no vectors.)
#[inline(always)]
pub(crate) fn read<N, P: Places<N>, const ROWS: usize>(
    places: P,
    first: usize,
    rows: &[&[N]; ROWS],
) -> [P::Number; ROWS] {
    let mut numbers = [places.read(rows[0], first); ROWS];
    for row in 1..ROWS {
        numbers[row] = places.read(rows[row], first);
    }
    numbers
}

/// The same of rows of coefficients.
#[inline(always)]
pub(crate) fn coefficients<N, P: Places<N>, const ROWS: usize>(
    places: P,
    first: usize,
    rows: &[&[N]; ROWS],
) -> [P::Number; ROWS] {
    let mut numbers = [places.coefficient(rows[0], first); ROWS];
    for row in 1..ROWS {
        numbers[row] = places.coefficient(rows[row], first);
    }
    numbers
}

/// What is to be done at each place of a row. It may be done twice, so that it writes nothing that it reads.
pub(crate) trait Lines<N> {
    /// Does it at some places, given which of the values of a row is the first of theirs.
    fn at<P: Places<N>>(&mut self, places: P, first: usize);
}

/// Evaluates the lines at `count` places.
#[inline(always)]
pub(crate) fn at_each_place<S: Simd, N: Stored>(simd: S, count: usize, mut lines: impl Lines<N>) {
    let lanes = N::lanes::<S>();
    let Some(last) = count.checked_sub(lanes) else {
        for place in 0..count {
            lines.at(One, place);
        }
        return;
    };
    let mut first = 0;
    while first < last {
        lines.at(Vectors(simd), first);
        first += lanes;
    }
    // The last places that fill a vector, some of which may have been done.
    lines.at(Vectors(simd), last);
}

/// Evaluates the lines for each column of a group at `count` places.
#[inline(always)]
pub(crate) fn at_each_place_of_group<S: Simd, N: Stored>(simd: S, count: usize, mut lines: impl Lines<N>) {
    for part in (0..N::COLUMNS).step_by(N::lanes::<S>()) {
        for place in 0..count {
            lines.at(OfGroup(Vectors(simd)), place * N::COLUMNS + part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    /// a + 2 b at each place, b being a coefficient.
    struct Example<'a, N> {
        of_group: bool,
        rows: [&'a [N]; 1],
        coefficients: [&'a [N]; 1],
        out: &'a mut [N],
    }

    impl<N: Stored> Lines<N> for Example<'_, N> {
        fn at<P: Places<N>>(&mut self, places: P, first: usize) {
            let ([a], [b]) = (read(places, first, &self.rows), coefficients(places, first, &self.coefficients));
            places.write(self.out, first, a + b.times(2.0));
        }
    }

    impl<N: Stored> WithSimd for Example<'_, N> {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            let count = self.coefficients[0].len();
            if self.of_group { at_each_place_of_group(simd, count, self) } else { at_each_place(simd, count, self) }
        }
    }

    fn check<N: Stored>() {
        for (count, of_group) in (0..40).flat_map(|count| [(count, false), (count, true)]) {
            let lanes = if of_group { N::COLUMNS } else { 1 };
            let numbers = |count: usize| -> Vec<N> { (0..count).map(|k| N::narrow((k * k % 97) as f64)).collect() };
            let (a, b, mut out) = (numbers(count * lanes), numbers(count), vec![N::default(); count * lanes]);
            Arch::new().dispatch(Example { of_group, rows: [&a], coefficients: [&b], out: &mut out });
            let expected = a.iter().enumerate().map(|(k, &a)| a + b[k / lanes].times(2.0));
            assert!(expected.eq(out), "{count} places, {lanes} values of each");
        }
    }

    #[test]
    fn lines_are_evaluated_at_every_place_of_rows_of_any_length() {
        check::<f64>();
        check::<f32>();
    }
}
