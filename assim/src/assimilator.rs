//! What a method is: it forecasts an estimate, and analyses observations.

use crate::calibration_accuracy::CalibrationErrors;
use crate::covariance_column::JointErrors;
use crate::covariance_root::CovarianceRoot;
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::estimated::EstimatesParameters;
use crate::structure::BlockStructure;
use faer::MatRef;
use isobar_model::Duration;
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};

/// A data-assimilation method in its cycle.
pub trait Assimilator: Send {
    /// Forecasts over one cycle.
    ///
    /// # Errors
    /// A value that is not finite, or a covariance that is not positive.
    fn forecast(&mut self, window: Duration) -> Result<Background, Error>;

    /// Analyses the observations at the end of a forecast: `from` is what [`Assimilator::forecast`] returned last.
    ///
    /// # Errors
    /// As [`Assimilator::forecast`].
    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error>;

    /// A copy that goes on from here by itself: to ask what an analysis would do, without doing it. It costs as much
    /// memory as what the method carries from cycle to cycle.
    fn boxed_clone(&self) -> Box<dyn Assimilator>;

    /// Everything that the next cycles depend on and that problem and settings do not contain: estimates, covariances,
    /// positions in random streams. What is written says itself where it ends: other things may follow.
    ///
    /// Where several ranks compute a run, all of them call this, and only what rank 0 writes is complete.
    ///
    /// # Errors
    /// [`Error::Memory`].
    fn save(&self, to: &mut dyn Write) -> Result<(), Error>;

    /// Takes over what [`Assimilator::save`] of a method with the same problem and settings has written; the cycles that follow
    /// are then the same to the bit.
    ///
    /// # Errors
    /// [`Error::Memory`] if it does not fit; the method must then not be used any more.
    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error>;

    /// The bytes that [`Assimilator::save`] writes.
    ///
    /// # Errors
    /// As [`Assimilator::save`].
    fn memory(&self) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        self.save(&mut bytes)?;
        Ok(bytes)
    }

    /// What can be asked of the method beside its estimates. No result of a cycle depends on it.
    fn can(&self) -> Views<'_> {
        Views::default()
    }

    /// What can be changed in the method from outside.
    fn adjust(&mut self) -> Adjustments<'_> {
        Adjustments::default()
    }
}

impl Clone for Box<dyn Assimilator> {
    fn clone(&self) -> Self {
        (**self).boxed_clone()
    }
}

/// What a method can be asked, `None` where it has no answer. A decorator passes on the views of the method that it wraps,
/// but for those that it changes.
#[derive(Clone, Copy, Default)]
pub struct Views<'a> {
    /// Covariances of one unknown's error with all others.
    pub joint_errors: Option<&'a dyn JointErrors>,
    /// Members of an ensemble, or common factors.
    pub root: Option<&'a dyn CovarianceRoot>,
    /// How well the calibration is known, of a method that estimates it.
    pub calibration: Option<&'a dyn CalibrationErrors>,
    /// Earlier analyses given later observations.
    pub smoother: Option<&'a dyn Smoother>,
    /// What has been estimated beside state and calibration.
    pub parameters: Option<&'a dyn EstimatesParameters>,
    /// Blocks and common factors.
    pub blocks: Option<&'a dyn BlockStructure>,
}

/// A fixed-lag smoother.
pub trait Smoother {
    /// The number of analyses before the newest that are revised.
    fn lag(&self) -> usize;

    /// State and calibration at the analysis `analyses_ago` before the newest, given all observations so far; `None` if
    /// there was none, or it is beyond the lag. For 0 it is the newest analysis itself.
    ///
    /// # Errors
    /// A covariance that is not positive.
    fn smoothed(&self, analyses_ago: usize) -> Result<Option<Estimate>, Error>;
}

/// What a method lets others change, `None` where it has nothing of the kind.
#[derive(Default)]
pub struct Adjustments<'a> {
    /// The errors of the calibration, of a method that estimates it.
    pub calibration: Option<CalibrationAdjustment<'a>>,
    /// The factor by which the method multiplies, from now on, the covariance that the problem gives it: of the model error
    /// Q for a filter, of the background error B for a method with a static one. It is 1 at the start and no part of
    /// [`Assimilator::memory`].
    pub error_factor: Option<&'a mut f64>,
}

/// What can be done with a method's belief about the calibration.
pub enum CalibrationAdjustment<'a> {
    /// Its errors can be made larger.
    Widen(&'a mut dyn WidenCalibration),
    /// It can be replaced as well.
    Replace(&'a mut dyn ReplaceCalibration),
}

/// A method whose calibration can become less certain.
pub trait WidenCalibration {
    /// Adds an independent error with this covariance, `[p, p]`, to those of the calibration parameters: a sensor that has
    /// been recalibrated is known that much worse, [`Calibrated`](crate::Calibrated).
    ///
    /// # Errors
    /// A covariance that the method cannot represent.
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error>;
}

/// A method that can start from another calibration than the parameters' priors.
pub trait ReplaceCalibration: WidenCalibration {
    /// Takes over a calibration, `[p]` with covariance `[p, p]`, whose errors are independent of the state's, in place of
    /// what the method believed of it.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    ///
    /// # Panics
    /// If the calibration has another number of parameters.
    fn replace_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error>;
}

impl<'a> Adjustments<'a> {
    /// The calibration of a method that can widen its errors.
    pub fn widen(self) -> Option<&'a mut dyn WidenCalibration> {
        Some(match self.calibration? {
            CalibrationAdjustment::Widen(method) => method,
            CalibrationAdjustment::Replace(method) => method,
        })
    }

    /// The calibration of a method that can replace it.
    pub fn replace(self) -> Option<&'a mut dyn ReplaceCalibration> {
        match self.calibration? {
            CalibrationAdjustment::Replace(method) => Some(method),
            CalibrationAdjustment::Widen(_) => None,
        }
    }
}
