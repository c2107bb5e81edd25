//! Rows of a group of columns as vectors of the processor.

use crate::stored::Stored;
use pulp::Simd;

/// Evaluates an expression in which a constant is the number of vectors that hold the lanes of a place.
macro_rules! for_vectors {
    ($simd:ty, $number:ty, $vectors:ident => $expression:expr) => {
        $crate::shallow_water::lanes::for_vectors!(
            <$number as $crate::arithmetic::Arithmetic>::COLUMNS
                / <$number as $crate::arithmetic::Arithmetic>::lanes::<$simd>(),
            $vectors => $expression; 1, 2, 4, 8, 16
        )
    };
    ($count:expr, $vectors:ident => $expression:expr; $($number:literal),*) => {
        match $count {
            $($number => {
                const $vectors: usize = $number;
                $expression
            })*
            count => panic!("no function for places of {count} vectors"),
        }
    };
}
pub(super) use for_vectors;

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
pub(super) fn places<S: Simd, N: Stored, const P: usize>(row: &[N]) -> &[[N::Vector<S>; P]] {
    N::as_vectors::<S>(row).as_chunks().0
}

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
pub(super) fn places_mut<S: Simd, N: Stored, const P: usize>(row: &mut [N]) -> &mut [[N::Vector<S>; P]] {
    N::as_vectors_mut::<S>(row).as_chunks_mut().0
}
