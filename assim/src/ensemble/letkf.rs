//! The local ensemble transform Kalman filter.

use super::EnsembleSettings;
use super::band::{Band, BandParameters, BesideState, Plan};
use super::batch;
use super::cycle::{EnsembleCycle, Memory};
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis, with_smoother, with_trajectories};
use super::fixed_lag::FixedLag;
use super::localization::Taper;
use super::members::Ensemble;
use super::moments::Moments;
use super::near::LocalObservations;
use super::observed::ObservedEnsemble;
use super::tapered::{self, SharedParameters, TaperedInnovations, cross_taper};
use super::transform::WhitenedObservations;
use super::weights::WeightGrid;
use crate::covariance::LocalizedEnsemble;
use crate::error::Error;
use crate::estimate::Estimate;
use crate::problem::{Innovations, Problem};
use faer::Mat;
use isobar_model::vector::add;
use isobar_model::{Bands, Grid, Model};
use isobar_obs::ByPlacement;
use rayon::prelude::*;
use std::ops::Range;
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
    weights: Arc<WeightGrid>,
    /// κ of the taper between state and shared parameters.
    cross: f64,
    /// The share of the plane whose observations are near a place.
    reach: f64,
    shared: Vec<usize>,
    /// The cells in which local parameters belong, with these, in ascending order.
    local: Vec<(usize, usize)>,
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
        let weights = WeightGrid::new(&layout.grid, local.analysis_spacing_cells);
        let taper = Taper::new(&layout.grid, local.localization_radius_m);
        let cross = cross_taper(&layout.grid, &taper);
        let ByPlacement { shared, local } = problem.estimated_calibration().by_placement();
        let mut local: Vec<(usize, usize)> =
            local.into_iter().map(|(number, (x_m, y_m))| (layout.grid.cell_at(x_m, y_m), number)).collect();
        local.sort_unstable();
        let (places, reach) = (weights.len(), taper.reach());
        let analysis = LocalTransform { taper, weights: Arc::new(weights), cross, reach, shared, local };
        with_analysis(problem, settings, places, analysis)
    }

    /// The filter with its ensemble smoother of the last `lag` analyses before the newest: the weights of a place, and those of a
    /// bias, also revise its earlier members, without inflation and relaxation.
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

/// The cells in which observations see a shared parameter, each with the information G²/R on it.
fn evidence(grid: &Grid, members: &ObservedEnsemble, number: usize) -> impl Iterator<Item = (usize, f64)> {
    let Innovations { jacobian, variance, .. } = &members.innovations;
    (0..variance.len()).filter_map(move |row| {
        let entry = jacobian.calibration.row(row).iter().find(|entry| entry.0 == number)?;
        let (x_m, y_m) = members.places[row];
        Some((grid.cell_at(x_m, y_m), entry.1 * entry.1 / variance[row]))
    })
}

/// How many rows of analyses make a band. Those between two bands are made in both, where cells are between analyses.
fn band_height(weights: &WeightGrid) -> usize {
    const HIGHEST: usize = 8;
    let rows = weights.rows.len();
    if rows == weights.rows.cells(0..rows).len() {
        1
    } else {
        rows.div_ceil(2 * rayon::current_num_threads()).min(HIGHEST)
    }
}

impl EnsembleAnalysis for LocalTransform {
    /// The observations row by row; and on each thread those around a batch of places with the matrices there, and a band of
    /// the members.
    fn numbers(&self, problem: &Problem<dyn Model>, members: f64, observations: f64, earlier: usize) -> f64 {
        let layout = problem.background.layout();
        let (grid, variables, ensembles) = (&layout.grid, layout.variables.len(), earlier + 1);
        let near = observations * (2.0 * self.reach).min(1.0);
        // A place has a weight in the cells up to the next ones.
        let [columns, rows] = [&self.weights.columns, &self.weights.rows].map(|axis| 2 * axis.cells(0..1).len() - 1);
        let vectors = ensembles * (columns * rows * variables + self.shared.len());
        let batch = batch::numbers(members, near, vectors as f64);
        let band = Plan::numbers(grid, variables, &self.weights, band_height(&self.weights), members, ensembles);
        observations * members + rayon::current_num_threads() as f64 * (batch + band)
    }

    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error> {
        let layout = cycle.problem.background.layout().clone();
        let (grid, variables) = (&layout.grid, layout.variables.len());
        let whitened = WhitenedObservations::new(members);
        let Memory { ensemble, smoother, variance_factors, .. } = &mut cycle.memory;
        let mut earlier: Vec<&mut Moments> = smoother.iter_mut().flat_map(FixedLag::earlier).collect();
        let parameters_earlier = earlier.iter().map(|earlier| earlier.rows_from(layout.len()));
        let parameters = std::iter::once(ensemble.parameter_moments()).chain(parameters_earlier);
        let (means, perturbations): (Vec<_>, Vec<_>) = parameters.map(|it| (it.mean, it.perturbations.0)).unzip();
        let shared: Vec<(usize, Vec<f64>)> = self
            .shared
            .iter()
            .filter_map(|&number| Some((number, self.weights.shares(evidence(grid, members, number))?)))
            .collect();
        let inflation = cycle.settings.inflation;
        let plan = Plan {
            grid,
            variables,
            weights: &self.weights,
            observations: LocalObservations::new(grid, &self.taper, &members.places, &whitened, inflation),
            inflation,
            parameters: &perturbations,
            local: &self.local,
            shared: &shared,
            last_factors: variance_factors,
        };
        let found = analyse_bands(&plan, &cycle.bands, ensemble, &mut earlier);
        for (number, (mean, perturbations)) in means.into_iter().zip(&perturbations).enumerate() {
            let found = found.iter().map(|found| &found.parameters[number]);
            let analysed = analysed_parameters(mean, perturbations, &plan, &cycle.bands, found);
            match number.checked_sub(1) {
                None => ensemble.set_parameters(&analysed),
                Some(number) => earlier[number].set_rows_from(layout.len(), &analysed),
            }
        }
        let own_factors: Vec<f64> = found.into_iter().flat_map(|found| found.variance_factors).collect();
        *variance_factors = cycle.bands.communicator().gather_all(&own_factors).concat();

        // χ² alone needs the covariance of all observations, and is given where there is memory for it.
        let shared = SharedParameters { numbers: &self.shared, perturbations: perturbations[0].as_ref() };
        let (count, n) = (whitened.perturbations.ncols() as f64, whitened.departures.len() as f64);
        let fits = cycle.problem.require_memory(tapered::numbers(count, n, self.taper.reach()), || "χ²".into());
        let tapered = fits
            .and_then(|()| TaperedInnovations::new(grid, members, &whitened, &shared, &self.taper, self.cross)?.chi2());
        // What the sum of the tapered covariance and R does not resolve, the local analyses may: they fail for nothing.
        Ok(tapered.ok())
    }
}

/// Applies the local analyses to the states of the members, now and in earlier ensembles, in the rows that this rank has.
fn analyse_bands(
    plan: &Plan<'_>,
    ranks: &Bands,
    ensemble: &mut Ensemble,
    earlier: &mut [&mut Moments],
) -> Vec<BesideState> {
    let (rows, height, own) = (&plan.weights.rows, band_height(plan.weights), ranks.own());
    let (first, last) = (rows.around(own.start)[0].0, rows.around(own.end - 1)[0].0);
    let bands = || (first..=last).step_by(height).map(|first| first..(last + 1).min(first + height));
    let own_rows = |points: Range<usize>| {
        let Range { start, end } = rows.cells(points);
        start.max(own.start)..end.min(own.end)
    };
    let lengths: Vec<usize> = bands().map(|points| own_rows(points).len() * plan.grid.nx).collect();
    let cells = ranks.own_cells().len();
    let fields = ensemble.split_fields(cells, &lengths);
    let in_bands = bands().zip(fields);
    let mut bands: Vec<_> = in_bands
        .map(|(points, fields)| Band { rows: own_rows(points.clone()), points, fields, earlier: Vec::new() })
        .collect();
    for earlier in earlier {
        let pieces = earlier.split_fields(plan.variables * cells, cells, &lengths);
        bands.iter_mut().zip(pieces).for_each(|(band, piece)| band.earlier.push(piece));
    }
    bands.into_par_iter().map(|band| plan.analyse(band)).collect()
}

/// The analysed moments of all parameters of an ensemble, from their background and from what the bands of all ranks find; shared
/// parameters that are not observed keep theirs.
fn analysed_parameters<'a>(
    mean: Vec<f64>,
    perturbations: &Mat<f64>,
    plan: &Plan<'_>,
    ranks: &Bands,
    found: impl Iterator<Item = &'a BandParameters> + Clone,
) -> Moments {
    let (members, shared) = (perturbations.ncols(), plan.shared);
    let mut analysed = vec![0.0; mean.len() * (members + 1)];
    for (number, row) in found.clone().flat_map(|found| &found.local) {
        analysed[number * (members + 1)..][..members + 1].copy_from_slice(row);
    }
    for (i, (number, _)) in shared.iter().enumerate() {
        for row in found.clone().flat_map(|found| found.shared.iter().skip(i).step_by(shared.len())) {
            add(&mut analysed[number * (members + 1)..][..members + 1], row);
        }
    }
    ranks.communicator().sum(&mut analysed);
    let mut is_analysed = vec![false; mean.len()];
    plan.local.iter().for_each(|&(_, number)| is_analysed[number] = true);
    shared.iter().for_each(|&(number, _)| is_analysed[number] = true);
    let deviations = Mat::from_fn(mean.len(), members + 1, |i, j| match is_analysed[i] {
        true => analysed[i * (members + 1) + j],
        false if j < members => perturbations[(i, j)],
        false => 0.0,
    });
    Moments::of_transformed(mean, &deviations)
}
