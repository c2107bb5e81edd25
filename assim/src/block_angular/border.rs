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

pub(super) struct Border {
    pub estimate: Vec<f64>,
    pub covariance: Mat<f64>,
    pub residual_chi2: f64,
}

pub(super) fn solve(blocks: &[Eliminated], p: usize, prior: Option<&Prior>) -> Result<Border, Error> {
    match prior {
        Some(prior) => with_prior(blocks, p, prior),
        None => without_prior(blocks, p),
    }
}

/// A prior bounds the condition of the information matrix: L⁻¹ of V_0 = L L' whitens c, and I + Σ E'E is factored.
fn with_prior(blocks: &[Eliminated], p: usize, prior: &Prior) -> Result<Border, Error> {
    assert!(prior.mean.len() == p && prior.covariance.nrows() == p);
    let v_root = cholesky(prior.covariance.clone(), || "the prior covariance V_0 of the border".into())?;
    // In ξ = L⁻¹ (c − y_0) the rows are E L and d − E y_0. Their Gram matrices are summed in the order of the blocks.
    let grams: Vec<Mat<f64>> = blocks
        .par_iter()
        .map(|block| {
            let (e, d) = (block.border_rows.as_ref().get(.., ..p), block.border_rows.as_ref().get(.., p..));
            let whitened = product(e, v_root.as_ref());
            let shift = product(e, column(&prior.mean).as_ref());
            let rows =
                Mat::from_fn(e.nrows(), p + 1, |i, j| if j < p { whitened[(i, j)] } else { d[(i, 0)] - shift[(i, 0)] });
            let mut gram = Mat::zeros(p + 1, p + 1);
            add_symmetric_product(gram.as_mut(), 1.0, rows.transpose(), rows.as_ref());
            gram
        })
        .collect();
    let mut gram = Mat::zeros(p + 1, p + 1);
    for block in &grams {
        gram += block;
    }
    let mut information = gram.as_ref().get(..p, ..p).to_owned();
    for i in 0..p {
        information[(i, i)] += 1.0;
    }
    let root = cholesky(information, || "the information matrix of the border".into())?;
    let mut whitened_right = gram.as_ref().get(..p, p..).to_owned();
    solve_lower(root.as_ref(), whitened_right.as_mut());
    let residual_chi2 = gram[(p, p)] - squared_norm(whitened_right.col_as_slice(0));
    // ξ̂ = root⁻ᵀ (root⁻¹ right); Cov(ĉ) = (L root⁻ᵀ)(L root⁻ᵀ)'.
    let mut spread = v_root.transpose().to_owned();
    solve_lower(root.as_ref(), spread.as_mut());
    let correction = product(spread.transpose(), whitened_right.as_ref());
    let mut covariance = Mat::zeros(p, p);
    add_symmetric_product(covariance.as_mut(), 1.0, spread.transpose(), spread.as_ref());
    let estimate = (0..p).map(|i| prior.mean[i] + correction[(i, 0)]).collect();
    Ok(Border { estimate, covariance, residual_chi2 })
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
