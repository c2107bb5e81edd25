//! How increments are stored: in double precision or in single.

use crate::arithmetic::Arithmetic;

/// Increments one after another, each `[variable, y, x]`, in the precision in which they are stored.
#[derive(Debug)]
pub enum ColumnsMut<'a> {
    /// Double precision.
    Double(&'a mut [f64]),
    /// Single precision.
    Single(&'a mut [f32]),
}

impl<'a> ColumnsMut<'a> {
    /// The same for a shorter time.
    pub fn reborrow(&mut self) -> ColumnsMut<'_> {
        match self {
            Self::Double(columns) => ColumnsMut::Double(columns),
            Self::Single(columns) => ColumnsMut::Single(columns),
        }
    }

    /// Fields of this number of values, one after another.
    pub fn fields(self, len: usize) -> Box<dyn Iterator<Item = ColumnsMut<'a>> + 'a> {
        match self {
            Self::Double(columns) => Box::new(columns.chunks_exact_mut(len).map(ColumnsMut::Double)),
            Self::Single(columns) => Box::new(columns.chunks_exact_mut(len).map(ColumnsMut::Single)),
        }
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Double(columns) => columns.len(),
            Self::Single(columns) => columns.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A number of an increment as it is stored: `f64`, or `f32` for half the memory and twice as many numbers in a vector of the
/// processor, at the price of a relative error of 2⁻²⁴ whenever it is written or computed with.
pub trait Stored: Arithmetic {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Widened and narrowed again every number is itself, down to the smallest; narrowed it is the nearest.
    #[test]
    fn widening_is_exact_and_narrowing_goes_to_the_nearest() {
        for bits in (0..0x7f80_0000_u32).step_by(9973) {
            let (value, next) = (f32::from_bits(bits), f32::from_bits(bits + 1));
            assert_eq!(f32::narrow(value.widen()).to_bits(), bits);
            assert_eq!((-value).widen(), -value.widen());
            if next.is_finite() {
                let middle = 0.5 * (value.widen() + next.widen());
                assert!(
                    value.widen() < middle && middle < next.widen(),
                    "exact, so that there is something between them"
                );
                assert_eq!(f32::narrow(middle.next_down()), value);
                assert_eq!(f32::narrow(middle.next_up()), next);
            }
        }
        let mut scratch = Vec::new();
        let mut values = [0.1_f32, -3.0];
        f32::in_double(&mut values, &mut scratch, |values| values.iter_mut().for_each(|value| *value *= 1.0 + 1e-9));
        assert_eq!(values, [0.1_f32, -3.0]);
    }
}
