//! Forecast of the residual blocks without the propagator: they persist, as far as random probes say.

use super::blocks::Blocks;
use super::factored_covariance::Patch;
use crate::linalg::semidefinite_root;
use faer::Mat;
use isobar_model::Layout;
use isobar_model::random::standard_normals;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// The patches returned to the blocks: of a merged component, the covariance within each block stays.
///
/// A block diagonal of a positive semidefinite matrix is one.
pub(super) fn return_to_blocks(patches: &[Patch], blocks: &Blocks) -> Vec<Patch> {
    let mut patch_of = vec![(0, 0); blocks.variables()];
    for (number, patch) in patches.iter().enumerate() {
        for (position, &variable) in patch.variables.iter().enumerate() {
            patch_of[variable] = (number, position);
        }
    }
    blocks
        .members
        .par_iter()
        .map(|variables| {
            // A block is never split: all of it is in one patch.
            let source = &patches[patch_of[variables[0]].0].covariance;
            let position = |i: usize| patch_of[variables[i]].1;
            let covariance = Mat::from_fn(variables.len(), variables.len(), |i, j| source[(position(i), position(j))]);
            Patch { variables: variables.clone(), covariance }
        })
        .collect()
}

/// `count` draws of the state's part of N(0, blkdiag(C_k)), one after another.
pub(super) fn draw_probes(patches: &[Patch], m: usize, count: usize, random: &mut ChaCha8Rng) -> Vec<f64> {
    let roots: Vec<Mat<f64>> = patches.par_iter().map(|patch| semidefinite_root(patch.covariance.as_ref())).collect();
    let mut probes = vec![0.0; m * count];
    for probe in probes.chunks_exact_mut(m) {
        for (patch, root) in patches.iter().zip(&roots) {
            let normals = standard_normals(random, patch.variables.len());
            for (i, &variable) in patch.variables.iter().enumerate().filter(|(_, variable)| **variable < m) {
                probe[variable] = (0..=i).map(|j| root[(i, j)] * normals[j]).sum();
            }
        }
    }
    probes
}

/// How much of its standard deviation each variable of the state keeps: ρ_v² = Σ (probes out)_v² / Σ (probes in)_v².
pub(super) fn persistence(layout: &Layout, before: &[f64], after: &[f64]) -> Vec<f64> {
    let cells = layout.grid.cells();
    let energy = |probes: &[f64]| {
        let mut sums = vec![0.0; layout.variables.len()];
        for (index, value) in probes.iter().enumerate() {
            sums[index % layout.len() / cells] += value * value;
        }
        sums
    };
    let ratio = |(after, before): (f64, f64)| if before > 0.0 { (after / before).sqrt() } else { 1.0 };
    energy(after).into_iter().zip(energy(before)).map(ratio).collect()
}

/// C_k ← ρ_i ρ_j C_k; local parameters persist.
pub(super) fn scale(patches: &mut [Patch], layout: &Layout, persistence: &[f64]) {
    let (m, cells) = (layout.len(), layout.grid.cells());
    patches.par_iter_mut().for_each(|patch| {
        let factors: Vec<f64> = patch
            .variables
            .iter()
            .map(|&variable| if variable < m { persistence[variable / cells] } else { 1.0 })
            .collect();
        for (j, &column) in factors.iter().enumerate() {
            for (i, &row) in factors.iter().enumerate() {
                patch.covariance[(i, j)] *= row * column;
            }
        }
    });
}
