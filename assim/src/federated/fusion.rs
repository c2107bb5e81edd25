//! The fusion of estimates of one state with different biases, and its division.

use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::dense::KalmanFilter;
use crate::linalg::{add_symmetric_product, cholesky, column, product, solve_lower};
use faer::{Mat, MatRef};
use isobar_model::vector::{add, difference};

/// What is added to each variance before it is factored, as a share of it: the first with which there is a factor.
/// Covariances such as a balanced B have no full rank; in directions in which both estimates have less than this share of the
/// variances nothing is to be gained.
const NUGGETS: [f64; 4] = [1e-11, 1e-9, 1e-7, 1e-5];

/// An estimate of x and of the biases of some systems, (x, c_1, …, c_k).
pub(super) struct Fused {
    /// m.
    values: usize,
    /// `[m + p]`.
    estimate: Vec<f64>,
    /// `[m + p, m + p]`.
    covariance: Mat<f64>,
}

impl From<&KalmanFilter> for Fused {
    fn from(local: &KalmanFilter) -> Self {
        let Augmented { state, bias } = &local.belief.s;
        let estimate = state.values().iter().chain(bias).copied().collect();
        Self { values: state.values().len(), estimate, covariance: local.covariance().to_owned() }
    }
}

impl Fused {
    /// Takes in an estimate (x', c') of the same x, with other biases and independent errors. That both states are one is
    /// an observation x' − x = 0 without error, so that with S = P_xx + P'_xx = L Lᵀ and W = L⁻¹ [P_x·, −P'_xc]
    ///
    /// ```text
    /// (x, c, c') ← (x, c, c') + Wᵀ L⁻¹ (x' − x),    Cov ← diag(P, P'_cc) − Wᵀ W,
    /// ```
    ///
    /// which is the sum of the information P⁻¹ + P'⁻¹ in the state, without an inverse of either.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if S has lost its meaning.
    pub fn fuse(&mut self, other: &KalmanFilter) -> Result<(), Error> {
        let (m, known) = (self.values, self.covariance.nrows());
        let size = known + other.covariance().nrows() - m;
        let (p, q) = (self.covariance.as_ref(), other.covariance());
        let sum = Mat::from_fn(m, m, |i, j| p[(i, j)] + q[(i, j)]);
        let root = semidefinite_cholesky(sum.as_ref(), "the sum of two fused covariances")?;
        let mut w = Mat::zeros(m, size);
        w.as_mut().get_mut(.., ..known).copy_from(p.get(..m, ..));
        w.as_mut().get_mut(.., known..).copy_from(-q.get(..m, m..));
        solve_lower(root.as_ref(), w.as_mut());
        let mut differences = column(&difference(other.belief.s.state.values(), &self.estimate[..m]));
        solve_lower(root.as_ref(), differences.as_mut());
        let mut covariance = Mat::zeros(size, size);
        covariance.as_mut().get_mut(..known, ..known).copy_from(p);
        covariance.as_mut().get_mut(known.., known..).copy_from(q.get(m.., m..));
        add_symmetric_product(covariance.as_mut(), -1.0, w.transpose(), w.as_ref());
        self.covariance = covariance;
        self.estimate.extend_from_slice(&other.belief.s.bias[..size - known]);
        let increment = product(w.transpose(), differences.as_ref());
        add(&mut self.estimate[..size], increment.col_as_slice(0));
        Ok(())
    }

    /// Writes the estimate to where its values belong: number i to number `order[i]`.
    pub fn store(self, order: &[usize], to: &mut KalmanFilter) {
        let (m, Augmented { state, bias }) = (self.values, &mut to.belief.s);
        state.values_mut().copy_from_slice(&self.estimate[..m]);
        for (&number, &value) in order[m..].iter().zip(&self.estimate[m..]) {
            bias[number - m] = value;
        }
        for (j, &to_column) in order.iter().enumerate() {
            let from = self.covariance.col_as_slice(j);
            let column = to.covariance_mut().col_as_slice_mut(to_column);
            order.iter().zip(from).for_each(|(&row, &value)| column[row] = value);
        }
    }
}

/// P_cx P_xx⁻¹ P_xc, the part of the biases' covariance that goes with the state, `[p, p]`.
///
/// # Errors
/// [`Error::NotPositiveDefinite`] if P has lost its meaning.
pub(super) fn explained_by_state(master: &KalmanFilter) -> Result<Mat<f64>, Error> {
    let (m, size) = (master.belief.s.state.values().len(), master.covariance().nrows());
    if size == m {
        return Ok(Mat::zeros(0, 0));
    }
    let states = master.covariance().get(..m, ..m);
    let root = semidefinite_cholesky(states, "the fused covariance of the state")?;
    let mut w = master.covariance().get(..m, m..).to_owned();
    solve_lower(root.as_ref(), w.as_mut());
    Ok(product(w.transpose(), w.as_ref()))
}

/// Gives a local filter its share β of the fused information on x, and all of that on its biases given x:
///
/// ```text
/// P_xx/β,    P_xc/β,    P_cc + (1/β − 1) P_cx P_xx⁻¹ P_xc.
/// ```
///
/// `biases` are the numbers of its biases among all.
pub(super) fn divide(
    master: &KalmanFilter,
    explained: MatRef<'_, f64>,
    share: f64,
    biases: &[usize],
    local: &mut KalmanFilter,
) {
    let (from, to) = (&master.belief.s, &mut local.belief.s);
    let m = from.state.values().len();
    to.state.values_mut().copy_from_slice(from.state.values());
    to.bias.iter_mut().zip(biases).for_each(|(value, &number)| *value = from.bias[number]);
    let number_of = |i: usize| if i < m { i } else { m + biases[i - m] };
    let (p, size) = (master.covariance(), local.covariance().nrows());
    *local.covariance_mut() = Mat::from_fn(size, size, |i, j| {
        let value = p[(number_of(i), number_of(j))];
        if i >= m && j >= m {
            value + (1.0 / share - 1.0) * explained[(biases[i - m], biases[j - m])]
        } else {
            value / share
        }
    });
}

/// The Cholesky factor of a covariance with a nugget; a value without any variance, such as that on a wall, is left alone by
/// any unit in its place.
fn semidefinite_cholesky(matrix: MatRef<'_, f64>, name: &str) -> Result<Mat<f64>, Error> {
    let factor = |nugget: f64| {
        let mut matrix = matrix.to_owned();
        for i in 0..matrix.nrows() {
            let variance = matrix[(i, i)];
            matrix[(i, i)] = if variance == 0.0 { 1.0 } else { variance * (1.0 + nugget) };
        }
        cholesky(matrix, || name.into())
    };
    let [least, larger @ ..] = NUGGETS;
    larger.into_iter().fold(factor(least), |found, nugget| found.or_else(|_| factor(nugget)))
}
