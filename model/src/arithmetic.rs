//! Arithmetic of double and of single precision, in scalars and in vectors of the processor: sweeps over columns are written
//! once for both.

use pulp::Simd;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Sub, SubAssign};

/// A number, or one for each of several places.
pub trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// The number times a factor.
    fn times(self, factor: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        factor * self
    }
}

impl Number for f32 {
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        factor as f32 * self
    }
}

/// A number with its vector operations; sealed, as nothing outside of this crate can name it.
///
/// No operations are fused or reordered, so that the bits are the same on all processors.
pub trait Arithmetic: Number + Debug + Default + PartialEq + AddAssign + SubAssign + Send + Sync + 'static {
    /// A number for each of the columns that are advanced together.
    type Place: Copy + AsRef<[Self]> + AsMut<[Self]>;

    /// A vector of the processor.
    type Vector<S: Simd>: Copy;

    /// How many columns are advanced together: as many as the widest vectors have lanes.
    const COLUMNS: usize;

    /// Lanes of a vector.
    fn lanes<S: Simd>() -> usize;

    /// Cuts a row into its places.
    fn as_places(row: &[Self]) -> &[Self::Place];

    /// Cuts a row into its places.
    fn as_places_mut(row: &mut [Self]) -> &mut [Self::Place];

    /// Cuts a row into vectors.
    fn as_vectors<S: Simd>(row: &[Self]) -> &[Self::Vector<S>];

    /// Cuts a row into vectors.
    fn as_vectors_mut<S: Simd>(row: &mut [Self]) -> &mut [Self::Vector<S>];

    /// The numbers of a vector.
    fn numbers<S: Simd>(vector: &Self::Vector<S>) -> &[Self];

    /// The number in all lanes.
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;

    /// a + b.
    fn sum<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;

    /// a − b.
    fn difference<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;

    /// a b.
    fn product<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;

    /// a / b.
    fn quotient<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
}

/// Implements [`Arithmetic`] by the functions of [`Simd`] for a number.
macro_rules! arithmetic {
    (
        $number:ty, $columns:literal, $vector:ident, $lanes:ident,
        $cut:ident, $cut_mut:ident, $splat:ident, $sum:ident, $difference:ident, $product:ident, $quotient:ident
    ) => {
        impl Arithmetic for $number {
            type Place = [Self; $columns];
            type Vector<S: Simd> = S::$vector;
            const COLUMNS: usize = $columns;

            #[inline(always)]
            fn lanes<S: Simd>() -> usize {
                S::$lanes
            }

            #[inline(always)]
            fn as_places(row: &[Self]) -> &[Self::Place] {
                row.as_chunks().0
            }

            #[inline(always)]
            fn as_places_mut(row: &mut [Self]) -> &mut [Self::Place] {
                row.as_chunks_mut().0
            }

            #[inline(always)]
            fn as_vectors<S: Simd>(row: &[Self]) -> &[S::$vector] {
                S::$cut(row).0
            }

            #[inline(always)]
            fn as_vectors_mut<S: Simd>(row: &mut [Self]) -> &mut [S::$vector] {
                S::$cut_mut(row).0
            }

            #[inline(always)]
            fn numbers<S: Simd>(vector: &S::$vector) -> &[Self] {
                pulp::bytemuck::cast_slice(std::slice::from_ref(vector))
            }

            #[inline(always)]
            fn splat<S: Simd>(simd: S, value: Self) -> S::$vector {
                simd.$splat(value)
            }

            #[inline(always)]
            fn sum<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$sum(a, b)
            }

            #[inline(always)]
            fn difference<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$difference(a, b)
            }

            #[inline(always)]
            fn product<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$product(a, b)
            }

            #[inline(always)]
            fn quotient<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$quotient(a, b)
            }
        }
    };
}

arithmetic!(
    f64,
    8,
    f64s,
    F64_LANES,
    as_simd_f64s,
    as_mut_simd_f64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    div_f64s
);
arithmetic!(
    f32,
    16,
    f32s,
    F32_LANES,
    as_simd_f32s,
    as_mut_simd_f32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    div_f32s
);
