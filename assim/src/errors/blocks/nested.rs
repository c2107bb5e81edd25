//! The analysis where even the separators of the blocks are too many for the border: nested elimination.
//!
//! With C_k = L_k L_k' + C_rest (see `separation`), the observations see the amplitudes w_k ~ N(0, I) of each block
//! b_k = L_k w_k + rest, and those ξ of the common factors. They and their prior rows are one sparse regression, which is
//! solved by nested dissection. Estimates are exact, and so is the covariance but for what blocks get in common beyond
//! the factors. That is dropped: merged blocks keep it until the next forecast, of which only the exact one has a use for it.

use super::BlockErrors;
use super::separation::Seen;
use super::solution::{Solved, SplitRows};
use crate::block_angular::{Component, Eliminated, PartitionSizes, Prior, SparseRegression, solve_sparse};
use crate::error::Error;
use crate::linalg::{add_product, column, product};
use crate::problem::Innovations;
use faer::Mat;
use isobar_obs::SparseRows;
use rayon::prelude::*;

/// Unknowns of a part of the nested elimination.
const LARGEST_PART: usize = 96;

impl BlockErrors {
    /// Analyses the innovations, where the first `free` columns of Φ are no factors; returns the sizes of the partition too.
    pub(super) fn update_nested(
        &mut self,
        rows: &SplitRows,
        innovations: &Innovations,
        seen: &[bool],
        free: usize,
    ) -> Result<(Solved, PartitionSizes), Error> {
        let observed: Vec<usize> =
            (0..self.frame.blocks.count()).filter(|&block| !self.seen_positions(block, seen).is_empty()).collect();
        let split: Vec<Seen> = observed
            .par_iter()
            .map(|&block| {
                Seen::new(
                    self.memory.covariance.own.block(&self.frame.blocks, block),
                    &self.seen_positions(block, seen),
                )
            })
            .collect();
        // Numbers of the amplitudes of each block.
        let mut first = vec![0];
        split.iter().for_each(|own| first.push(first[first.len() - 1] + own.root.ncols()));
        let (n, amplitudes) = (innovations.departures.len(), first[observed.len()]);
        let r = self.memory.covariance.factors.columns();
        let needed_bytes = 8 * (n as u64 + 3 * amplitudes as u64) * r as u64;
        if needed_bytes > self.frame.memory_limit_bytes {
            return Err(Error::TooLarge {
                what: format!("the analysis of {n} observations, which see {amplitudes} variables, with {r} factors"),
                needed_bytes,
                limit_bytes: self.frame.memory_limit_bytes,
            });
        }
        let mut x = SparseRows::new();
        for row in 0..n {
            x.push_row(rows.block.row(row).iter().flat_map(|&(variable, weight)| {
                let (block, position) = self.frame.blocks.place(variable);
                let number = observed.binary_search(&block).expect("the row sees the block");
                let (root, first) = (&split[number].root, first[number]);
                // Zeros too: with them one row links all amplitudes of a block.
                (0..root.ncols()).map(move |j| (first + j, weight * root[(position, j)]))
            }));
        }
        (0..amplitudes).for_each(|number| x.push_row([(number, 1.0)]));
        let all = Component { blocks: Vec::new(), observations: (0..n).collect() };
        let seen_factors = self.observed_factors(&[all], rows);
        let g = Mat::from_fn(n + amplitudes, r, |i, j| if i < n { seen_factors[j * n + i] } else { 0.0 });
        let y: Vec<f64> = innovations.departures.iter().copied().chain((0..amplitudes).map(|_| 0.0)).collect();
        let variance: Vec<f64> = innovations.variance.iter().copied().chain((0..amplitudes).map(|_| 1.0)).collect();
        let system = SparseRegression { unknowns: amplitudes, x: &x, g: g.as_ref(), y: &y, variance: &variance };
        let prior = Prior { mean: vec![0.0; r], covariance: Mat::identity(r, r) };
        let solved = solve_sparse(&system, Some(&prior), LARGEST_PART)?;
        // ŵ for ξ = 0.
        let mut estimate = column(&solved.estimate);
        add_product(estimate.as_mut(), 1.0, solved.sensitivity.as_ref(), column(&solved.border).as_ref());
        let groups: Vec<Vec<usize>> = first.windows(2).map(|pair| (pair[0]..pair[1]).collect()).collect();
        let covariances = solved.conditional_covariances(&groups);
        let eliminated: Vec<(Vec<usize>, Eliminated)> = (split.into_par_iter().zip(&observed).zip(&groups))
            .zip(covariances)
            .map(|(((own, &block), group), covariance)| {
                let range = group[0]..group[0] + group.len();
                let spread = product(own.root.as_ref(), covariance.as_ref());
                let mut covariance = own.rest;
                add_product(covariance.as_mut(), 1.0, spread.as_ref(), own.root.transpose());
                let eliminated = Eliminated {
                    border_rows: Mat::new(),
                    estimate_without_border: product(own.root.as_ref(), estimate.as_ref().get(range.clone(), ..)),
                    covariance,
                    sensitivity: product(own.root.as_ref(), solved.sensitivity.as_ref().get(range, ..)),
                };
                (self.frame.blocks.members(block).to_vec(), eliminated)
            })
            .collect();
        let components: Vec<Component> =
            observed.into_iter().map(|block| Component { blocks: vec![block], observations: Vec::new() }).collect();
        let mut increment = vec![0.0; self.frame.blocks.variables()];
        self.memory.covariance.linked.clear();
        self.take_in(&components, eliminated, &mut increment);
        let chi2 = solved.residual_chi2;
        Ok((self.finish(&solved.border, solved.border_covariance, increment, chi2, free)?, solved.partition))
    }
}
