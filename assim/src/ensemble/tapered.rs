//! Innovations whose ensemble covariance is tapered in observation space.

use super::buckets::Buckets;
use super::localization::Taper;
use super::observed::ObservedEnsemble;
use super::transform::WhitenedObservations;
use crate::error::Error;
use crate::linalg::{add_product, column, product, row_major};
use crate::problem::Innovations;
use faer::linalg::cholesky::llt::factor;
use faer::linalg::solvers::{PartialPivLu, Solve};
use faer::sparse::linalg::LltError;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, MatRef, Par, Side};
use isobar_model::Grid;
use isobar_model::vector::{axpy, dot};
use rayon::prelude::*;

/// The innovations d̃ with their covariance I + L ∘ (Ỹ Ỹᵀ), whitened by R.
///
/// A shared bias belongs to no place, so distance says nothing of its correlation with a state's value. With the taper ρ
/// on the state and 1 on the biases, a constant κ between them keeps the taper `[ρ κ; κ 1]` positive semidefinite as long
/// as κ² is at most the mean of ρ over a homogeneous domain: what it lets through is the correlation with the mean over
/// the domain. That largest κ is used. So with Ỹ = Ỹ_x + Ỹ_c, the parts of the state and of the shared biases,
///
/// ```text
/// L ∘ (Ỹ Ỹᵀ) = ρ ∘ (Ỹ_x Ỹ_xᵀ) + κ (Ỹ_x Ỹ_cᵀ + Ỹ_c Ỹ_xᵀ) + Ỹ_c Ỹ_cᵀ
/// ```
///
/// The first term is sparse, with few observations within the radius of each, and is factorised as such. With C the members'
/// deviations in the shared biases over √(N−1), `[p, N]`, and G the weights of these in the whitened observations, `[n, p]`,
/// so that Ỹ_c = G C, the others have the rank 2p,
///
/// ```text
/// S = S₀ + U K Uᵀ,    S₀ = I + ρ ∘ (Ỹ_x Ỹ_xᵀ),    U = [G, Ỹ_x Cᵀ],    K = [C Cᵀ, κ I; κ I, 0]
/// S⁻¹ = S₀⁻¹ − S₀⁻¹ U (I + K Uᵀ S₀⁻¹ U)⁻¹ K Uᵀ S₀⁻¹
/// ```
///
/// (Sherman, Morrison and Woodbury), with a step of iterative refinement for what the difference loses.
pub(super) struct TaperedInnovations<'a> {
    observed: &'a WhitenedObservations,
    taper: &'a Taper,
    places: &'a [(f64, f64)],
    buckets: Buckets,
    /// Ỹ_x row by row, `[n, N]`.
    state_rows: Vec<f64>,
    /// κ.
    cross: f64,
    /// The standard deviations of the members' h(x, c) over those of the observations, `[n]`.
    spread: Vec<f64>,
    /// σ of the observations.
    sigma: Vec<f64>,
    /// S₀, whose lower triangle is stored, and its Cholesky factor.
    sparse: SparseColMat<usize, f64>,
    factor: Llt<usize, f64>,
    border: Option<Border>,
}

/// What shared biases add to the covariance.
struct Border {
    /// C, `[p, N]`.
    parameters: Mat<f64>,
    /// U, `[n, 2p]`, whose first half is G; K; and S₀⁻¹ U.
    columns: Mat<f64>,
    core: Mat<f64>,
    solved: Mat<f64>,
    /// I + K Uᵀ S₀⁻¹ U.
    reduced: PartialPivLu<f64>,
}

/// The parameters that many places share, among those that are estimated.
pub(super) struct SharedParameters<'a> {
    /// Their rows among the parameters.
    pub numbers: &'a [usize],
    /// The members' deviations, `[all parameters, N]`.
    pub perturbations: MatRef<'a, f64>,
}

impl<'a> TaperedInnovations<'a> {
    /// `members` is what `observed` was before it was whitened.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`]: the observations are too accurate beside the members' spread.
    pub fn new(
        grid: &Grid,
        members: &'a ObservedEnsemble,
        observed: &'a WhitenedObservations,
        shared: &SharedParameters<'_>,
        taper: &'a Taper,
        cross: f64,
    ) -> Result<Self, Error> {
        let ObservedEnsemble { innovations: Innovations { jacobian, variance, .. }, places, .. } = members;
        let (n, columns) = (observed.perturbations.nrows(), observed.perturbations.ncols());
        let sigma: Vec<f64> = variance.iter().map(|variance| variance.sqrt()).collect();
        // Biases that nothing observes are no part of it.
        let mut numbers: Vec<usize> =
            (0..n).flat_map(|row| jacobian.calibration.row(row).iter().map(|entry| entry.0)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers.retain(|number| shared.numbers.contains(number));
        let p = numbers.len();
        let root = ((columns - 1) as f64).sqrt();
        let parameters = Mat::from_fn(p, columns, |i, j| shared.perturbations[(numbers[i], j)] / root);
        let mut weights = Mat::zeros(n, p);
        for row in 0..n {
            for &(number, weight) in jacobian.calibration.row(row) {
                if let Ok(k) = numbers.binary_search(&number) {
                    weights[(row, k)] += weight / sigma[row];
                }
            }
        }
        let mut state_part = observed.perturbations.clone();
        add_product(state_part.as_mut(), -1.0, weights.as_ref(), parameters.as_ref());
        let state_rows = row_major(state_part.as_ref());
        let buckets = Buckets::new(grid, taper.radius_m(), places);
        let (sparse, factor) = factorised(taper, places, &buckets, &state_rows, columns)?;
        let mut tapered = Self {
            observed,
            taper,
            places,
            buckets,
            state_rows,
            cross,
            spread: Vec::new(),
            sigma,
            sparse,
            factor,
            border: None,
        };
        let with_state = product(state_part.as_ref(), parameters.transpose());
        let of_parameters = product(parameters.as_ref(), parameters.transpose());
        let with_parameters = product(weights.as_ref(), of_parameters.as_ref());
        tapered.spread = (0..n)
            .map(|i| {
                let own = &tapered.state_rows[i * columns..][..columns];
                let of_biases =
                    (0..p).map(|k| weights[(i, k)] * (2.0 * cross * with_state[(i, k)] + with_parameters[(i, k)]));
                (dot(own, own) + of_biases.sum::<f64>()).max(0.0).sqrt()
            })
            .collect();
        if p > 0 {
            let columns = Mat::from_fn(n, 2 * p, |i, k| if k < p { weights[(i, k)] } else { with_state[(i, k - p)] });
            let core = Mat::from_fn(2 * p, 2 * p, |i, j| match (i < p, j < p) {
                (true, true) => of_parameters[(i, j)],
                (false, false) => 0.0,
                _ => {
                    if i.abs_diff(j) == p {
                        cross
                    } else {
                        0.0
                    }
                }
            });
            let solved = tapered.solve_sparse(columns.clone());
            let mut reduced = Mat::identity(2 * p, 2 * p);
            let inner = product(columns.transpose(), solved.as_ref());
            add_product(reduced.as_mut(), 1.0, core.as_ref(), inner.as_ref());
            let reduced = reduced.partial_piv_lu();
            tapered.border = Some(Border { parameters, columns, core, solved, reduced });
        }
        Ok(tapered)
    }

    /// dᵀ S⁻¹ d.
    ///
    /// # Errors
    /// [`Error::Unresolved`] where rounding of S changes what S⁻¹ d adds at an observation by more than 10⁻⁶ of the members'
    /// spread there; see [`Problem::resolved_analysis`](crate::problem::Problem::resolved_analysis).
    pub fn chi2(&self) -> Result<f64, Error> {
        const TOLERANCE: f64 = 1e-6;
        // S⁻¹ d is also the departure that is left, in standard deviations of the observation.
        let left = self.solve(column(&self.observed.departures));
        let left = left.col_as_slice(0);
        let unresolved =
            left.iter().zip(&self.spread).zip(&self.observed.departures).position(|((left, spread), d)| {
                f64::EPSILON * spread * spread * left.abs() > TOLERANCE * spread.max(d.abs())
            });
        if let Some(row) = unresolved {
            let sigma = self.sigma[row];
            return Err(Error::Unresolved {
                observation: format!("{} of the cycle", row + 1),
                departure: sigma * left[row],
                sigma,
                spread: sigma * self.spread[row],
            });
        }
        Ok(dot(&self.observed.departures, left))
    }

    /// S₀⁻¹ times columns.
    fn solve_sparse(&self, columns: Mat<f64>) -> Mat<f64> {
        faer::set_global_parallelism(Par::Seq);
        self.factor.solve(columns)
    }

    /// S⁻¹ times columns.
    pub fn solve(&self, columns: Mat<f64>) -> Mat<f64> {
        let Some(border) = &self.border else { return self.solve_sparse(columns) };
        let once = |columns: Mat<f64>| {
            let mut solved = self.solve_sparse(columns);
            let seen = product(border.columns.transpose(), solved.as_ref());
            let weights = border.reduced.solve(product(border.core.as_ref(), seen.as_ref()));
            add_product(solved.as_mut(), -1.0, border.solved.as_ref(), weights.as_ref());
            solved
        };
        let mut solved = once(columns.clone());
        let left = columns - self.times(&solved, border);
        solved += once(left);
        solved
    }

    /// S times columns.
    fn times(&self, columns: &Mat<f64>, border: &Border) -> Mat<f64> {
        let seen = product(border.columns.transpose(), columns.as_ref());
        let mut result = product(border.columns.as_ref(), product(border.core.as_ref(), seen.as_ref()).as_ref());
        for k in 0..columns.ncols() {
            let (x, result) = (columns.col_as_slice(k), result.col_as_slice_mut(k));
            for j in 0..x.len() {
                for (i, &value) in self.sparse.row_idx_of_col(j).zip(self.sparse.val_of_col(j)) {
                    result[i] += value * x[j];
                    if i != j {
                        result[j] += value * x[i];
                    }
                }
            }
        }
        result
    }

    /// What S⁻¹ makes of innovations, `[n, N]`, taken to places.
    pub fn gain(&self, innovations: Mat<f64>) -> TaperedGain<'_> {
        let solved = self.solve(innovations);
        let (n, columns) = (solved.nrows(), solved.ncols());
        let root = ((columns - 1) as f64).sqrt();
        let mut rows = row_major(solved.as_ref());
        rows.iter_mut().for_each(|value| *value /= root);
        let state_rows = MatRef::from_column_major_slice(&self.state_rows, columns, n);
        let of_state = product(state_rows, solved.as_ref()) * faer::Scale(1.0 / root);
        let of_shared = self.border.as_ref().map_or_else(
            || Mat::zeros(columns, columns),
            |border| {
                let weights = border.columns.get(.., ..border.parameters.nrows());
                let seen = product(weights.transpose(), solved.as_ref());
                product(border.parameters.transpose(), seen.as_ref()) * faer::Scale(1.0 / root)
            },
        );
        TaperedGain { tapered: self, rows, of_state, of_shared }
    }
}

/// Increments from S⁻¹ times innovations.
pub(super) struct TaperedGain<'a> {
    tapered: &'a TaperedInnovations<'a>,
    /// S⁻¹ d/√(N−1) row by row, `[n, N]`.
    rows: Vec<f64>,
    /// Ỹ_xᵀ S⁻¹ d/√(N−1) and Ỹ_cᵀ S⁻¹ d/√(N−1), `[N, N]`.
    of_state: Mat<f64>,
    of_shared: Mat<f64>,
}

impl TaperedGain<'_> {
    /// The numbers of the observations with a weight at a place, ascending, with these.
    pub fn near(&self, place: (f64, f64)) -> Vec<(usize, f64)> {
        let TaperedInnovations { buckets, taper, places, .. } = self.tapered;
        let mut found = Vec::new();
        buckets.near([place.0; 2], place.1, &mut found);
        let weights = found.into_iter().map(|number| (number, taper.weight(place, places[number])));
        weights.filter(|(_, weight)| *weight > 0.0).collect()
    }

    /// (ρ ∘ P Hᵀ) S⁻¹ d of deviations `[k, N]` at one place, which has these observations near it.
    pub fn of_state(&self, deviations: MatRef<'_, f64>, near: &[(usize, f64)]) -> Mat<f64> {
        let columns = deviations.ncols();
        let mut increment = product(deviations, self.of_shared.as_ref()) * faer::Scale(self.tapered.cross);
        let mut own = vec![0.0; columns];
        let mut sum = vec![0.0; columns];
        for k in 0..deviations.nrows() {
            (0..columns).for_each(|j| own[j] = deviations[(k, j)]);
            sum.fill(0.0);
            for &(number, weight) in near {
                let of_row = number * columns..(number + 1) * columns;
                let covariance = weight * dot(&own, &self.tapered.state_rows[of_row.clone()]);
                axpy(covariance, &self.rows[of_row], &mut sum);
            }
            (0..columns).for_each(|j| increment[(k, j)] += sum[j]);
        }
        increment
    }

    /// The same of the deviations `[k, N]` of shared parameters.
    pub fn of_shared(&self, deviations: MatRef<'_, f64>) -> Mat<f64> {
        let weights = &self.of_state * faer::Scale(self.tapered.cross) + &self.of_shared;
        product(deviations, weights.as_ref())
    }
}

/// A symmetric matrix, whose lower triangle is stored, and its Cholesky factor.
type Factorised = (SparseColMat<usize, f64>, Llt<usize, f64>);

/// S₀ and its factor.
fn factorised(
    taper: &Taper,
    places: &[(f64, f64)],
    buckets: &Buckets,
    rows: &[f64],
    members: usize,
) -> Result<Factorised, Error> {
    let n = places.len();
    let row = |i: usize| &rows[i * members..][..members];
    let columns: Vec<Vec<(usize, f64)>> = (0..n)
        .into_par_iter()
        .map_init(Vec::new, |found, j| {
            buckets.near([places[j].0; 2], places[j].1, found);
            let below = found.iter().filter(|i| **i >= j).map(|&i| (i, taper.weight(places[i], places[j])));
            let diagonal = |i: usize| if i == j { 1.0 } else { 0.0 };
            below
                .filter(|(i, weight)| *i == j || *weight > 0.0)
                .map(|(i, weight)| (i, diagonal(i) + weight * dot(row(i), row(j))))
                .collect()
        })
        .collect();
    let mut starts = vec![0];
    columns.iter().for_each(|column| starts.push(starts[starts.len() - 1] + column.len()));
    let numbers = columns.iter().flatten().map(|entry| entry.0).collect();
    let values = columns.iter().flatten().map(|entry| entry.1).collect();
    let matrix = SparseColMat::new(SymbolicSparseColMat::new_checked(n, n, starts, None, numbers), values);
    faer::set_global_parallelism(Par::Seq);
    let factor = matrix.sp_cholesky(Side::Lower).map_err(|error| Error::NotPositiveDefinite {
        matrix: "the members' tapered innovation covariance H P H' + R".into(),
        pivot: match error {
            LltError::Numeric(factor::LltError::NonPositivePivot { index }) => index,
            LltError::Generic(_) => 0,
        },
        size: n,
    })?;
    Ok((matrix, factor))
}

/// How many numbers [`TaperedInnovations`] holds for N members and n observations, of which a share is within the taper of a
/// place: rows of the members, and a factor that fills up as that of a nested dissection.
pub(super) fn numbers(members: f64, observations: f64, reach: f64) -> f64 {
    let near = observations * reach;
    let filled = near * (1.0 + (1.0 / reach).log2());
    4.0 * members * observations + observations * (3.0 * near + 2.0 * filled).min(4.0 * observations)
}

/// The largest κ for which the taper of state and shared parameters is positive semidefinite: the root of the mean of ρ
/// over the domain, as seen from where that is least.
pub(super) fn cross_taper(grid: &Grid, taper: &Taper) -> f64 {
    let place = |i: usize, j: usize| ((i as f64 + 0.5) * grid.dx_m, (j as f64 + 0.5) * grid.dy_m);
    let corner = place(0, 0);
    let cells = (0..grid.cells()).map(|cell| taper.weight(corner, place(cell % grid.nx, cell / grid.nx)));
    (cells.sum::<f64>() / grid.cells() as f64).sqrt()
}
