//! The rows of one block, and the elimination of its own unknowns.

use crate::error::Error;
use crate::linalg::{add_symmetric_product, cholesky, inverse_from_cholesky, product, qr, solve_lower};
use faer::{Mat, MatRef};

/// The rows of one block, in one of two equivalent forms.
#[derive(Clone, Debug)]
pub enum Block {
    /// Rows that determine b_k by themselves.
    Regression(RegressionRows),
    /// Observation rows and prior rows, in covariance form.
    Update(UpdateRows),
}

/// y = X b + G c + e, Cov(e) = V; X has full column rank.
#[derive(Clone, Debug)]
pub struct RegressionRows {
    /// X, `[n, m]`.
    pub x: Mat<f64>,
    /// G, `[n, p]`.
    pub g: Mat<f64>,
    /// y, `[n]`.
    pub y: Vec<f64>,
    /// V, `[n, n]`, symmetric positive definite.
    pub v: Mat<f64>,
}

/// d = H b + G c + e, Cov(e) = R, with the prior rows 0 = b + e_p, Cov(e_p) = P.
///
/// Equal to [`RegressionRows`] with X = \[H; I\], G = \[G; 0\], V = diag(R, P), but P may be singular: with
/// T = H P H' + R it is C = P − P H' T⁻¹ H P, R_k = T⁻¹ and D = P H' T⁻¹ G. The caller forms P H' and T, because only
/// it knows how sparse H is.
#[derive(Clone, Debug)]
pub struct UpdateRows {
    /// P, `[m, m]`.
    pub prior: Mat<f64>,
    /// P H', `[m, n]`.
    pub cross: Mat<f64>,
    /// T = H P H' + R, `[n, n]`, symmetric positive definite.
    pub innovation: Mat<f64>,
    /// G, `[n, p]`.
    pub g: Mat<f64>,
    /// d, `[n]`.
    pub d: Vec<f64>,
}

/// A block whose own unknowns are eliminated.
pub(crate) struct Eliminated {
    /// Whitened rows \[E d\] that are left for the border: E'E = G' R_k G, `[rows, p + 1]`.
    pub border_rows: Mat<f64>,
    /// b̂_k for c = 0, `[m, 1]`.
    pub estimate_without_border: Mat<f64>,
    /// C_k.
    pub covariance: Mat<f64>,
    /// D_k.
    pub sensitivity: Mat<f64>,
}

impl Eliminated {
    /// Rows \[E d\] for the border whose unknowns are elsewhere.
    pub(super) fn rows_alone(border_rows: Mat<f64>) -> Self {
        Self { border_rows, estimate_without_border: Mat::new(), covariance: Mat::new(), sensitivity: Mat::new() }
    }
}

impl Block {
    /// The rows without the block's own unknowns; `number` names the block in errors.
    pub(crate) fn eliminate(&self, number: usize, border_unknowns: usize) -> Result<Eliminated, Error> {
        match self {
            Block::Regression(rows) => rows.eliminate(number, border_unknowns),
            Block::Update(rows) => rows.eliminate(number, border_unknowns),
        }
    }
}

impl RegressionRows {
    /// Whitens with the Cholesky factor of V, then eliminates b by a QR factorisation of \[X G y\]: no normal equations.
    fn eliminate(&self, number: usize, p: usize) -> Result<Eliminated, Error> {
        let (n, m) = (self.x.nrows(), self.x.ncols());
        assert!(self.g.ncols() == p && self.g.nrows() == n && self.y.len() == n && self.v.nrows() == n);
        let v_root = cholesky(self.v.clone(), || format!("the error covariance V of block {number}"))?;
        let mut rows = stack_columns(self.x.as_ref(), self.g.as_ref(), &self.y);
        solve_lower(v_root.as_ref(), rows.as_mut());
        eliminate_whitened(rows.as_ref(), m, || format!("block {number}"))
    }
}

/// Eliminates the first `m` unknowns of the rows \[X G y\], whose errors are independent with unit variance.
pub(super) fn eliminate_whitened(
    rows: MatRef<'_, f64>,
    m: usize,
    name: impl Fn() -> String,
) -> Result<Eliminated, Error> {
    let p = rows.ncols() - m - 1;
    let r = qr(rows).thin_R().to_owned();
    let rank = if r.nrows() < m { r.nrows() } else { numerical_rank(r.as_ref().get(..m, ..m)) };
    if rank < m {
        return Err(Error::RankDeficient { what: name(), rank, size: m });
    }
    let r_x = r.as_ref().get(..m, ..m);
    let mut right = r.as_ref().get(..m, m..).to_owned();
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(r_x, right.as_mut(), faer::Par::Seq);
    Ok(Eliminated {
        border_rows: r.as_ref().get(m.., m..).to_owned(),
        estimate_without_border: right.as_ref().get(.., p..).to_owned(),
        covariance: inverse_from_cholesky(r_x.transpose()),
        sensitivity: right.as_ref().get(.., ..p).to_owned(),
    })
}

impl UpdateRows {
    fn eliminate(&self, number: usize, p: usize) -> Result<Eliminated, Error> {
        let (m, n) = (self.cross.nrows(), self.cross.ncols());
        assert!(self.prior.nrows() == m && self.innovation.nrows() == n);
        assert!(self.g.ncols() == p && self.g.nrows() == n && self.d.len() == n);
        let t_root =
            cholesky(self.innovation.clone(), || format!("the innovation covariance H P H' + R of block {number}"))?;
        let mut border_rows = stack_columns(self.g.as_ref(), Mat::zeros(n, 0).as_ref(), &self.d);
        solve_lower(t_root.as_ref(), border_rows.as_mut());
        let mut whitened = self.cross.transpose().to_owned();
        solve_lower(t_root.as_ref(), whitened.as_mut());
        let right = product(whitened.transpose(), border_rows.as_ref());
        let mut covariance = self.prior.clone();
        add_symmetric_product(covariance.as_mut(), -1.0, whitened.transpose(), whitened.as_ref());
        Ok(Eliminated {
            border_rows,
            estimate_without_border: right.as_ref().get(.., p..).to_owned(),
            covariance,
            sensitivity: right.as_ref().get(.., ..p).to_owned(),
        })
    }
}

/// \[A B y\].
fn stack_columns(a: MatRef<'_, f64>, b: MatRef<'_, f64>, y: &[f64]) -> Mat<f64> {
    let (left, middle) = (a.ncols(), a.ncols() + b.ncols());
    Mat::from_fn(y.len(), middle + 1, |i, j| {
        if j < left {
            a[(i, j)]
        } else if j < middle {
            b[(i, j - left)]
        } else {
            y[i]
        }
    })
}

/// Number of diagonal entries of a triangular factor that stand out of its rounding errors.
pub(super) fn numerical_rank(r: MatRef<'_, f64>) -> usize {
    let size = r.nrows().min(r.ncols());
    let largest = (0..size).map(|i| r[(i, i)].abs()).fold(0.0, f64::max);
    let threshold = largest * f64::EPSILON * 16.0 * size as f64;
    (0..size).filter(|&i| r[(i, i)].abs() > threshold).count()
}
