//! The rows of a sparse regression.

use faer::MatRef;
use isobar_obs::SparseRows;

/// y = X b + G c + e, Cov(e) = diag(V).
#[derive(Clone, Copy, Debug)]
pub struct SparseRegression<'a> {
    /// Number of unknowns b.
    pub unknowns: usize,
    /// X, `[n, unknowns]`; \[X G\] has full column rank, or X has if there are prior rows for c.
    pub x: &'a SparseRows,
    /// G, `[n, p]`.
    pub g: MatRef<'a, f64>,
    /// y, `[n]`.
    pub y: &'a [f64],
    /// The diagonal of V, `[n]`, all positive.
    pub variance: &'a [f64],
}
