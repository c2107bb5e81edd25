//! The stochastic ensemble Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter};
use super::localization::Taper;
use super::members::ObservedEnsemble;
use super::moments::Moments;
use super::tapered::{SharedParameters, TaperedInnovations, cross_taper};
use super::transform::WhitenedObservations;
use crate::error::Error;
use crate::linalg::product;
use crate::problem::Problem;
use faer::{Mat, MatRef};
use isobar_model::random::standard_normals;
use isobar_model::{Layout, Location, Model};
use isobar_obs::ByPlacement;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Each member assimilates the observations with perturbations of its own (Evensen 1994; Burgers, van Leeuwen and Evensen
/// 1998):
///
/// ```text
/// x_i ← x_i + K (y + ε_i − h(x_i)),     K = (ρ ∘ P Hᵀ) (ρ ∘ H P Hᵀ + R)⁻¹,     ε_i ~ N(0, R), with mean zero
/// ```
///
/// with Gaspari and Cohn's taper ρ on the covariances (Houtekamer and Mitchell 2001); for shared biases see `tapered`.
pub type StochasticEnsembleKalmanFilter = EnsembleFilter<PerturbedObservations>;

/// The analysis of the [`StochasticEnsembleKalmanFilter`].
#[derive(Clone)]
pub struct PerturbedObservations {
    taper: Taper,
    /// κ of the taper between state and shared parameters.
    cross: f64,
    shared: Vec<usize>,
    /// Local parameters with their places.
    local: Vec<(usize, (f64, f64))>,
}

impl StochasticEnsembleKalmanFilter {
    /// A filter with members about the background; an infinite radius is no localisation.
    ///
    /// # Errors
    /// As [`Ensemble::draw`](super::Ensemble::draw).
    pub fn new(
        problem: impl Into<Problem<dyn Model>>,
        settings: EnsembleSettings,
        localization_radius_m: f64,
    ) -> Result<Self, Error> {
        let problem = problem.into();
        let grid = &problem.background.layout().grid;
        let taper = Taper::new(grid, localization_radius_m);
        let cross = cross_taper(grid, &taper);
        let ByPlacement { shared, local } = problem.estimated_calibration().by_placement();
        let analysis = PerturbedObservations { taper, cross, shared, local };
        Ok(Self { cycle: EnsembleCycle::new(problem, settings, 1)?, analysis })
    }
}

impl EnsembleAnalysis for PerturbedObservations {
    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> f64 {
        let m = cycle.state_values();
        let inflation = cycle.settings.inflation;
        let mut whitened = WhitenedObservations::new(members);
        let (n, columns) = (whitened.perturbations.nrows(), whitened.perturbations.ncols());
        let variance_factor = &mut cycle.memory.variance_factors[0];
        *variance_factor = inflation.variance_factor(*variance_factor, &whitened, n as f64);
        let factor = variance_factor.sqrt();
        whitened.perturbations *= faer::Scale(factor);
        let background = cycle.memory.ensemble.moments();
        let inflated = &*background.perturbations * faer::Scale(factor);

        let parameters = inflated.as_ref().get(m.., ..);
        let shared = SharedParameters { numbers: &self.shared, perturbations: parameters };
        let tapered = TaperedInnovations::new(members, &whitened, &shared, &self.taper, self.cross);
        // R^-½ (y + ε_i − h(x_i)), then S⁻¹ of it.
        let root = ((columns - 1) as f64).sqrt();
        let errors = centered_normals(&mut cycle.memory.random, n, columns);
        let innovations = Mat::from_fn(n, columns, |i, j| {
            whitened.departures[i] - root * whitened.perturbations[(i, j)] + errors[(i, j)]
        });
        let solved = tapered.apply(|value| 1.0 / (1.0 + value), innovations.as_ref());

        let mut deviations = inflated.clone();
        self.update_cells(cycle.problem.background.layout(), &tapered, &solved, members, &mut deviations);
        for &(number, place) in &self.local {
            let row = inflated.as_ref().get(m + number..m + number + 1, ..);
            let increment = self.increment(&tapered, &solved, members, row, place);
            (0..columns).for_each(|j| deviations[(m + number, j)] += increment[(0, j)]);
        }
        let own = Mat::from_fn(self.shared.len(), columns, |i, j| parameters[(self.shared[i], j)]);
        let increment = product(tapered.covariance_of_shared(own.as_ref()).as_ref(), solved.as_ref());
        for (i, &number) in self.shared.iter().enumerate() {
            (0..columns).for_each(|j| deviations[(m + number, j)] += increment[(i, j)]);
        }
        let mut analysed = Moments::of_deviations(background.mean.clone(), deviations);
        let relaxation = inflation.relaxation_to_prior_perturbations;
        if relaxation > 0.0 {
            *analysed.perturbations = &*analysed.perturbations * faer::Scale(1.0 - relaxation)
                + &*background.perturbations * faer::Scale(relaxation);
        }
        cycle.set(&background, analysed);
        tapered.chi2()
    }
}

impl PerturbedObservations {
    /// (ρ ∘ P Hᵀ) S⁻¹ (y + ε − h) for the values `[k, N]` of one place.
    fn increment(
        &self,
        tapered: &TaperedInnovations<'_>,
        solved: &Mat<f64>,
        members: &ObservedEnsemble,
        values: MatRef<'_, f64>,
        place: (f64, f64),
    ) -> Mat<f64> {
        let weights: Vec<f64> = members.places.iter().map(|&other| self.taper.weight(place, other)).collect();
        product(tapered.covariance_of_state(values, &weights).as_ref(), solved.as_ref())
    }

    /// Adds the increments of all cells to deviations that are the background's.
    fn update_cells(
        &self,
        layout: &Layout,
        tapered: &TaperedInnovations<'_>,
        solved: &Mat<f64>,
        members: &ObservedEnsemble,
        deviations: &mut Mat<f64>,
    ) {
        let (grid, cells, variables) = (&layout.grid, layout.grid.cells(), layout.variables.len());
        let increments: Vec<Mat<f64>> = (0..cells)
            .into_par_iter()
            .map(|cell| {
                let place = (grid.x_m(Location::Center, cell % grid.nx), grid.y_m(Location::Center, cell / grid.nx));
                let values =
                    Mat::from_fn(variables, solved.ncols(), |variable, j| deviations[(variable * cells + cell, j)]);
                self.increment(tapered, solved, members, values.as_ref(), place)
            })
            .collect();
        for j in 0..solved.ncols() {
            let column = deviations.col_as_slice_mut(j);
            for (cell, increment) in increments.iter().enumerate() {
                (0..variables).for_each(|variable| column[variable * cells + cell] += increment[(variable, j)]);
            }
        }
    }
}

/// Standard normals `[rows, columns]` whose rows have mean zero.
fn centered_normals(random: &mut ChaCha8Rng, rows: usize, columns: usize) -> Mat<f64> {
    let normals = standard_normals(random, rows * columns);
    let mean: Vec<f64> =
        (0..rows).map(|i| (0..columns).map(|j| normals[j * rows + i]).sum::<f64>() / columns as f64).collect();
    Mat::from_fn(rows, columns, |i, j| normals[j * rows + i] - mean[i])
}
