//! The analysis where even the separators of the blocks are too many for the border: nested elimination.
//!
//! With C_k = L_k L_k' + C_rest (see `separation`), the observations see the amplitudes w_k ~ N(0, I) of each block
//! b_k = L_k w_k + rest, and those ξ of the common factors. They and their prior rows are one sparse regression, which is
//! solved by nested dissection. Estimates are exact, and so is the covariance. What blocks get in common beyond the factors
//! is kept where the forecast is exact, which forms A C A' from it: P_k of (28) is A_k Cov(ŝ) A_k' + Q_k with the covariance of
//! all blocks. Any other forecast drops it, as it does with what merged blocks have in common.

use super::component::check_component;
use super::separators::{Seen, seen_positions};
use super::solution::{Solved, SplitRows};
use super::{BlockErrors, Residual};
use crate::block_angular::{
    Component, Eliminated, PartitionSizes, Prior, SparseRegression, SparseSolution, solve_sparse,
};
use crate::error::Error;
use crate::linalg::{add_product, column, product};
use crate::problem::Innovations;
use faer::Mat;
use isobar_obs::SparseRows;
use rayon::prelude::*;

/// Unknowns of a part of the nested elimination.
const LARGEST_PART: usize = 96;

impl BlockErrors {
    /// Analyses the innovations, which link the blocks into these components, where the first `free` columns of Φ are no
    /// factors; returns the sizes of the partition too.
    pub(super) fn update_nested(
        &mut self,
        components: &[Component],
        rows: &SplitRows,
        innovations: &Innovations,
        seen: &[bool],
        free: usize,
    ) -> Result<(Solved, PartitionSizes), Error> {
        let observed: Vec<usize> = (0..self.frame.blocks.count())
            .filter(|&block| !seen_positions(&self.frame.blocks, block, seen).is_empty())
            .collect();
        let split: Vec<Seen> = observed
            .par_iter()
            .map(|&block| {
                Seen::new(
                    self.memory.covariance.own.block(&self.frame.blocks, block),
                    &seen_positions(&self.frame.blocks, block, seen),
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
        if self.frame.settings.residual == Residual::Exact {
            // The covariance of all that observations link.
            for component in components {
                check_component(&self.frame.blocks, component, self.frame.memory_limit_bytes)?;
            }
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
        let parts = self.parts(components, &observed);
        let amplitudes_of =
            |part: &Vec<usize>| part.iter().flat_map(|&number| first[number]..first[number + 1]).collect();
        let groups: Vec<Vec<usize>> = parts.iter().map(amplitudes_of).collect();
        let covariances = covariances(&solved, &parts, &groups);
        let eliminated: Vec<(Vec<usize>, Eliminated)> = (parts.par_iter().zip(&groups).zip(covariances))
            .map(|((part, group), covariance)| {
                let of_blocks: Vec<(&[usize], &Seen)> =
                    part.iter().map(|&number| (self.frame.blocks.members(observed[number]), &split[number])).collect();
                let (variables, Seen { root, rest }) = joined(&of_blocks);
                let of_group = |i: usize, j: usize| solved.sensitivity[(group[i], j)];
                let sensitivity = Mat::from_fn(group.len(), r, of_group);
                let estimate = Mat::from_fn(group.len(), 1, |i, _| estimate[(group[i], 0)]);
                let spread = product(root.as_ref(), covariance.as_ref());
                let mut covariance = rest;
                add_product(covariance.as_mut(), 1.0, spread.as_ref(), root.transpose());
                let eliminated = Eliminated {
                    border_rows: Mat::new(),
                    estimate_without_border: product(root.as_ref(), estimate.as_ref()),
                    covariance,
                    sensitivity: product(root.as_ref(), sensitivity.as_ref()),
                };
                (variables, eliminated)
            })
            .collect();
        let components: Vec<Component> = parts
            .into_iter()
            .map(|part| part.into_iter().map(|number| observed[number]).collect())
            .map(|blocks| Component { blocks, observations: Vec::new() })
            .collect();
        let mut increment = vec![0.0; self.frame.blocks.variables()];
        self.memory.covariance.linked.clear();
        self.take_in(&components, eliminated, &mut increment);
        let chi2 = solved.residual_chi2;
        Ok((self.finish(&solved.border, solved.border_covariance, increment, chi2, free)?, solved.partition))
    }

    /// The observed blocks, by their numbers in `observed`, whose covariance among each other is wanted: those that
    /// observations link if the forecast is exact, which is the only one that has a use for it, else each alone.
    fn parts(&self, components: &[Component], observed: &[usize]) -> Vec<Vec<usize>> {
        if self.frame.settings.residual != Residual::Exact {
            return (0..observed.len()).map(|number| vec![number]).collect();
        }
        let numbers = |component: &Component| -> Vec<usize> {
            component.blocks.iter().filter_map(|block| observed.binary_search(block).ok()).collect()
        };
        components.iter().map(numbers).filter(|part| !part.is_empty()).collect()
    }
}

/// The covariances, given the border, of the amplitudes of each part, which are its group: those of one block from the fronts
/// that hold them, those of linked blocks column by column.
fn covariances(solved: &SparseSolution, parts: &[Vec<usize>], groups: &[Vec<usize>]) -> Vec<Mat<f64>> {
    let is_linked: Vec<bool> = parts.iter().map(|part| part.len() > 1).collect();
    let of_one = |(group, &linked): (&Vec<usize>, &bool)| if linked { Vec::new() } else { group.clone() };
    let alone: Vec<Vec<usize>> = groups.iter().zip(&is_linked).map(of_one).collect();
    let mut covariances = solved.conditional_covariances(&alone);
    for ((covariance, group), _) in covariances.iter_mut().zip(groups).zip(&is_linked).filter(|it| *it.1) {
        let columns: Vec<Vec<f64>> = group.par_iter().map(|&number| solved.conditional_column(number)).collect();
        *covariance = Mat::from_fn(group.len(), group.len(), |i, j| columns[j][group[i]]);
    }
    covariances
}

/// What is seen of several blocks as of one, and its variables, ascending; the amplitudes are those of the blocks one after
/// another.
fn joined(blocks: &[(&[usize], &Seen)]) -> (Vec<usize>, Seen) {
    let mut variables: Vec<usize> = blocks.iter().flat_map(|it| it.0).copied().collect();
    variables.sort_unstable();
    let (size, amplitudes) = (variables.len(), blocks.iter().map(|it| it.1.root.ncols()).sum());
    let mut joined = Seen { root: Mat::zeros(size, amplitudes), rest: Mat::zeros(size, size) };
    let mut first = 0;
    for (members, Seen { root, rest }) in blocks {
        let locate =
            |variable: &usize| variables.binary_search(variable).expect("they are the variables of the blocks");
        let rows: Vec<usize> = members.iter().map(locate).collect();
        for (i, &row) in rows.iter().enumerate() {
            (0..root.ncols()).for_each(|j| joined.root[(row, first + j)] = root[(i, j)]);
            rows.iter().enumerate().for_each(|(j, &column)| joined.rest[(row, column)] = rest[(i, j)]);
        }
        first += root.ncols();
    }
    (variables, joined)
}
