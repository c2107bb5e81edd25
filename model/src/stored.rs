//! How increments are stored: in double precision or in single. All arithmetic is in double.

use std::fmt::Debug;

/// Increments one after another, each `[variable, y, x]`, in the precision in which they are stored.
#[derive(Debug)]
pub enum ColumnsMut<'a> {
    /// Double precision.
    Double(&'a mut [f64]),
    /// Single precision.
    Single(&'a mut [f32]),
}

/// A number of an increment as it is stored: `f64`, or `f32` for half the memory at the price of a relative error of 2⁻²⁴
/// whenever it is written.
pub trait Stored: sealed::Sealed + Copy + Debug + Default + PartialEq + Send + Sync + 'static {
    /// The number in double precision, exactly.
    fn widen(self) -> f64;

    /// The nearest number that can be stored.
    fn narrow(value: f64) -> Self;

    /// [`Stored::narrow`] of each value, into as many places.
    #[inline(always)]
    fn narrow_all(values: &[f64], stored: &mut [Self]) {
        stored.iter_mut().zip(values).for_each(|(stored, &value)| *stored = Self::narrow(value));
    }

    /// Applies `process` to the values in double precision: in place or, if they are stored in single precision, to a
    /// copy in `scratch`, which is then rounded back.
    fn in_double<R>(values: &mut [Self], scratch: &mut Vec<f64>, process: impl FnOnce(&mut [f64]) -> R) -> R;

    /// The columns in the precision in which they are stored.
    fn columns_mut(columns: &mut [Self]) -> ColumnsMut<'_>;
}

impl Stored for f64 {
    #[inline(always)]
    fn widen(self) -> f64 {
        self
    }

    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn in_double<R>(values: &mut [Self], _scratch: &mut Vec<f64>, process: impl FnOnce(&mut [f64]) -> R) -> R {
        process(values)
    }

    fn columns_mut(columns: &mut [Self]) -> ColumnsMut<'_> {
        ColumnsMut::Double(columns)
    }
}

impl Stored for f32 {
    #[inline(always)]
    fn widen(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value as f32
    }

    #[inline(always)]
    fn in_double<R>(values: &mut [Self], scratch: &mut Vec<f64>, process: impl FnOnce(&mut [f64]) -> R) -> R {
        scratch.clear();
        scratch.extend(values.iter().map(|&value| f64::from(value)));
        let result = process(scratch);
        Self::narrow_all(scratch, values);
        result
    }

    fn columns_mut(columns: &mut [Self]) -> ColumnsMut<'_> {
        ColumnsMut::Single(columns)
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f64 {}
    impl Sealed for f32 {}
}
