//! A sparse regression whose block-angular form is found automatically (Weil and Kettler 1971), and is nested.
//!
//! Rows y = X b + G c + e with few entries of X in each and independent errors; all may depend on the border c. The
//! graph of unknowns that rows link is dissected: parts up to a size limit, and separators between them, which border
//! the parts below them as c borders everything. Estimates and covariance are exact.

use super::block::Eliminated;
use super::border::{self, Prior};
use super::dissection::Dissection;
use super::front::{Front, Plan};
use super::graph::Graph;
use super::sparse_regression::SparseRegression;
use crate::error::Error;
use crate::linalg::{add_product, column, product};
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Sizes of the partition found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PartitionSizes {
    /// Parts that are linked only through separators and c.
    pub parts: usize,
    /// Unknowns of the largest part.
    pub largest_part: usize,
    /// Separators.
    pub separators: usize,
    /// Unknowns of all separators together.
    pub separator_unknowns: usize,
    /// Unknowns of the largest separator.
    pub largest_separator: usize,
    /// Unknowns c.
    pub border: usize,
}

/// The estimates, and their covariance in the form N⁻¹ + D S Dᵀ, with N that of b given c.
pub struct SparseSolution {
    /// b̂, `[unknowns]`.
    pub estimate: Vec<f64>,
    /// D = −∂b̂ / ∂c, `[unknowns, p]`: Cov(b̂, ĉ) = −D S.
    pub sensitivity: Mat<f64>,
    /// ĉ, `[p]`.
    pub border: Vec<f64>,
    /// S = Cov(ĉ), `[p, p]`.
    pub border_covariance: Mat<f64>,
    /// Sum of squares of the whitened residuals, of the prior's included.
    pub residual_chi2: f64,
    /// Into what the system fell.
    pub partition: PartitionSizes,
    roots: Vec<Front>,
}

/// Solves a sparse system by nested dissection into parts of at most `largest_part` unknowns; the same bits on any
/// number of threads.
///
/// # Errors
/// [`Error::RankDeficient`] names a part, a separator or a border that the rows do not determine.
///
/// # Panics
/// If the parts of the system do not fit each other.
pub fn solve_sparse(
    system: &SparseRegression<'_>,
    prior: Option<&Prior>,
    largest_part: usize,
) -> Result<SparseSolution, Error> {
    let (n, p) = (system.x.rows(), system.g.ncols());
    assert!(system.g.nrows() == n && system.y.len() == n && system.variance.len() == n);
    let touched: Vec<Vec<usize>> = (0..n).map(|row| system.x.row(row).iter().map(|entry| entry.0).collect()).collect();
    let graph = Graph::of_rows(vec![1; system.unknowns], touched.iter().map(Vec::as_slice));
    let tree = Dissection::new(&graph, largest_part);
    let plan = plan(system, &tree, &touched);
    let roots: Vec<usize> = (0..tree.members.len()).filter(|&member| tree.members[member].parent.is_none()).collect();
    let eliminated: Vec<(Front, Mat<f64>)> =
        roots.par_iter().map(|&root| plan.eliminate(root)).collect::<Result<_, _>>()?;
    let (roots, mut left): (Vec<Front>, Vec<Mat<f64>>) = eliminated.into_iter().unzip();
    left.push(rows_of_the_border_alone(system, &touched));
    let left: Vec<Eliminated> = left.into_iter().map(Eliminated::rows_alone).collect();
    let border = border::solve(&left, p, prior)?;
    let mut estimate = vec![0.0; system.unknowns];
    let mut sensitivity = Mat::zeros(system.unknowns, p);
    for root in &roots {
        root.estimate(&border.estimate, &mut estimate);
        root.sensitivity(&mut sensitivity);
    }
    Ok(SparseSolution {
        estimate,
        sensitivity,
        border: border.estimate,
        border_covariance: border.covariance,
        residual_chi2: border.residual_chi2,
        partition: sizes(&tree, p),
        roots,
    })
}

/// Each row goes to the lowest of the members it touches: all of them are above each other.
fn plan<'a>(system: &'a SparseRegression<'a>, tree: &'a Dissection, touched: &[Vec<usize>]) -> Plan<'a> {
    let member_of = tree.member_of(system.unknowns);
    let mut rows = vec![Vec::new(); tree.members.len()];
    for (row, unknowns) in touched.iter().enumerate() {
        if let Some(lowest) = unknowns.iter().map(|&unknown| member_of[unknown]).min() {
            rows[lowest].push(row);
        }
    }
    let mut children = vec![Vec::new(); tree.members.len()];
    for (number, member) in tree.members.iter().enumerate() {
        if let Some(parent) = member.parent {
            children[parent].push(number);
        }
    }
    Plan { system, tree, rows, children }
}

/// Whitened rows \[G y\] that touch no unknown but c.
fn rows_of_the_border_alone(system: &SparseRegression<'_>, touched: &[Vec<usize>]) -> Mat<f64> {
    let rows: Vec<usize> = (0..touched.len()).filter(|&row| touched[row].is_empty()).collect();
    let p = system.g.ncols();
    Mat::from_fn(rows.len(), p + 1, |i, j| {
        let value = if j < p { system.g[(rows[i], j)] } else { system.y[rows[i]] };
        value / system.variance[rows[i]].sqrt()
    })
}

fn sizes(tree: &Dissection, border: usize) -> PartitionSizes {
    let mut sizes = PartitionSizes { border, ..PartitionSizes::default() };
    for member in &tree.members {
        let size = member.nodes.len();
        if member.separator {
            sizes.separators += 1;
            sizes.separator_unknowns += size;
            sizes.largest_separator = sizes.largest_separator.max(size);
        } else {
            sizes.parts += 1;
            sizes.largest_part = sizes.largest_part.max(size);
        }
    }
    sizes
}

impl SparseSolution {
    /// The covariances, given c, of the unknowns of each group among each other.
    ///
    /// With D and S they make the covariance of a group: C + D S Dᵀ, in its rows of D.
    ///
    /// # Panics
    /// If the unknowns of a group are not all touched by one row.
    pub fn conditional_covariances(&self, groups: &[Vec<usize>]) -> Vec<Mat<f64>> {
        let mut groups_of = vec![Vec::new(); self.estimate.len()];
        for (number, group) in groups.iter().enumerate() {
            group.iter().for_each(|&unknown| groups_of[unknown].push(number));
        }
        let found: Vec<OnceLock<Mat<f64>>> = groups.iter().map(|_| OnceLock::new()).collect();
        let take = |front: &Front, joint: MatRef<'_, f64>| {
            // What one row touches is in members above each other: only the front of the lowest holds all of it.
            for &number in front.own.iter().flat_map(|&unknown| &groups_of[unknown]) {
                let positions: Option<Vec<usize>> = groups[number].iter().map(|&it| front.position(it)).collect();
                if let (Some(positions), None) = (positions, found[number].get()) {
                    let own = |i: usize, j: usize| joint[(positions[i], positions[j])];
                    found[number].get_or_init(|| Mat::from_fn(positions.len(), positions.len(), own));
                }
            }
        };
        self.roots.par_iter().for_each(|root| root.conditional_covariances(Mat::zeros(0, 0).as_ref(), &take));
        let complete = |(slot, group): (OnceLock<Mat<f64>>, &Vec<usize>)| match slot.into_inner() {
            Some(covariance) => covariance,
            None => {
                assert!(group.is_empty(), "no row touches all of a group");
                Mat::new()
            }
        };
        found.into_iter().zip(groups).map(complete).collect()
    }

    /// The variances of all unknowns b.
    pub fn variances(&self) -> Vec<f64> {
        let singles: Vec<Vec<usize>> = (0..self.estimate.len()).map(|unknown| vec![unknown]).collect();
        let conditional = self.conditional_covariances(&singles);
        let spread = product(self.sensitivity.as_ref(), self.border_covariance.as_ref());
        let through_border =
            |i: usize| -> f64 { (0..self.border.len()).map(|j| spread[(i, j)] * self.sensitivity[(i, j)]).sum() };
        conditional.iter().enumerate().map(|(i, own)| own[(0, 0)] + through_border(i)).collect()
    }

    /// The covariances, given c, of all unknowns b with unknown `number` of b: a column of N⁻¹.
    ///
    /// # Panics
    /// If there is no such unknown.
    pub fn conditional_column(&self, number: usize) -> Vec<f64> {
        let mut unit = vec![0.0; self.estimate.len()];
        unit[number] = 1.0;
        for root in &self.roots {
            root.reduce(&mut unit);
            root.substitute(&mut unit);
        }
        unit
    }

    /// The covariances of all unknowns (b, c) with unknown `number` of b: a column of the matrix, which is never formed.
    ///
    /// # Panics
    /// If there is no such unknown.
    pub fn covariance_column(&self, number: usize) -> Vec<f64> {
        let conditional = self.conditional_column(number);
        let own: Vec<f64> = (0..self.border.len()).map(|j| self.sensitivity[(number, j)]).collect();
        let with_border = product(self.border_covariance.as_ref(), column(&own).as_ref());
        let mut result = column(&conditional);
        add_product(result.as_mut(), 1.0, self.sensitivity.as_ref(), with_border.as_ref());
        let with_border = with_border.col_as_slice(0).iter().map(|value| -value);
        result.col_as_slice(0).iter().copied().chain(with_border).collect()
    }
}
