//! The stochastic ensemble Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis};
use super::localization::Taper;
use super::members::ObservedEnsemble;
use super::moments::Moments;
use super::tapered::{self, SharedParameters, TaperedGain, TaperedInnovations, cross_taper};
use super::transform::WhitenedObservations;
use crate::error::Error;
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
        with_analysis(problem, settings, 1, analysis)
    }
}

impl EnsembleAnalysis for PerturbedObservations {
    /// The tapered innovations and their solution with its draws.
    fn numbers(&self, _: &Problem<dyn Model>, members: f64, observations: f64) -> f64 {
        tapered::numbers(members, observations, self.taper.reach()) + 4.0 * members * observations
    }

    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error> {
        let m = cycle.state_values();
        let inflation = cycle.settings.inflation;
        let mut whitened = WhitenedObservations::new(members);
        let (n, columns) = (whitened.perturbations.nrows(), whitened.perturbations.ncols());
        let variance_factor = &mut cycle.memory.variance_factors[0];
        *variance_factor = inflation.variance_factor(*variance_factor, &whitened.sizes());
        let factor = variance_factor.sqrt();
        whitened.perturbations *= faer::Scale(factor);
        let background = cycle.memory.ensemble.moments();
        let perturbations = background.perturbations.as_ref();

        let parameters = perturbations.get(m.., ..) * faer::Scale(factor);
        let shared = SharedParameters { numbers: &self.shared, perturbations: parameters.as_ref() };
        let layout = cycle.problem.background.layout();
        let tapered = TaperedInnovations::new(&layout.grid, members, &whitened, &shared, &self.taper, self.cross)?;
        let chi2 = tapered.chi2()?;
        // R^-½ (y + ε_i − h(x_i)).
        let root = ((columns - 1) as f64).sqrt();
        let errors = centered_normals(&mut cycle.memory.random, n, columns);
        let innovations = Mat::from_fn(n, columns, |i, j| {
            whitened.departures[i] - root * whitened.perturbations[(i, j)] + errors[(i, j)]
        });
        let local = LocalUpdate { gain: tapered.gain(innovations), factor };

        let mut deviations = perturbations.to_owned();
        local.update_cells(layout, &mut deviations);
        for &(number, place) in &self.local {
            let row = perturbations.get(m + number..m + number + 1, ..);
            deviations.as_mut().get_mut(m + number..m + number + 1, ..).copy_from(local.analysed(row, place));
        }
        let own = Mat::from_fn(self.shared.len(), columns, |i, j| parameters[(self.shared[i], j)]);
        let increment = local.gain.of_shared(own.as_ref());
        for (i, &number) in self.shared.iter().enumerate() {
            // A bias that nothing observes is not inflated.
            let observed =
                (0..n).any(|row| members.innovations.jacobian.calibration.row(row).iter().any(|e| e.0 == number));
            let before = if observed { parameters.as_ref() } else { perturbations.get(m.., ..) };
            (0..columns).for_each(|j| deviations[(m + number, j)] = before[(number, j)] + increment[(i, j)]);
        }
        let mut analysed = Moments::of_deviations(background.mean.clone(), deviations);
        let relaxation = inflation.relaxation_to_prior_perturbations;
        if relaxation > 0.0 {
            *analysed.perturbations = &*analysed.perturbations * faer::Scale(1.0 - relaxation)
                + &*background.perturbations * faer::Scale(relaxation);
        }
        cycle.set(&background, analysed);
        Ok(Some(chi2))
    }
}

/// What the observations say, to be taken to places.
struct LocalUpdate<'a> {
    gain: TaperedGain<'a>,
    /// Inflation of the perturbations where something is observed.
    factor: f64,
}

impl LocalUpdate<'_> {
    /// The analysed values `[k, N]` of one place: inflated, plus (ρ ∘ P Hᵀ) S⁻¹ (y + ε − h).
    ///
    /// Inflation makes up for the spread that an analysis takes too much of, so it has the analysis's taper,
    /// 1 + (f − 1) max ρ: full at an observation, none where no observation has an influence. There it would multiply the
    /// spread in every cycle, with nothing to bring it back.
    fn analysed(&self, values: MatRef<'_, f64>, place: (f64, f64)) -> Mat<f64> {
        let near = self.gain.near(place);
        let nearest = near.iter().map(|(_, weight)| *weight).fold(0.0, f64::max);
        let inflated = values * faer::Scale(1.0 + (self.factor - 1.0) * nearest);
        let increment = self.gain.of_state(inflated.as_ref(), &near);
        inflated + increment
    }

    /// Takes perturbations to analysed deviations from the background's mean in all cells.
    fn update_cells(&self, layout: &Layout, deviations: &mut Mat<f64>) {
        let (grid, cells, variables) = (&layout.grid, layout.grid.cells(), layout.variables.len());
        let columns = deviations.ncols();
        let analysed: Vec<Mat<f64>> = (0..cells)
            .into_par_iter()
            .map(|cell| {
                let place = (grid.x_m(Location::Center, cell % grid.nx), grid.y_m(Location::Center, cell / grid.nx));
                let values = Mat::from_fn(variables, columns, |variable, j| deviations[(variable * cells + cell, j)]);
                self.analysed(values.as_ref(), place)
            })
            .collect();
        for j in 0..columns {
            let column = deviations.col_as_slice_mut(j);
            for (cell, analysed) in analysed.iter().enumerate() {
                (0..variables).for_each(|variable| column[variable * cells + cell] = analysed[(variable, j)]);
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
