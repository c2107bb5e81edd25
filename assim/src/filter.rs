//! The recursion of a Kalman filter, whatever the form in which it keeps the covariance of its errors.

use crate::assimilator::{
    Adjustments, Assimilator, CalibrationAdjustment, ReplaceCalibration, Smoother, Views, WidenCalibration,
};
use crate::augmented::Augmented;
use crate::block_angular::PartitionReport;
use crate::calibration_accuracy::{CalibrationAccuracy, CalibrationErrors};
use crate::covariance_column::{CovarianceColumn, JointErrors, Unknown};
use crate::covariance_root::CovarianceRoot;
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::estimated::{EstimatedParameter, EstimatesParameters};
use crate::fixed_lag::PastAnalyses;
use crate::memory::{read, write};
use crate::problem::{Innovations, Problem, steps};
use crate::structure::{BlockStructure, Structure};
use faer::{Mat, MatRef};
use isobar_model::{Duration, Model, TangentLinear};
use isobar_obs::{Calibration, ObservationWindow};
use std::io::{Read, Write};
use std::sync::Arc;

/// A Kalman filter on the augmented state s = (x, c), where the calibration parameters c are unknowns like the values of
/// the state. `E` is the form of the covariance P of its errors, and what forecast and analysis make of it:
///
/// ```text
/// forecast   x ← M(x), c ← φ c   P ← A P Aᵀ + α Q + drift of c
/// analysis   s ← s + K d       P ← (I − K H) P,      K = P Hᵀ (H P Hᵀ + R)⁻¹,   d = y − h(s)
/// ```
///
/// [`KalmanFilter`](crate::kalman::KalmanFilter), [`BandedKalmanFilter`](crate::banded::BandedKalmanFilter) and
/// [`FastKalmanFilter`](crate::fast_kalman::FastKalmanFilter) are this filter.
#[derive(Clone)]
pub struct Filter<E> {
    pub(crate) problem: Problem<dyn Model>,
    model: Arc<dyn TangentLinear>,
    /// The parameters that are estimated, c.
    pub(crate) calibration: Calibration,
    pub(crate) belief: Belief<E>,
    /// α, by which Q is multiplied.
    error_factor: f64,
}

/// What a filter believes: s and the errors of s.
#[derive(Clone)]
pub(crate) struct Belief<E> {
    pub s: Augmented,
    pub errors: E,
}

/// A form in which the covariance P of the errors of s = (x, c) is kept, `[m + p, m + p]`.
pub(crate) trait Errors: Clone + Send + Sync + 'static {
    /// What changes from cycle to cycle.
    type Memory: Clone;

    /// The name of the covariance, for messages.
    const NAME: &'static str;

    /// x ← M(x), P ← A P Aᵀ + α Q + drift, where A of the parameters is φ, [`Cycle::kept`].
    ///
    /// # Errors
    /// A value that is not finite; a covariance that is not positive definite.
    fn forecast(&mut self, s: &mut Augmented, cycle: &Cycle<'_>) -> Result<(), Error>;

    /// s ← s + K d, P ← (I − K H) P.
    ///
    /// # Errors
    /// A covariance that is not positive definite; an analysis that does not fit into the memory limit.
    fn analyse(&mut self, s: &mut Augmented, d: &Innovations) -> Result<Fit, Error>;

    /// The diagonal of P, `[m + p]`.
    fn variances(&self) -> Vec<f64>;

    /// The part of P that one of the variances belongs to, in words, if P has parts.
    fn part(&self, _number: usize) -> Option<String> {
        None
    }

    /// P h, `[m + p]`.
    fn multiply(&self, h: &[f64]) -> Vec<f64>;

    /// aᵀ P b of vectors with few entries, each given by its number and value, in a space of `size` = m + p.
    fn between(&self, a: &[(usize, f64)], b: &[(usize, f64)], size: usize) -> f64 {
        let mut of_a = vec![0.0; size];
        a.iter().for_each(|&(number, weight)| of_a[number] += weight);
        let image = self.multiply(&of_a);
        b.iter().map(|&(number, weight)| weight * image[number]).sum()
    }

    /// P_cc ← P_cc + ΔP, `[p, p]`.
    fn widen_calibration(&mut self, widening: MatRef<'_, f64>);

    /// P_cc ← a covariance, `[p, p]`; P_xc ← 0.
    ///
    /// # Errors
    /// If the covariance is not positive definite.
    fn replace_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error>;

    /// Writes what changes from cycle to cycle; only what rank 0 writes is complete. Collective.
    ///
    /// # Errors
    /// [`Error::Memory`].
    fn save(&self, to: &mut dyn Write) -> Result<(), Error>;

    /// What [`Errors::save`] has written, as far as this rank has it.
    ///
    /// # Errors
    /// [`Error::Memory`].
    fn read(&self, from: &mut dyn Read) -> Result<Self::Memory, Error>;

    /// Takes over the memory of the same form of the same size, of errors of estimates like `s`.
    ///
    /// # Errors
    /// [`Error::Memory`] if it is of another one.
    fn recall(&mut self, memory: Self::Memory, s: &Augmented) -> Result<(), Error>;

    /// The covariance of (c, x̄), `[p + v, p + v]`, where x̄ are the means of the state's v fields of `cells` values.
    fn calibration_and_means(&self, m: usize, p: usize, cells: usize) -> Mat<f64> {
        let rows = p + m / cells;
        let place = |row: usize| if row < p { (m + row, 1) } else { ((row - p) * cells, cells) };
        let images: Vec<Vec<f64>> = (0..rows)
            .map(|row| {
                let ((first, count), mut h) = (place(row), vec![0.0; m + p]);
                h[first..first + count].fill(1.0 / count as f64);
                self.multiply(&h)
            })
            .collect();
        Mat::from_fn(rows, rows, |i, j| {
            let (first, count) = place(i.max(j));
            images[i.min(j)][first..first + count].iter().sum::<f64>() / count as f64
        })
    }

    /// Fails if the analysis of this number of observations, for a state of `m` values, needs more memory than is allowed.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    fn require_memory(&self, observations: usize, m: usize, limit_bytes: u64) -> Result<(), Error>;

    /// Its smoother, if it has one.
    fn smoother(&self) -> Option<&dyn PastAnalyses> {
        None
    }

    /// Its blocks, if it has any.
    fn blocks(&self) -> Option<&dyn ErrorBlocks> {
        None
    }

    /// Its common factors, if it has any.
    fn root(&self) -> Option<&dyn CovarianceRoot> {
        None
    }

    /// What the last cycle has found out beside s.
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        Vec::new()
    }
}

/// Errors in blocks and common factors.
pub(crate) trait ErrorBlocks {
    /// The structure after the analysis of `observed`, which led to `s`, with at most `factors` common factors.
    fn structure(&self, s: &Augmented, observed: &ObservationWindow, factors: usize) -> Structure;
}

/// What a forecast of errors needs to know.
pub(crate) struct Cycle<'a> {
    pub model: &'a dyn TangentLinear,
    /// The parameters that are estimated, with their drift.
    pub calibration: &'a Calibration,
    pub window: Duration,
    /// Time steps of the window.
    pub steps: usize,
    /// α.
    pub error_factor: f64,
}

impl Cycle<'_> {
    /// The variance that the drift of a parameter adds.
    pub fn drift(&self, parameter: usize) -> f64 {
        self.calibration.parameters[parameter].drift.added_variance(self.window)
    }

    /// φ, what is left of each parameter, `[p]`; `None` if all of them persist.
    pub fn kept(&self) -> Option<Vec<f64>> {
        Some(self.calibration.kept(self.window)).filter(|kept| kept.iter().any(|&kept| kept != 1.0))
    }
}

/// What an analysis found beside s and P.
pub(crate) struct Fit {
    /// dᵀ (H P Hᵀ + R)⁻¹ d.
    pub chi2: f64,
    pub partition: Option<PartitionReport>,
}

impl<E> Filter<E> {
    /// A filter that starts from the background with these errors.
    pub(crate) fn starting_with(problem: Problem<dyn TangentLinear>, errors: E) -> Self {
        let (model, calibration) = (Arc::clone(&problem.model), problem.estimated_calibration());
        let belief = Belief { s: Augmented::background(&problem), errors };
        Self { problem: problem.into(), model, calibration, belief, error_factor: 1.0 }
    }
}

impl<E: Errors> Belief<E> {
    /// The estimate of the state and of these parameters.
    ///
    /// # Errors
    /// [`Error::NegativeVariance`] if P is no longer a covariance.
    pub fn estimate(&self, estimated: &Calibration) -> Result<Estimate, Error> {
        let Augmented { state, bias } = self.s.clone();
        let part = |number| self.errors.part(number);
        Estimate::with_variances(state, bias, estimated, &self.errors.variances(), E::NAME, part)
    }
}

impl<E: Errors> Assimilator for Filter<E> {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let cycle = Cycle {
            model: &*self.model,
            calibration: &self.calibration,
            window,
            steps: steps(&*self.model, window)?,
            error_factor: self.error_factor,
        };
        let Belief { s, errors } = &mut self.belief;
        cycle.kept().iter().for_each(|kept| s.decay(kept));
        errors.forecast(s, &cycle)?;
        Ok(Background { estimate: self.belief.estimate(&self.calibration)?, window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let Belief { s, errors } = &mut self.belief;
        errors.require_memory(observed.len(), s.state.values().len(), self.problem.memory_limit_bytes)?;
        let innovations = self.problem.innovations(observed, &s.state, &s.bias)?;
        let Fit { chi2, partition } = errors.analyse(s, &innovations)?;
        let estimate = self.belief.estimate(&self.calibration)?;
        let analysis = self.problem.resolved_analysis(observed, innovations, estimate, chi2)?;
        Ok(Analysis { partition, ..analysis })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.belief.s, to)?;
        self.belief.errors.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let s: Augmented = read(from)?;
        s.require_like(&self.belief.s)?;
        let Belief { s: own, errors } = &mut self.belief;
        *own = s;
        let memory = errors.read(from)?;
        errors.recall(memory, own)
    }

    fn can(&self) -> Views<'_> {
        let errors = &self.belief.errors;
        // A rank has only its part of a column.
        let is_whole = self.model.in_bands().is_none();
        Views {
            joint_errors: Some(self),
            root: errors.root().filter(|_| is_whole),
            calibration: (!self.calibration.is_empty()).then_some(self),
            smoother: errors.smoother().map(|_| self as &dyn Smoother),
            parameters: Some(self),
            blocks: errors.blocks().map(|_| self as &dyn BlockStructure),
        }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let Self { belief, error_factor, calibration, .. } = self;
        Adjustments {
            calibration: (!calibration.is_empty()).then_some(CalibrationAdjustment::Replace(belief)),
            error_factor: Some(error_factor),
        }
    }
}

impl<E: Errors> WidenCalibration for Belief<E> {
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.errors.widen_calibration(covariance);
        Ok(())
    }
}

impl<E: Errors> ReplaceCalibration for Belief<E> {
    fn replace_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        self.s.bias.copy_from_slice(estimate);
        self.errors.replace_calibration(covariance)
    }
}

/// A combination of unknowns by their numbers in (x, c), of m values and p parameters; `None` if it is empty, or one of them is
/// not estimated.
fn numbered(combination: &[(Unknown, f64)], m: usize, p: usize) -> Option<Vec<(usize, f64)>> {
    let place = |&(unknown, weight): &(Unknown, f64)| match unknown {
        Unknown::Value(number) => (number < m).then_some((number, weight)),
        Unknown::Parameter(number) => (number < p).then_some((m + number, weight)),
    };
    let numbered: Option<Vec<(usize, f64)>> = combination.iter().map(place).collect();
    numbered.filter(|entries| !entries.is_empty())
}

impl<E: Errors> JointErrors for Filter<E> {
    fn covariance_column(&self, unknown: Unknown) -> Option<CovarianceColumn> {
        self.covariance_with(&[(unknown, 1.0)])
    }

    fn covariance_with(&self, combination: &[(Unknown, f64)]) -> Option<CovarianceColumn> {
        let (m, p) = (self.belief.s.state.values().len(), self.calibration.len());
        let mut h = vec![0.0; m + p];
        numbered(combination, m, p)?.into_iter().for_each(|(number, weight)| h[number] += weight);
        Some(CovarianceColumn::of_augmented(self.belief.errors.multiply(&h), m, &self.problem.calibration))
    }

    fn covariance_between(&self, a: &[(Unknown, f64)], b: &[(Unknown, f64)]) -> Option<f64> {
        let (m, p) = (self.belief.s.state.values().len(), self.calibration.len());
        Some(self.belief.errors.between(&numbered(a, m, p)?, &numbered(b, m, p)?, m + p))
    }
}

impl<E: Errors> CalibrationErrors for Filter<E> {
    fn calibration_accuracy(&self) -> CalibrationAccuracy {
        let (state, p) = (&self.belief.s.state, self.calibration.len());
        let cells = state.layout().grid.cells();
        CalibrationAccuracy::new(self.belief.errors.calibration_and_means(state.values().len(), p, cells), p)
    }
}

impl<E: Errors> Smoother for Filter<E> {
    fn lag(&self) -> usize {
        self.belief.errors.smoother().map_or(0, PastAnalyses::lag)
    }

    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error> {
        let past = self.belief.errors.smoother().and_then(|smoother| smoother.estimate(analyses_ago));
        let estimate = past.map(|(Augmented { state, bias }, variances)| {
            let covariance = "the covariance of a smoothed estimate";
            Estimate::with_variances(state.clone(), bias.clone(), &self.calibration, variances, covariance, |_| None)
        });
        estimate.transpose()
    }
}

impl<E: Errors> EstimatesParameters for Filter<E> {
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        self.belief.errors.estimated_parameters()
    }
}

impl<E: Errors> BlockStructure for Filter<E> {
    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Structure {
        let blocks = self.belief.errors.blocks().expect("only a filter with blocks offers this view");
        blocks.structure(&self.belief.s, observed, factors)
    }
}
