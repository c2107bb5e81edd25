//! The border unknowns c, from the rows that the blocks leave.

use super::block::{Eliminated, numerical_rank};
use crate::error::Error;
use crate::linalg::{
    add_symmetric_product, cholesky, column, inverse_from_cholesky, product, qr, solve_lower, squared_norm,
};
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// The prior rows y_0 = c + e_0.
#[derive(Clone, Debug)]
pub struct Prior {
    /// y_0, `[p]`.
    pub mean: Vec<f64>,
    /// V_0 = Cov(e_0), `[p, p]`, symmetric positive definite.
    pub covariance: Mat<f64>,
}

pub(crate) struct Border {
    pub estimate: Vec<f64>,
    pub covariance: Mat<f64>,
    pub residual_chi2: f64,
}

pub(super) fn solve(blocks: &[Eliminated], p: usize, prior: Option<&Prior>) -> Result<Border, Error> {
    let Some(prior) = prior else { return without_prior(blocks, p) };
    assert_eq!(prior.mean.len(), p);
    let mut information = Information::new(prior)?;
    information.add(blocks.iter());
    information.solve()
}

/// Blocks whose information one thread sums at a time.
const BLOCKS: usize = 64;

/// What the blocks added so far and the prior say about the border.
///
/// A prior bounds the condition of the information matrix: L⁻¹ of V_0 = L L' whitens c, and I + Σ E'E is factored.
pub(crate) struct Information<'a> {
    prior: &'a Prior,
    /// L.
    prior_root: Mat<f64>,
    /// Gram matrix of the rows \[E L, d − E y_0\] in ξ = L⁻¹ (c − y_0).
    gram: Mat<f64>,
}

impl<'a> Information<'a> {
    /// That of the prior alone.
    pub fn new(prior: &'a Prior) -> Result<Self, Error> {
        let p = prior.mean.len();
        assert_eq!(prior.covariance.nrows(), p);
        let prior_root = cholesky(prior.covariance.clone(), || "the prior covariance V_0 of the border".into())?;
        Ok(Self { prior, prior_root, gram: Mat::zeros(p + 1, p + 1) })
    }

    /// Adds that of the blocks, summed in their order.
    pub fn add<'b>(&mut self, blocks: impl Iterator<Item = &'b Eliminated>) {
        let blocks: Vec<&Eliminated> = blocks.collect();
        let grams: Vec<Mat<f64>> = blocks.par_chunks(BLOCKS).map(|blocks| self.gram_of(blocks)).collect();
        for gram in &grams {
            self.gram += gram;
        }
    }

    fn gram_of(&self, blocks: &[&Eliminated]) -> Mat<f64> {
        let p = self.prior.mean.len();
        let mut stacked = Mat::zeros(blocks.iter().map(|block| block.border_rows.nrows()).sum(), p + 1);
        let mut first = 0;
        for block in blocks {
            let rows = block.border_rows.nrows();
            stacked.as_mut().get_mut(first..first + rows, ..).copy_from(&block.border_rows);
            first += rows;
        }
        let e = stacked.as_ref().get(.., ..p);
        let (whitened, shift) = (product(e, self.prior_root.as_ref()), product(e, column(&self.prior.mean).as_ref()));
        stacked.as_mut().get_mut(.., ..p).copy_from(whitened);
        let mut d = stacked.as_mut().get_mut(.., p..);
        d -= shift;
        let mut gram = Mat::zeros(p + 1, p + 1);
        add_symmetric_product(gram.as_mut(), 1.0, stacked.transpose(), stacked.as_ref());
        gram
    }

    /// ĉ and S.
    pub fn solve(self) -> Result<Border, Error> {
        let Self { prior, prior_root, gram } = self;
        let p = prior.mean.len();
        let mut information = gram.as_ref().get(..p, ..p).to_owned();
        for i in 0..p {
            information[(i, i)] += 1.0;
        }
        let root = cholesky(information, || "the information matrix of the border".into())?;
        let mut whitened_right = gram.as_ref().get(..p, p..).to_owned();
        solve_lower(root.as_ref(), whitened_right.as_mut());
        let residual_chi2 = gram[(p, p)] - squared_norm(whitened_right.col_as_slice(0));
        // ξ̂ = root⁻ᵀ (root⁻¹ right); Cov(ĉ) = (L root⁻ᵀ)(L root⁻ᵀ)'.
        let mut spread = prior_root.transpose().to_owned();
        solve_lower(root.as_ref(), spread.as_mut());
        let correction = product(spread.transpose(), whitened_right.as_ref());
        let mut covariance = Mat::zeros(p, p);
        add_symmetric_product(covariance.as_mut(), 1.0, spread.transpose(), spread.as_ref());
        let estimate = (0..p).map(|i| prior.mean[i] + correction[(i, 0)]).collect();
        Ok(Border { estimate, covariance, residual_chi2 })
    }
}

/// Without a prior the data alone carry the solution: an ordered chain of QR factorisations of the stacked rows.
fn without_prior(blocks: &[Eliminated], p: usize) -> Result<Border, Error> {
    let mut triangle: Mat<f64> = Mat::zeros(0, p + 1);
    for block in blocks {
        let stacked = stack_rows(triangle.as_ref(), block.border_rows.as_ref());
        triangle = qr(stacked.as_ref()).thin_R().to_owned();
    }
    let rank = if triangle.nrows() < p { triangle.nrows() } else { numerical_rank(triangle.as_ref().get(..p, ..p)) };
    if rank < p {
        return Err(Error::RankDeficient { what: "the border".into(), rank, size: p });
    }
    let r = triangle.as_ref().get(..p, ..p);
    let mut estimate = triangle.as_ref().get(..p, p..).to_owned();
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(r, estimate.as_mut(), faer::Par::Seq);
    let residual_chi2 = if triangle.nrows() > p { triangle[(p, p)].powi(2) } else { 0.0 };
    Ok(Border {
        estimate: estimate.col_as_slice(0).to_vec(),
        covariance: inverse_from_cholesky(r.transpose()),
        residual_chi2,
    })
}

/// \[A; B\].
fn stack_rows(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let top = a.nrows();
    Mat::from_fn(top + b.nrows(), b.ncols(), |i, j| if i < top { a[(i, j)] } else { b[(i - top, j)] })
}
