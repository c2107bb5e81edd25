//! An ensemble Kalman filter: members in their cycle, and an analysis.

use super::EnsembleSettings;
use super::cycle::{EnsembleCycle, Memory};
use super::fixed_lag::FixedLag;
use super::members::Ensemble;
use super::observed::ObservedEnsemble;
use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Smoother, Views, WidenCalibration};
use crate::calibration_accuracy::{CalibrationAccuracy, CalibrationErrors};
use crate::covariance_column::{CovarianceColumn, JointErrors, Unknown};
use crate::covariance_root::{CovarianceRoot, RootKind};
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::memory::{read, write};
use crate::problem::Problem;
use faer::MatRef;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};

/// What the ensemble methods differ in.
pub(super) trait EnsembleAnalysis: Clone + Send + 'static {
    /// How many numbers the analysis of n observations holds for N members and `earlier` earlier ensembles, beside the members
    /// themselves.
    fn numbers(&self, problem: &Problem<dyn Model>, members: f64, observations: f64, earlier: usize) -> f64;

    /// Updates the ensemble, and the earlier ones of a smoother, by the analysis of at least one observation; returns χ² where
    /// double precision resolves it.
    ///
    /// # Errors
    /// That of an analysis which double precision cannot resolve.
    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error>;
}

/// An ensemble Kalman filter with an analysis: [`EnsembleTransformKalmanFilter`](super::EnsembleTransformKalmanFilter),
/// [`LocalEnsembleTransformKalmanFilter`](super::LocalEnsembleTransformKalmanFilter),
/// [`StochasticEnsembleKalmanFilter`](super::StochasticEnsembleKalmanFilter).
#[derive(Clone)]
pub struct EnsembleFilter<A> {
    pub(super) cycle: EnsembleCycle,
    pub(super) analysis: A,
}

impl<A> EnsembleFilter<A> {
    /// The members.
    pub fn ensemble(&self) -> &Ensemble {
        &self.cycle.memory.ensemble
    }
}

/// A filter with members drawn about the background and `places` places that are analysed separately.
///
/// # Errors
/// As [`Ensemble::draw`]; [`Error::TooLarge`] if the analysis of the most observations does not fit into the memory limit.
pub(super) fn with_analysis<A: EnsembleAnalysis>(
    problem: Problem<dyn Model>,
    settings: EnsembleSettings,
    places: usize,
    analysis: A,
) -> Result<EnsembleFilter<A>, Error> {
    require_memory(&problem, settings.members, &analysis, problem.most_observations, None, false)?;
    Ok(EnsembleFilter { cycle: EnsembleCycle::new(problem, settings, places)?, analysis })
}

/// A filter with a smoother of the last `lag` analyses before the newest.
///
/// # Errors
/// As [`EnsembleCycle::smoothing`]; [`Error::TooLarge`] if their members do not fit into the memory limit.
pub(super) fn with_smoother<A: EnsembleAnalysis>(
    filter: EnsembleFilter<A>,
    lag: usize,
) -> Result<EnsembleFilter<A>, Error> {
    let EnsembleFilter { cycle, analysis } = filter;
    let cycle = cycle.smoothing(lag)?;
    let problem = &cycle.problem;
    require_memory(problem, cycle.settings.members, &analysis, problem.most_observations, Some(lag), false)?;
    Ok(EnsembleFilter { cycle, analysis })
}

/// A filter whose members see observations within a window from their own trajectories at their times, H x_j(t_i): the
/// asynchronous ensemble Kalman filter (Sakov, Evensen and Bertino 2010, Tellus A 62, 24–29). The covariances between what is
/// observed then and the state at the analysis are those of the trajectories, M included, where the first guess at appropriate
/// time alone has them at the analysis. Model errors, which are added at the end of a window, are not in what is seen before.
///
/// A filter that recombines its members at the end of a forecast has no trajectories that end in them, and stays as it is.
///
/// # Errors
/// [`Error::TooLarge`] if the starts of the trajectories do not fit into the memory limit as well.
pub(super) fn with_trajectories<A: EnsembleAnalysis>(filter: EnsembleFilter<A>) -> Result<EnsembleFilter<A>, Error> {
    let EnsembleFilter { mut cycle, analysis } = filter;
    if cycle.recombines() {
        return Ok(EnsembleFilter { cycle, analysis });
    }
    cycle.problem.require_one_rank("trajectories of members through a window")?;
    let (problem, lag) = (&cycle.problem, cycle.memory.smoother.as_ref().map(FixedLag::lag));
    require_memory(problem, cycle.settings.members, &analysis, problem.most_observations, lag, true)?;
    cycle.asynchronous = true;
    Ok(EnsembleFilter { cycle, analysis })
}

/// Fails unless there is memory for the members, their perturbations before and after and the draws of Q; the priors of the
/// biases; what the members make of the observations, with its perturbations as they are and whitened; the analysis; and the
/// ensembles of a smoother of this lag; and, if asynchronous, for the starts of their trajectories.
fn require_memory(
    problem: &Problem<dyn Model>,
    members: usize,
    analysis: &impl EnsembleAnalysis,
    observations: usize,
    lag: Option<usize>,
    asynchronous: bool,
) -> Result<(), Error> {
    let p = problem.estimated_calibration().len();
    let rows = problem.background.values().len() + p;
    let [size, parameters, columns, n] = [rows, p, members, observations].map(|size| size as f64);
    // The newest analysis is kept as well.
    let ensembles = lag.map_or(0.0, |lag| lag as f64 + 1.0) + if asynchronous { 1.0 } else { 0.0 };
    let numbers = (4.0 + ensembles) * size * columns * problem.share()
        + 2.0 * parameters * parameters
        + 3.0 * n * columns
        + analysis.numbers(problem, columns, n, lag.unwrap_or(0));
    problem.require_memory(numbers, || {
        let of_lag = lag.map_or(String::new(), |lag| format!(" and the {lag} earlier analyses of its smoother"));
        format!("an ensemble of {members} members of {rows} unknowns{of_lag} with {observations} observations")
    })
}

impl<A: EnsembleAnalysis> Assimilator for EnsembleFilter<A> {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let EnsembleCycle { problem, settings, memory, asynchronous, starts, .. } = &mut self.cycle;
        *starts = asynchronous.then(|| memory.ensemble.clone());
        memory.ensemble.forecast(problem, settings, window, &mut memory.random)?;
        Ok(Background { estimate: self.cycle.estimate(), window })
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let Self { cycle, analysis } = self;
        let lag = cycle.memory.smoother.as_ref().map(FixedLag::lag);
        require_memory(&cycle.problem, cycle.settings.members, analysis, observed.len(), lag, cycle.asynchronous)?;
        let trajectories = cycle.starts.take().map(|starts| (starts, from.window));
        let members = cycle.memory.ensemble.observe(&cycle.problem, observed, &cycle.bands, trajectories)?;
        if let Some(smoother) = &mut cycle.memory.smoother {
            smoother.shorten();
        }
        let innovation_chi2 = if observed.is_empty() { Some(0.0) } else { analysis.update(cycle, &members)? };
        let Memory { ensemble, smoother, .. } = &mut cycle.memory;
        if let Some(smoother) = smoother {
            smoother.push(ensemble.moments());
        }
        Ok(cycle.analysis(observed, members, innovation_chi2))
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        let EnsembleCycle { memory: Memory { ensemble, variance_factors, random, smoother }, bands, .. } = &self.cycle;
        write(&(variance_factors, random, smoother), to)?;
        ensemble.save(bands, to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let EnsembleCycle { memory, bands, .. } = &self.cycle;
        let (variance_factors, random, smoother) = read(from)?;
        let ensemble = memory.ensemble.read_like(bands, from)?;
        let memory = Memory { ensemble, variance_factors, random, smoother };
        self.cycle.require(&memory)?;
        self.cycle.memory = memory;
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views {
            joint_errors: Some(self),
            // A rank has only its part of a member.
            root: self.cycle.bands.is_whole().then_some(self as &dyn CovarianceRoot),
            calibration: (self.ensemble().parameters() > 0).then_some(self as &dyn CalibrationErrors),
            smoother: self.cycle.memory.smoother.as_ref().map(|_| self as &dyn Smoother),
            ..Views::default()
        }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let estimates = self.ensemble().parameters() > 0;
        Adjustments { calibration: estimates.then_some(CalibrationAdjustment::Widen(self)), error_factor: None }
    }
}

impl<A> JointErrors for EnsembleFilter<A> {
    /// A column of the members' covariance X Xᵀ/(N − 1), without localisation.
    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        let EnsembleCycle { problem, bands, .. } = &self.cycle;
        let m = problem.background.values().len();
        let number = match unknown {
            Unknown::Value(number) => number,
            Unknown::Parameter(number) => m + number,
        };
        let column = self.ensemble().covariance_column(bands, number)?;
        Some(CovarianceColumn::of_augmented(column, m, &problem.calibration))
    }
}

impl<A> CovarianceRoot for EnsembleFilter<A> {
    fn kind(&self) -> RootKind {
        RootKind::Members
    }

    fn columns(&self) -> usize {
        self.ensemble().members()
    }

    fn column(&self, number: usize) -> (Vec<f64>, Vec<f64>) {
        let member = self.ensemble().values().col(number).iter().copied().collect::<Vec<_>>();
        let (state, calibration) = member.split_at(self.cycle.state_values());
        (state.to_vec(), calibration.to_vec())
    }
}

impl<A> CalibrationErrors for EnsembleFilter<A> {
    fn calibration_accuracy(&self) -> CalibrationAccuracy {
        self.ensemble().calibration_accuracy(&self.cycle.bands)
    }
}

impl<A> WidenCalibration for EnsembleFilter<A> {
    /// Adds draws with the covariance to the members' parameters.
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let Memory { ensemble, random, .. } = &mut self.cycle.memory;
        ensemble.widen_calibration(covariance, random);
        Ok(())
    }
}

impl<A> Smoother for EnsembleFilter<A> {
    fn lag(&self) -> usize {
        self.cycle.memory.smoother.as_ref().map_or(0, FixedLag::lag)
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        Ok(self.cycle.smoothed(analyses_ago))
    }
}
