//! The elimination of the members of a dissection, from the leaves to the root.
//!
//! A member's rows touch its own unknowns b, those of some members above it, its boundary, and the border c. What the
//! elimination of b leaves, rows on boundary and c, joins the rows of the member above. So a member is a block whose
//! border is the boundary and c: the nested form of the block-angular regression.

use super::block::{Eliminated, eliminate_whitened};
use super::dissection::Dissection;
use super::sparse_regression::SparseRegression;
use crate::error::Error;
use crate::linalg::{add_product, product, qr};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, MatRef, Side};
use rayon::prelude::*;

/// A part with more unknowns than this, and few rows that link them, is factored as a sparse matrix.
const LARGE: usize = 192;

/// The largest share of entries of the normal matrix for which a sparse factorisation is the faster one.
const SPARSE: f64 = 0.15;

/// A member whose unknowns are eliminated, and those below it.
pub(super) struct Front {
    /// Its unknowns, ascending.
    pub own: Vec<usize>,
    /// Unknowns of members above it with which its rows are linked, ascending.
    pub boundary: Vec<usize>,
    /// C = Cov(b | boundary, c).
    pub covariance: Conditional,
    /// b̂ for boundary = 0 and c = 0.
    pub estimate: Mat<f64>,
    /// D = −∂b̂ / ∂(boundary, c), `[own, boundary + p]`.
    pub sensitivity: Mat<f64>,
    pub children: Vec<Front>,
}

/// The covariance of the unknowns of a front.
pub(super) enum Conditional {
    Dense(Mat<f64>),
    /// The Cholesky factors of its inverse.
    Inverse(Llt<usize, f64>),
}

impl Conditional {
    /// C B.
    pub fn multiply(&self, b: MatRef<'_, f64>) -> Mat<f64> {
        match self {
            Conditional::Dense(c) => product(c.as_ref(), b),
            Conditional::Inverse(factors) => sequential(|| factors.solve(b)),
        }
    }

    /// C.
    pub fn dense(&self, size: usize) -> Mat<f64> {
        match self {
            Conditional::Dense(c) => c.clone(),
            Conditional::Inverse(_) => self.multiply(Mat::identity(size, size).as_ref()),
        }
    }
}

/// faer would divide its work by the number of threads, and round accordingly.
fn sequential<T>(work: impl FnOnce() -> T) -> T {
    faer::set_global_parallelism(faer::Par::Seq);
    work()
}

/// The rows of a system by the member that is to eliminate them, and the tree downwards.
pub(super) struct Plan<'a> {
    pub system: &'a SparseRegression<'a>,
    pub tree: &'a Dissection,
    /// The rows of each member.
    pub rows: Vec<Vec<usize>>,
    /// The members below each.
    pub children: Vec<Vec<usize>>,
}

impl Plan<'_> {
    /// Eliminates a member and all below it; with it come the rows \[E d\] that are left, `[rows, boundary + p + 1]`.
    pub fn eliminate(&self, member: usize) -> Result<(Front, Mat<f64>), Error> {
        let below: Vec<(Front, Mat<f64>)> =
            self.children[member].par_iter().map(|&child| self.eliminate(child)).collect::<Result<_, _>>()?;
        let own = &self.tree.members[member].nodes;
        let rows = &self.rows[member];
        let touched = rows.iter().flat_map(|&row| self.system.x.row(row).iter().map(|entry| entry.0));
        let mut boundary: Vec<usize> =
            touched.chain(below.iter().flat_map(|(front, _)| front.boundary.clone())).collect();
        boundary.sort_unstable();
        boundary.dedup();
        boundary.retain(|unknown| own.binary_search(unknown).is_err());
        let name = || match (own.len(), self.tree.members[member].separator) {
            (size, true) => format!("a separator of {size} unknowns"),
            (size, false) => format!("a part of {size} unknowns"),
        };
        let sparse = if below.is_empty() { self.sparse_part(own, &boundary, rows) } else { None };
        let (eliminated, covariance) = match sparse {
            Some((eliminated, factors)) => (eliminated, Conditional::Inverse(factors)),
            None => {
                let mut eliminated =
                    eliminate_whitened(self.assemble(own, &boundary, rows, &below).as_ref(), own.len(), name)?;
                let covariance = std::mem::replace(&mut eliminated.covariance, Mat::new());
                (eliminated, Conditional::Dense(covariance))
            }
        };
        let children = below.into_iter().map(|(front, _)| front).collect();
        let front = Front {
            own: own.clone(),
            boundary,
            covariance,
            estimate: eliminated.estimate_without_border,
            sensitivity: eliminated.sensitivity,
            children,
        };
        Ok((front, eliminated.border_rows))
    }

    /// Whitened rows \[own, boundary, c, y\]: the member's, then what those below it left.
    fn assemble(&self, own: &[usize], boundary: &[usize], rows: &[usize], below: &[(Front, Mat<f64>)]) -> Mat<f64> {
        let (m, p) = (own.len(), self.system.g.ncols());
        let width = m + boundary.len() + p + 1;
        let position = |unknown: usize| match own.binary_search(&unknown) {
            Ok(position) => position,
            Err(_) => m + boundary.binary_search(&unknown).expect("what is touched is own or boundary"),
        };
        let height = rows.len() + below.iter().map(|(_, left)| left.nrows()).sum::<usize>();
        let mut stacked = Mat::zeros(height, width);
        for (i, &row) in rows.iter().enumerate() {
            let scale = self.system.variance[row].sqrt().recip();
            for &(unknown, value) in self.system.x.row(row) {
                stacked[(i, position(unknown))] += scale * value;
            }
            (0..p).for_each(|j| stacked[(i, width - 1 - p + j)] = scale * self.system.g[(row, j)]);
            stacked[(i, width - 1)] = scale * self.system.y[row];
        }
        let mut start = rows.len();
        for (front, left) in below {
            let columns = front.boundary.iter().map(|&unknown| position(unknown)).chain(width - 1 - p..width);
            for (source, target) in columns.enumerate() {
                let column = &mut stacked.col_as_slice_mut(target)[start..start + left.nrows()];
                column.copy_from_slice(left.col_as_slice(source));
            }
            start += left.nrows();
        }
        stacked
    }

    /// A large part with a sparse normal matrix N = X'X: C = N⁻¹ by its Cholesky factors. `None` for any other, and
    /// for one whose factorisation fails: the orthogonal elimination then finds out why.
    fn sparse_part(&self, own: &[usize], boundary: &[usize], rows: &[usize]) -> Option<(Eliminated, Llt<usize, f64>)> {
        let (m, p) = (own.len(), self.system.g.ncols());
        if m <= LARGE {
            return None;
        }
        // Columns of the rows' entries: own ones, then those of the boundary.
        let position = |unknown: usize| match own.binary_search(&unknown) {
            Ok(position) => position,
            Err(_) => m + boundary.binary_search(&unknown).expect("what is touched is own or boundary"),
        };
        let whitened = |row: usize| {
            let scale = self.system.variance[row].sqrt().recip();
            self.system.x.row(row).iter().map(move |&(unknown, value)| (position(unknown), scale * value))
        };
        let mut entries: Vec<Triplet<usize, usize, f64>> = Vec::new();
        let mut right = Mat::<f64>::zeros(rows.len(), boundary.len() + p + 1);
        for (i, &row) in rows.iter().enumerate() {
            let own_entries = || whitened(row).filter(|entry| entry.0 < m);
            for (column, a) in own_entries() {
                entries
                    .extend(own_entries().filter(|it| it.0 >= column).map(|(it, b)| Triplet::new(it, column, a * b)));
            }
            whitened(row).filter(|entry| entry.0 >= m).for_each(|(column, value)| right[(i, column - m)] += value);
            let scale = self.system.variance[row].sqrt().recip();
            (0..p).for_each(|j| right[(i, boundary.len() + j)] = scale * self.system.g[(row, j)]);
            right[(i, boundary.len() + p)] = scale * self.system.y[row];
        }
        let normal = SparseColMat::try_new_from_triplets(m, m, &entries).ok()?;
        if 2 * normal.compute_nnz() > (SPARSE * (m * m) as f64) as usize {
            return None;
        }
        let mut projected = Mat::zeros(m, right.ncols());
        for column in 0..right.ncols() {
            let (source, target) = (right.col_as_slice(column), projected.col_as_slice_mut(column));
            for (i, &row) in rows.iter().enumerate() {
                whitened(row).filter(|entry| entry.0 < m).for_each(|(it, value)| target[it] += value * source[i]);
            }
        }
        let symbolic = SymbolicLlt::try_new(normal.symbolic(), Side::Lower).ok()?;
        let factors = sequential(|| Llt::try_new_with_symbolic(symbolic, normal.as_ref(), Side::Lower)).ok()?;
        let solved = sequential(|| factors.solve(projected));
        // The residuals of [boundary, c, y] are the rows that are left; a triangle holds what matters of them.
        for column in 0..right.ncols() {
            let (source, target) = (solved.col_as_slice(column), right.col_as_slice_mut(column));
            for (i, &row) in rows.iter().enumerate() {
                target[i] -=
                    whitened(row).filter(|entry| entry.0 < m).map(|(it, value)| value * source[it]).sum::<f64>();
            }
        }
        let border_rows = if right.nrows() > right.ncols() { qr(right.as_ref()).thin_R().to_owned() } else { right };
        let width = boundary.len() + p;
        let eliminated = Eliminated {
            border_rows,
            estimate_without_border: solved.as_ref().get(.., width..).to_owned(),
            covariance: Mat::new(),
            sensitivity: solved.as_ref().get(.., ..width).to_owned(),
        };
        Some((eliminated, factors))
    }
}

impl Front {
    /// b̂ = b̂(0) − D \[boundary; c\] for all unknowns from here down.
    pub fn estimate(&self, border: &[f64], estimate: &mut [f64]) {
        let above = self.boundary.iter().map(|&unknown| estimate[unknown]).chain(border.iter().copied());
        let above: Vec<f64> = above.collect();
        let mut own = self.estimate.clone();
        add_product(own.as_mut(), -1.0, self.sensitivity.as_ref(), crate::linalg::column(&above).as_ref());
        self.own.iter().zip(own.col_as_slice(0)).for_each(|(&unknown, value)| estimate[unknown] = *value);
        self.children.iter().for_each(|child| child.estimate(border, estimate));
    }

    /// −∂b̂ / ∂c for all unknowns from here down, where the boundary follows c.
    pub fn sensitivity(&self, total: &mut Mat<f64>) {
        let (n, p) = (self.boundary.len(), total.ncols());
        let above = Mat::from_fn(n, p, |i, j| total[(self.boundary[i], j)]);
        let mut own = self.sensitivity.as_ref().get(.., n..).to_owned();
        add_product(own.as_mut(), -1.0, self.sensitivity.as_ref().get(.., ..n), above.as_ref());
        for column in 0..p {
            let (source, target) = (own.col_as_slice(column), total.col_as_slice_mut(column));
            self.own.iter().zip(source).for_each(|(&unknown, value)| target[unknown] = *value);
        }
        self.children.iter().for_each(|child| child.sensitivity(total));
    }

    /// Calls `take` with the unknowns of every front, own ones first, and their covariance given c.
    ///
    /// `above` is that of the boundary. With C the covariance of the own unknowns given boundary and c, and D the
    /// sensitivity to the boundary, it is \[C + D S D', −D S; −S D', S\].
    pub fn conditional_covariances(&self, above: MatRef<'_, f64>, take: &(impl Fn(&Front, MatRef<'_, f64>) + Sync)) {
        let (m, n) = (self.own.len(), self.boundary.len());
        let sensitivity = self.sensitivity.as_ref().get(.., ..n);
        let crossed = product(sensitivity, above);
        let mut joint = Mat::zeros(m + n, m + n);
        let mut own = self.covariance.dense(m);
        add_product(own.as_mut(), 1.0, crossed.as_ref(), sensitivity.transpose());
        joint.as_mut().get_mut(..m, ..m).copy_from(own);
        joint.as_mut().get_mut(m.., m..).copy_from(above);
        for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
            joint[(i, m + j)] = -crossed[(i, j)];
            joint[(m + j, i)] = -crossed[(i, j)];
        }
        take(self, joint.as_ref());
        self.children.par_iter().for_each(|child| {
            let positions: Vec<usize> = child.boundary.iter().filter_map(|&unknown| self.position(unknown)).collect();
            let above = Mat::from_fn(positions.len(), positions.len(), |i, j| joint[(positions[i], positions[j])]);
            child.conditional_covariances(above.as_ref(), take);
        });
    }

    /// Where an unknown stands among the own ones and the boundary, if it is one of them.
    pub fn position(&self, unknown: usize) -> Option<usize> {
        let above = || self.boundary.binary_search(&unknown).map(|position| self.own.len() + position);
        self.own.binary_search(&unknown).or_else(|_| above()).ok()
    }

    /// The first half of N z = right for c = 0, N being the information matrix: from the leaves up.
    pub fn reduce(&self, right: &mut [f64]) {
        self.children.iter().for_each(|child| child.reduce(right));
        for (column, &unknown) in self.boundary.iter().enumerate() {
            let sensitivity = self.sensitivity.col_as_slice(column);
            right[unknown] -= self.own.iter().zip(sensitivity).map(|(&own, value)| right[own] * value).sum::<f64>();
        }
    }

    /// The second half: from the root down.
    pub fn substitute(&self, right: &mut [f64]) {
        let own: Vec<f64> = self.own.iter().map(|&unknown| right[unknown]).collect();
        let mut solved = self.covariance.multiply(crate::linalg::column(&own).as_ref());
        let above: Vec<f64> = self.boundary.iter().map(|&unknown| right[unknown]).collect();
        let sensitivity = self.sensitivity.as_ref().get(.., ..self.boundary.len());
        add_product(solved.as_mut(), -1.0, sensitivity, crate::linalg::column(&above).as_ref());
        self.own.iter().zip(solved.col_as_slice(0)).for_each(|(&unknown, value)| right[unknown] = *value);
        self.children.iter().for_each(|child| child.substitute(right));
    }
}
