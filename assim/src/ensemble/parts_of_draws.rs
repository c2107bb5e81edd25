//! Draws of which each rank makes its share, and has its part of all.

use crate::covariance::Covariance;
use isobar_model::Bands;
use rayon::prelude::*;

/// Parts of draws from N(0, U Uᵀ) for states of `len` values, zero if there is no covariance, given what all ranks draw alike for
/// each: normal numbers of the root's control space, and others, which are given back. Each rank makes whole columns of its share
/// of the draws.
pub(super) fn draw_parts(
    bands: &Bands,
    (covariance, len): (Option<&dyn Covariance>, usize),
    draws: usize,
    mut draw: impl FnMut() -> (Vec<f64>, Vec<f64>),
) -> impl Iterator<Item = (Vec<f64>, Vec<f64>)> {
    let (share, mut own, mut others) = (bands.share(draws), Vec::new(), Vec::new());
    for number in 0..draws {
        let (normals, other) = draw();
        others.push(other);
        if share.contains(&number) {
            own.push(normals);
        }
    }
    let make = |normals: &Vec<f64>| {
        let mut column = vec![0.0; len];
        if let Some(covariance) = covariance {
            covariance.root_add(normals, &mut column);
        }
        column
    };
    bands.deal(own.par_iter().map(make).collect()).into_iter().zip(others)
}
