//! Compression of the common factors, which preserves every block's own covariance.

use super::blocks::Blocks;
use super::factored_covariance::FactoredCovariance;
use super::forecast::add_block_diagonal;
use crate::covariance::principal_rotation;
use crate::linalg::{product, qr};
use faer::{Mat, MatRef};

/// What joins the factors in a forecast.
pub(super) struct Joining<'a> {
    /// Factors of the model error, `[state values, q]`.
    pub model_error: MatRef<'a, f64>,
    /// Standard deviations of what the shared parameters' random walks add, `[p]`.
    pub drift: &'a [f64],
}

/// Adds factors, and returns to `rank` of them beside the p that carry the shared parameters.
///
/// `[Φ_b F_Q 0; Φ_c 0 diag(drift)]` is rotated so that p columns carry Φ_c exactly. Of the others the leading
/// directions stay, where every variable is divided by its scale first (else the wind would be thrown away for the
/// height); the block diagonal of what goes joins the patches, so that Cov(b_k) of each block is what it was.
pub(super) fn join_and_compress(
    covariance: &mut FactoredCovariance,
    joining: &Joining<'_>,
    rank: usize,
    scales: &[f64],
    blocks: &Blocks,
) {
    let (b, p) = (covariance.block_factors.nrows(), joining.drift.len());
    let (r, m, q) = (covariance.block_factors.ncols(), joining.model_error.nrows(), joining.model_error.ncols());
    let walks = if joining.drift.iter().any(|&sigma| sigma > 0.0) { p } else { 0 };
    if q + walks == 0 && r <= p + rank {
        return;
    }
    let mut wide = Mat::zeros(b, r + q);
    wide.as_mut().get_mut(.., ..r).copy_from(&covariance.block_factors);
    wide.as_mut().get_mut(..m, r..).copy_from(joining.model_error);
    let shared = Mat::from_fn(r + q + walks, p, |i, j| {
        if i < r {
            covariance.shared_factors[(j, i)]
        } else if i >= r + q && i - r - q == j {
            joining.drift[j]
        } else {
            0.0
        }
    });
    // Without shared parameters there is nothing to rotate for.
    let (rotated, carried) = match p {
        0 => (wide, Mat::zeros(0, 0)),
        _ => {
            let qr = qr(shared.as_ref());
            // The columns of the walks have no part in b: only the first r + q rows of the rotation count.
            let rotation = qr.compute_Q();
            (product(wide.as_ref(), rotation.as_ref().get(..r + q, ..)), qr.thin_R().transpose().to_owned())
        }
    };
    let rest = rotated.as_ref().get(.., p..);
    let kept = rank.min(rest.ncols());
    let (kept, dropped) = if rest.ncols() > rank {
        let scaled = Mat::from_fn(b, rest.ncols(), |i, j| rest[(i, j)] / scales[i]);
        let rotation = principal_rotation(scaled.as_ref());
        let split = |range| product(rest, rotation.as_ref().get(.., range));
        (split(0..kept), split(kept..rest.ncols()))
    } else {
        (rest.to_owned(), Mat::zeros(b, 0))
    };
    add_block_diagonal(&mut covariance.patches, dropped.as_ref(), blocks);
    let mut factors = Mat::zeros(b, p + kept.ncols());
    factors.as_mut().get_mut(.., ..p).copy_from(rotated.as_ref().get(.., ..p));
    factors.as_mut().get_mut(.., p..).copy_from(&kept);
    covariance.shared_factors = Mat::zeros(p, p + kept.ncols());
    covariance.shared_factors.as_mut().get_mut(.., ..p).copy_from(&carried);
    covariance.block_factors = factors;
}
