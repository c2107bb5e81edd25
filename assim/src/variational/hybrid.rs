//! Hybrid 3D-Var: the covariance of an ensemble beside the static one.

use super::three_d_var::check_memory;
use super::{ThreeDVar, ThreeDVarSettings};
use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Views, WidenCalibration};
use crate::covariance::{Covariance, LocalizedEnsemble};
use crate::ensemble::{EnsembleSettings, LocalEnsembleTransformKalmanFilter, LocalSettings};
use crate::error::Error;
use crate::estimate::{Analysis, Background, Estimate};
use crate::problem::Problem;
use faer::MatRef;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};
use std::sync::Arc;

/// How hybrid 3D-Var is tuned.
#[derive(Clone, Debug, PartialEq)]
pub struct HybridSettings {
    /// w in [0, 1], the weight of the ensemble's covariance; the static one has 1 − w.
    pub ensemble_weight: f64,
    /// Of the variational analysis, with the factor on the static covariance.
    pub variational: ThreeDVarSettings,
    /// Of the members.
    pub ensemble: EnsembleSettings,
    /// Their localisation: in the analysis that updates them, and of their covariance.
    pub local: LocalSettings,
}

/// 3D-Var with `B = (1 − w) s B_static + w ρ ∘ P_ensemble` (Hamill and Snyder 2000; Lorenc 2003). The members are updated by
/// a local ensemble transform Kalman filter, and shifted to have the variational analysis as their mean. The static part
/// covers the directions that the members do not know, the ensemble's the flow of the day.
#[derive(Clone)]
pub struct HybridThreeDVar {
    settings: HybridSettings,
    static_error: Arc<dyn Covariance>,
    variational: ThreeDVar,
    ensemble: LocalEnsembleTransformKalmanFilter,
}

/// (1 − w) s B + w ρ ∘ P.
struct HybridCovariance {
    static_part: Arc<dyn Covariance>,
    static_root: f64,
    ensemble: LocalizedEnsemble,
    ensemble_root: f64,
}

impl HybridThreeDVar {
    /// Hybrid 3D-Var from the background.
    ///
    /// # Errors
    /// [`Error::Setting`] for a weight outside \[0, 1\]; those of the ensemble; [`Error::TooLarge`] if the control vectors do
    /// not fit into the memory limit.
    pub fn new(problem: impl Into<Problem<dyn Model>>, settings: HybridSettings) -> Result<Self, Error> {
        let problem = problem.into();
        if !(0.0..=1.0).contains(&settings.ensemble_weight) {
            return Err(Error::Setting(format!("an ensemble weight of {} is not in [0, 1]", settings.ensemble_weight)));
        }
        let (grid, radius_m) = (&problem.background.layout().grid, settings.local.localization_radius_m);
        let of_ensemble = LocalizedEnsemble::control_len_of(grid, settings.ensemble.members, radius_m)?;
        let controls = problem.background_error.control_len() + of_ensemble;
        check_memory(&problem, controls, problem.most_observations)?;
        let ensemble = LocalEnsembleTransformKalmanFilter::new(problem.clone(), settings.ensemble, settings.local)?;
        let static_error = Arc::clone(&problem.background_error);
        let own = ThreeDVarSettings { covariance_scale: 1.0, ..settings.variational.clone() };
        Ok(Self { variational: ThreeDVar::new(problem, own)?, static_error, ensemble, settings })
    }

    /// The variational estimate with the spread of the members.
    fn with_spread(&self, estimate: Estimate) -> Estimate {
        Estimate { state_spread: self.ensemble.estimate().state_spread, ..estimate }
    }
}

impl Assimilator for HybridThreeDVar {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.ensemble.forecast(window)?;
        let Background { estimate, .. } = self.variational.forecast(window)?;
        Ok(Background { estimate: self.with_spread(estimate), window })
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let weight = self.settings.ensemble_weight;
        self.variational.set_background_error(Arc::new(HybridCovariance {
            static_part: Arc::clone(&self.static_error),
            static_root: ((1.0 - weight) * self.settings.variational.covariance_scale).sqrt(),
            ensemble: self.ensemble.state_covariance(self.settings.local.localization_radius_m)?,
            ensemble_root: weight.sqrt(),
        }));
        let analysis = self.variational.analyse(from, observed)?;
        self.ensemble.analyse(from, observed)?;
        self.ensemble.shift_to(&analysis.estimate);
        Ok(Analysis { estimate: self.with_spread(analysis.estimate), ..analysis })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        self.variational.save(to)?;
        self.ensemble.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        self.variational.recall(from)?;
        self.ensemble.recall(from)
    }

    fn can(&self) -> Views<'_> {
        let Views { joint_errors, root, .. } = self.ensemble.can();
        Views { joint_errors, root, ..self.variational.can() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let estimates = self.can().calibration.is_some();
        Adjustments { calibration: estimates.then_some(CalibrationAdjustment::Widen(self)), error_factor: None }
    }
}

impl WidenCalibration for HybridThreeDVar {
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let parts: [&mut dyn Assimilator; 2] = [&mut self.ensemble, &mut self.variational];
        for part in parts {
            if let Some(calibration) = part.adjust().widen() {
                calibration.widen_calibration(covariance)?;
            }
        }
        Ok(())
    }
}

impl Covariance for HybridCovariance {
    fn len(&self) -> usize {
        self.static_part.len()
    }

    fn control_len(&self) -> usize {
        self.static_part.control_len() + self.ensemble.control_len()
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        let (static_control, ensemble_control) = control.split_at(self.static_part.control_len());
        let scaled = |values: &[f64], factor: f64| values.iter().map(|value| factor * value).collect::<Vec<_>>();
        self.static_part.root_add(&scaled(static_control, self.static_root), increment);
        self.ensemble.root_add(&scaled(ensemble_control, self.ensemble_root), increment);
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        let (static_control, ensemble_control) = control.split_at_mut(self.static_part.control_len());
        let scaled = |factor: f64| increment.iter().map(|value| factor * value).collect::<Vec<_>>();
        self.static_part.root_transpose_add(&scaled(self.static_root), static_control);
        self.ensemble.root_transpose_add(&scaled(self.ensemble_root), ensemble_control);
    }
}
