//! Rows of eight columns as vectors of the processor.

use pulp::Simd;

/// Calls a function for as many vectors as hold the lanes of a place.
macro_rules! for_vectors {
    ($function:ident::<$simd:ident>($($argument:expr),*)) => {
        match crate::columns::LANES / $simd::F64_LANES {
            1 => $function::<$simd, 1>($($argument),*),
            2 => $function::<$simd, 2>($($argument),*),
            4 => $function::<$simd, 4>($($argument),*),
            8 => $function::<$simd, 8>($($argument),*),
            _ => panic!("eight numbers do not fill vectors of {}", $simd::F64_LANES),
        }
    };
}
pub(super) use for_vectors;

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
pub(super) fn places<S: Simd, const P: usize>(row: &[f64]) -> &[[S::f64s; P]] {
    S::as_simd_f64s(row).0.as_chunks().0
}

/// Places of a row of one variable, the lanes of each in `P` vectors.
#[inline(always)]
pub(super) fn places_mut<S: Simd, const P: usize>(row: &mut [f64]) -> &mut [[S::f64s; P]] {
    S::as_mut_simd_f64s(row).0.as_chunks_mut().0
}
