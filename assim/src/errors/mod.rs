//! Forms in which a [`Filter`](crate::filter::Filter) keeps the covariance P of its errors.
//!
//! | module | P |
//! |---|---|
//! | [`dense`] | the whole matrix: the reference for every other method; analysed at once or one observation at a time |
//! | [`banded`] | a band beside what the calibration parameters explain: the Frobenius recursion |
//! | [`blocks`] | blocks of the grid and common factors: Lange's Fast Kalman Filter |
//! | [`local`] | blocks of the grid and factors of tiles, whose number does not grow with the domain |

pub mod banded;
pub mod blocks;
pub mod dense;
pub mod local;
