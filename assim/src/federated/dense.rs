//! The federated filter of dense Kalman filters.

use super::{FederatedKalmanFilter, FederatedSettings, Filters, Fusible, Part, biases_of_systems, filters};
use crate::augmented::Augmented;
use crate::error::Error;
use crate::errors::dense::{Dense, KalmanFilter};
use crate::innovation_covariance::InnovationCovariance;
use crate::linalg::{add_symmetric_product, cholesky, column, product, solve_lower, with_nugget};
use crate::problem::{Innovations, Problem};
use crate::propagator::Propagator;
use faer::{Mat, MatRef};
use isobar_model::vector::{add, difference};
use isobar_model::{Model, TangentLinear};

impl FederatedKalmanFilter {
    /// A filter that starts from the background.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the dense matrices do not fit into the memory limit; [`Error::Setting`] for a bias of no
    /// system, for biases of two systems whose priors are correlated, and for shares that do not sum to 1.
    pub fn new(problem: impl Into<Problem<dyn TangentLinear>>, settings: FederatedSettings) -> Result<Self, Error> {
        let problem = problem.into();
        settings.check()?;
        let FederatedSettings { systems, reset_every_cycles } = settings;
        let sizes = biases_of_systems(&problem.calibration, &systems)?;
        check_memory(&problem.clone().into(), sizes.iter().map(Vec::len), problem.most_observations)?;
        let build = |Part { problem, factor }| KalmanFilter::with_inflated_errors(problem, factor, false);
        Ok(Self::of(filters(&problem, &systems, build)?, reset_every_cycles))
    }

    /// The fused covariance of the errors of (x, c), `[m + p, m + p]`.
    pub fn covariance(&self) -> MatRef<'_, f64> {
        self.filters.master.covariance()
    }
}

impl Fusible for Dense {
    fn fuse(filters: &mut Filters<Self>) -> Result<(), Error> {
        let Filters { master, local } = filters;
        let m = master.belief.s.state.values().len();
        let (first, rest) = local.split_first().expect("there is a system at least");
        let mut fused = Fused::from(&first.filter);
        for local in rest {
            fused.fuse(&local.filter)?;
        }
        // The biases stand there system after system.
        let order: Vec<usize> = match master.covariance().nrows() - m {
            0 => (0..m).collect(),
            _ => (0..m).chain(local.iter().flat_map(|it| &it.parameters).map(|number| m + number)).collect(),
        };
        fused.store(&order, master);
        Ok(())
    }

    fn divide(filters: &mut Filters<Self>) -> Result<(), Error> {
        let given_state = explained_by_state(&filters.master)?;
        for local in &mut filters.local {
            let biases: &[usize] = if given_state.nrows() == 0 { &[] } else { &local.parameters };
            divide(&filters.master, given_state.as_ref(), local.share, biases, &mut local.filter);
        }
        Ok(())
    }

    fn normalised_square(master: &KalmanFilter, innovations: &Innovations) -> Result<f64, Error> {
        let covariance = InnovationCovariance::new(master.covariance(), innovations)?;
        Ok(covariance.normalised_square(&innovations.departures))
    }

    fn require_memory_of(filters: &Filters<Self>, observations: usize) -> Result<(), Error> {
        let sizes = filters.local.iter().map(|local| local.parameters.len());
        check_memory(&filters.master.problem, sizes, observations)
    }
}

/// An estimate of x and of the biases of some systems, (x, c_1, …, c_k).
struct Fused {
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
    fn fuse(&mut self, other: &KalmanFilter) -> Result<(), Error> {
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
    fn store(self, order: &[usize], to: &mut KalmanFilter) {
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
fn explained_by_state(master: &KalmanFilter) -> Result<Mat<f64>, Error> {
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
fn divide(master: &KalmanFilter, explained: MatRef<'_, f64>, share: f64, biases: &[usize], local: &mut KalmanFilter) {
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
    with_nugget(factor).map(|(_, root)| root)
}

/// `parameters` are the numbers of biases of the systems.
fn check_memory(
    problem: &Problem<dyn Model>,
    parameters: impl ExactSizeIterator<Item = usize>,
    observations: usize,
) -> Result<(), Error> {
    let m = problem.background.values().len();
    let (systems, n) = (parameters.len(), observations as f64);
    let of_filter = |size: f64| 2.0 * size * size + Propagator::numbers(size);
    let filters: f64 = parameters.map(|own| of_filter((m + own) as f64)).sum();
    let master = (m + problem.calibration.len()) as f64;
    // Covariance, model error, propagator and twice a band for each, the master and what it fuses; for the innovations those
    // of the master and those of all local filters.
    let numbers = filters + 5.0 * master * master + 4.0 * master * n + 2.0 * n * n;
    problem.require_memory(numbers, || {
        format!("{systems} dense Kalman filters for {m} values each and {observations} observations, and their fusion")
    })
}
