//! The local ensemble transform Kalman filter.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis};
use super::localization::Taper;
use super::members::ObservedEnsemble;
use super::moments::Moments;
use super::tapered::{self, SharedParameters, TaperedInnovations, cross_taper};
use super::transform::{self, WhitenedObservations, transform};
use super::weights::WeightGrid;
use crate::covariance::LocalizedEnsemble;
use crate::error::Error;
use crate::estimate::Estimate;
use crate::linalg::product;
use crate::problem::{Innovations, Problem};
use faer::Mat;
use isobar_model::{Grid, Location, Model};
use isobar_obs::ByPlacement;
use rayon::prelude::*;
use std::sync::Arc;

/// How the analysis is localised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalSettings {
    /// Distance \[m\] from which on an observation has no influence: the end of Gaspari and Cohn's function, by which the
    /// inverse of its error variance is multiplied; infinite for none.
    pub localization_radius_m: f64,
    /// Every how many cells, in x and in y, an analysis is made; the weights between are interpolated (Yang et al. 2009).
    pub analysis_spacing_cells: usize,
}

/// The ensemble transform of Hunt, Kostelich and Szunyogh (2007): an analysis of its own for each place, with the
/// observations around it, whose errors are taken to be the larger the farther away they are (R-localisation). All
/// variables of a cell have the same weights.
///
/// Biases are estimated by augmentation. That of one station is analysed with the weights of its place. A bias that many
/// places share has no place: it is analysed with the mean of the weights where it is observed, each with the information
/// that the observations there have on it, and stays as it is in a cycle without any. So members keep together what they
/// say of the bias and of the state around, and the filter does not become too sure of the bias, as it does with the
/// weights of one analysis of all observations: N members know at most N − 1 directions of their errors.
///
/// χ² is that of the innovations with the tapered covariance of the members (see `tapered`), where double precision has it
/// and the memory limit leaves room for a matrix of all observations.
pub type LocalEnsembleTransformKalmanFilter = EnsembleFilter<LocalTransform>;

/// The analysis of the [`LocalEnsembleTransformKalmanFilter`]; the cycle has an inflation for each analysed cell.
#[derive(Clone)]
pub struct LocalTransform {
    taper: Taper,
    grid: Arc<WeightGrid>,
    /// κ of the taper between state and shared parameters.
    cross: f64,
    /// The share of the plane whose observations are near a place.
    reach: f64,
    shared: Vec<usize>,
    /// Local parameters with the cells in which they belong.
    local: Vec<(usize, usize)>,
}

/// The parts of an analysis at one place.
struct LocalAnalysis {
    weights: Mat<f64>,
    variance_factor: f64,
}

impl LocalEnsembleTransformKalmanFilter {
    /// A filter with members about the background.
    ///
    /// # Errors
    /// As [`Ensemble::draw`](super::Ensemble::draw).
    pub fn new(
        problem: impl Into<Problem<dyn Model>>,
        settings: EnsembleSettings,
        local: LocalSettings,
    ) -> Result<Self, Error> {
        let problem = problem.into();
        let layout = problem.background.layout().clone();
        let grid = WeightGrid::new(&layout, local.analysis_spacing_cells);
        let taper = Taper::new(&layout.grid, local.localization_radius_m);
        let cross = cross_taper(&layout.grid, &taper);
        let ByPlacement { shared, local } = problem.estimated_calibration().by_placement();
        let local = local.into_iter().map(|(number, (x_m, y_m))| (number, layout.grid.cell_at(x_m, y_m))).collect();
        let (places, reach) = (grid.points().len(), taper.reach());
        let analysis = LocalTransform { taper, grid: Arc::new(grid), cross, reach, shared, local };
        with_analysis(problem, settings, places, analysis)
    }

    /// Mean and spread of the members.
    pub(crate) fn estimate(&self) -> Estimate {
        self.cycle.estimate()
    }

    /// The covariance of the members' states, localised.
    ///
    /// # Errors
    /// As [`LocalizedEnsemble::new`].
    pub(crate) fn state_covariance(&self, localization_radius_m: f64) -> Result<LocalizedEnsemble, Error> {
        let layout = self.cycle.problem.background.layout();
        let states = self.cycle.memory.ensemble.moments().perturbations.as_ref().get(..layout.len(), ..).to_owned();
        LocalizedEnsemble::new(layout, &states, localization_radius_m)
    }

    /// Shifts the members to another mean.
    pub(crate) fn shift_to(&mut self, estimate: &Estimate) {
        let mut moments = self.cycle.memory.ensemble.moments();
        let p = moments.mean.len() - estimate.state.values().len();
        moments.mean = estimate.state.values().iter().chain(&estimate.calibration[..p]).copied().collect();
        self.cycle.memory.ensemble.set(&moments);
    }
}

impl LocalTransform {
    /// The analysis at a cell, from the observations around it.
    fn analyse_at(
        &self,
        cycle: &EnsembleCycle,
        cell: usize,
        last_factor: f64,
        whitened: &WhitenedObservations,
        places: &[(f64, f64)],
    ) -> LocalAnalysis {
        let grid = &cycle.problem.background.layout().grid;
        let (i, j) = (cell % grid.nx, cell / grid.nx);
        let here = (grid.x_m(Location::Center, i), grid.y_m(Location::Center, j));
        let near: Vec<(usize, f64)> = places
            .iter()
            .enumerate()
            .map(|(row, &place)| (row, self.taper.weight(here, place)))
            .filter(|&(_, weight)| weight > 0.0)
            .collect();
        let members = whitened.perturbations.ncols();
        if near.is_empty() {
            return LocalAnalysis { weights: Mat::identity(members, members + 1), variance_factor: last_factor };
        }
        let roots: Vec<f64> = near.iter().map(|(_, weight)| weight.sqrt()).collect();
        let observed = WhitenedObservations {
            perturbations: Mat::from_fn(near.len(), members, |i, j| roots[i] * whitened.perturbations[(near[i].0, j)]),
            departures: near.iter().zip(&roots).map(|((row, _), root)| root * whitened.departures[*row]).collect(),
            rounding: near.iter().zip(&roots).map(|((row, _), root)| root * whitened.rounding[*row]).collect(),
        };
        let inflation = &cycle.settings.inflation;
        let total: f64 = near.iter().map(|(_, weight)| weight).sum();
        let variance_factor = inflation.variance_factor(last_factor, &observed, total);
        // Inflation has the analysis's taper: at the edge of an observation's reach there is next to no analysis to make up for.
        let nearest = near.iter().map(|(_, weight)| *weight).fold(0.0, f64::max);
        let tapered_factor = (1.0 + (variance_factor.sqrt() - 1.0) * nearest).powi(2);
        let relaxation = inflation.relaxation_to_prior_perturbations;
        LocalAnalysis { weights: transform(&observed, tapered_factor).weights(relaxation), variance_factor }
    }

    /// The cells in which observations see a shared parameter, each with the information G²/R on it.
    fn evidence(grid: &Grid, members: &ObservedEnsemble, number: usize) -> impl Iterator<Item = (usize, f64)> {
        let Innovations { jacobian, variance, .. } = &members.innovations;
        (0..variance.len()).filter_map(move |row| {
            let entry = jacobian.calibration.row(row).iter().find(|entry| entry.0 == number)?;
            let (x_m, y_m) = members.places[row];
            Some((grid.cell_at(x_m, y_m), entry.1 * entry.1 / variance[row]))
        })
    }
}

impl EnsembleAnalysis for LocalTransform {
    /// The weights of all places; on each thread those of a row, or an analysis with the observations around.
    fn numbers(&self, members: f64, observations: f64) -> f64 {
        let near = observations * (2.0 * self.reach).min(1.0);
        let on_thread = transform::numbers(members, near) + self.grid.weights_in_row() as f64 * members * members;
        let threads = rayon::current_num_threads() as f64;
        self.grid.points().len() as f64 * members * (members + 1.0) + threads * on_thread
    }

    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error> {
        let m = cycle.state_values();
        let whitened = WhitenedObservations::new(members);
        let analyses: Vec<LocalAnalysis> = self
            .grid
            .points()
            .par_iter()
            .zip(&cycle.memory.variance_factors)
            .map(|(&cell, &last)| self.analyse_at(cycle, cell, last, &whitened, &members.places))
            .collect();
        let (weights, factors): (Vec<_>, Vec<_>) =
            analyses.into_iter().map(|analysis| (analysis.weights, analysis.variance_factor)).unzip();
        cycle.memory.variance_factors = factors;

        let background = cycle.memory.ensemble.moments();
        let mut deviations = self.grid.apply(&weights, background.perturbations.as_ref());
        for &(number, cell) in &self.local {
            let row = background.perturbations.as_ref().get(m + number..m + number + 1, ..);
            let analysed = product(row, self.grid.weights_at(&weights, cell).as_ref());
            deviations.as_mut().get_mut(m + number..m + number + 1, ..).copy_from(&analysed);
        }
        let parameters = background.perturbations.as_ref().get(m.., ..);
        let grid = &cycle.problem.background.layout().grid;
        for &number in &self.shared {
            let row = background.perturbations.as_ref().get(m + number..m + number + 1, ..);
            if let Some(mean) = self.grid.mean(&weights, Self::evidence(grid, members, number)) {
                deviations.as_mut().get_mut(m + number..m + number + 1, ..).copy_from(product(row, mean.as_ref()));
            }
        }
        let shared = SharedParameters { numbers: &self.shared, perturbations: parameters };
        // χ² alone needs the covariance of all observations, and is given where there is memory for it.
        let (count, n) = (whitened.perturbations.ncols() as f64, whitened.departures.len() as f64);
        let fits = cycle.problem.require_memory(tapered::numbers(count, n), || "χ²".into());
        let tapered =
            fits.and_then(|()| TaperedInnovations::new(members, &whitened, &shared, &self.taper, self.cross)?.chi2());
        let analysed = Moments::of_transformed(background.mean.clone(), &deviations);
        cycle.set(&background, analysed);
        // What the sum of the tapered covariance and R does not resolve, the local analyses may: they fail for nothing.
        Ok(tapered.ok())
    }
}
