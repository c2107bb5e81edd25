//! The stochastic ensemble Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis, with_smoother, with_trajectories};
use super::localization::Taper;
use super::moments::Moments;
use super::observed::ObservedEnsemble;
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

    /// The filter with its ensemble smoother of the last `lag` analyses before the newest.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if their members do not fit into the memory limit; [`Error::Setting`] with
    /// [`ModelErrorTreatment::SquareRoot`](super::ModelErrorTreatment::SquareRoot), unless nothing is added in a cycle.
    pub fn smoothing(self, lag: usize) -> Result<Self, Error> {
        with_smoother(self, lag)
    }

    /// The same with members that see observations within a window from their own trajectories: the asynchronous filter (Sakov,
    /// Evensen and Bertino 2010).
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the starts of the trajectories do not fit into the memory limit.
    pub fn asynchronous(self) -> Result<Self, Error> {
        with_trajectories(self)
    }
}

impl EnsembleAnalysis for PerturbedObservations {
    /// The tapered innovations and their solution with its draws.
    fn numbers(&self, _: &Problem<dyn Model>, members: f64, observations: f64, _: usize) -> f64 {
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
        let rows = &members.innovations.jacobian.calibration;
        let is_observed = |number: usize| (0..n).any(|row| rows.row(row).iter().any(|entry| entry.0 == number));
        let update = Update {
            layout,
            gain: tapered.gain(innovations),
            local: &self.local,
            shared: self.shared.iter().map(|&number| (number, is_observed(number))).collect(),
        };
        if let Some(smoother) = &mut cycle.memory.smoother {
            for earlier in smoother.earlier() {
                let deviations = update.analysed(&earlier.perturbations, 1.0);
                *earlier = Moments::of_deviations(std::mem::take(&mut earlier.mean), deviations);
            }
        }
        let deviations = update.analysed(&background.perturbations, factor);
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

/// The analysis of the observations, to be applied to the present and to earlier ensembles.
struct Update<'a> {
    layout: &'a Layout,
    gain: TaperedGain<'a>,
    /// Local parameters with their places.
    local: &'a [(usize, (f64, f64))],
    /// Shared parameters, and whether they are observed.
    shared: Vec<(usize, bool)>,
}

impl Update<'_> {
    /// Perturbations `[m + p, N]`, inflated by a factor and analysed, as deviations from the mean before the analysis.
    fn analysed(&self, perturbations: &Mat<f64>, factor: f64) -> Mat<f64> {
        let (m, columns) = (self.layout.len(), perturbations.ncols());
        let mut deviations = perturbations.clone();
        self.update_cells(&mut deviations, factor);
        for &(number, place) in self.local {
            let row = perturbations.get(m + number..m + number + 1, ..);
            let analysed = self.at_place(row, factor, place);
            deviations.as_mut().get_mut(m + number..m + number + 1, ..).copy_from(analysed);
        }
        let own = Mat::from_fn(self.shared.len(), columns, |i, j| factor * perturbations[(m + self.shared[i].0, j)]);
        let increment = self.gain.of_shared(own.as_ref());
        for (i, &(number, is_observed)) in self.shared.iter().enumerate() {
            // A bias that nothing observes is not inflated.
            let before = |j: usize| if is_observed { own[(i, j)] } else { perturbations[(m + number, j)] };
            (0..columns).for_each(|j| deviations[(m + number, j)] = before(j) + increment[(i, j)]);
        }
        deviations
    }

    /// The analysed values `[k, N]` of one place: inflated, plus (ρ ∘ P Hᵀ) S⁻¹ (y + ε − h).
    ///
    /// Inflation makes up for the spread that an analysis takes too much of, so it has the analysis's taper,
    /// 1 + (f − 1) max ρ: full at an observation, none where no observation has an influence. There it would multiply the
    /// spread in every cycle, with nothing to bring it back.
    fn at_place(&self, values: MatRef<'_, f64>, factor: f64, place: (f64, f64)) -> Mat<f64> {
        let near = self.gain.near(place);
        let nearest = near.iter().map(|(_, weight)| *weight).fold(0.0, f64::max);
        let inflated = values * faer::Scale(1.0 + (factor - 1.0) * nearest);
        let increment = self.gain.of_state(inflated.as_ref(), &near);
        inflated + increment
    }

    /// Turns perturbations into analysed deviations from the mean before the analysis, in all cells.
    fn update_cells(&self, deviations: &mut Mat<f64>, factor: f64) {
        let grid = &self.layout.grid;
        let (cells, variables, columns) = (grid.cells(), self.layout.variables.len(), deviations.ncols());
        let analysed: Vec<Mat<f64>> = (0..cells)
            .into_par_iter()
            .map(|cell| {
                let place = (grid.x_m(Location::Center, cell % grid.nx), grid.y_m(Location::Center, cell / grid.nx));
                let values = Mat::from_fn(variables, columns, |variable, j| deviations[(variable * cells + cell, j)]);
                self.at_place(values.as_ref(), factor, place)
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
