//! How increments are stored: in double precision or in single. All arithmetic is in double.

use crate::forecast::TangentLinear;
use crate::state::State;
use std::fmt::Debug;

/// A number of an increment as it is stored: `f64`, or `f32` for half the memory at the price of a relative error of 2⁻²⁴
/// whenever it is written.
pub trait Stored: sealed::Sealed + Copy + Debug + Default + PartialEq + Send + Sync + 'static {
    /// The number in double precision, exactly.
    fn widen(self) -> f64;

    /// The nearest number that can be stored.
    fn narrow(value: f64) -> Self;

    /// [`Stored::narrow`] of as many values as there are to be stored.
    #[inline(always)]
    fn narrow_all(values: &[f64], stored: &mut [Self]) {
        stored.iter_mut().zip(values).for_each(|(stored, &value)| *stored = Self::narrow(value));
    }

    /// Applies `process` to values in double precision: to these themselves or, if they are not, to a copy of them in
    /// `scratch`, which is then rounded back.
    fn in_double<R>(values: &mut [Self], scratch: &mut Vec<f64>, process: impl FnOnce(&mut [f64]) -> R) -> R;

    /// [`TangentLinear::steps_tl`] or [`TangentLinear::steps_tl_single`].
    fn steps_tl(model: &dyn TangentLinear, at: &State, columns: &mut [Self], steps: usize);
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

    fn steps_tl(model: &dyn TangentLinear, at: &State, columns: &mut [Self], steps: usize) {
        model.steps_tl(at, columns, steps);
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

    fn steps_tl(model: &dyn TangentLinear, at: &State, columns: &mut [Self], steps: usize) {
        model.steps_tl_single(at, columns, steps);
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f64 {}
    impl Sealed for f32 {}
}
