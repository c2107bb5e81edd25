//! A method of kind `time_volume`: its factors, and the models that state-transition corrections lead to.

use super::forecast_model;
use crate::scenario::{Correction, CorrectionSettings, Dynamics, FactorTarget, ModelSettings, Scenario};
use crate::scenario::{TimeVolumeOptions, Wind};
use isobar_assim::fast_kalman::FastKalmanSettings;
use isobar_assim::time_volume::{Candidate, Corrections, Factor, Target, TimeVolume, TimeVolumeSettings};
use isobar_assim::{Error, Problem};
use isobar_model::{Duration, Grid, TangentLinear, check_time_step};
use isobar_obs::Calibration;
use std::sync::Arc;

pub(super) fn build(
    problem: Problem,
    filter: FastKalmanSettings,
    options: &TimeVolumeOptions,
    scenario: &Scenario,
) -> Result<TimeVolume, Error> {
    let settings = TimeVolumeSettings {
        filter,
        cycles: options.window_cycles,
        keep_before: options.keep_before,
        factors: factors(options, &problem.calibration)?,
        start: scenario.start,
        selection_threshold: options.selection_threshold,
    };
    let corrections = (!options.corrections.is_empty()).then(|| {
        let (model, grid) = (scenario.model.clone(), scenario.grid.grid.clone());
        let candidates = options.corrections.iter().map(candidate).collect();
        let kinds = options.corrections.iter().map(|it| it.candidate).collect();
        let (window, background) = (scenario.cycle.window, problem.background.clone());
        Arc::new(ModelCorrections { model, grid, window, background, candidates, kinds }) as Arc<dyn Corrections>
    });
    TimeVolume::new(problem, settings, corrections)
}

/// The factors, with the biases that they act on by number.
pub(super) fn factors(options: &TimeVolumeOptions, calibration: &Calibration) -> Result<Vec<Factor>, Error> {
    let resolve = |name: &String| -> Result<Vec<usize>, Error> {
        let is_meant = |own: &str| own == name || own.strip_prefix(name.as_str()).is_some_and(|it| it.starts_with('/'));
        let all = calibration.parameters.iter().enumerate();
        let found: Vec<usize> = all.filter(|(_, own)| is_meant(&own.name)).map(|(number, _)| number).collect();
        if found.is_empty() {
            let names: Vec<&str> = calibration.parameters.iter().take(20).map(|own| own.name.as_str()).collect();
            let there = if names.is_empty() { "none".to_string() } else { names.join(", ") };
            return Err(Error::Setting(format!(
                "there is no bias `{name}` for a factor to act on; there are: {there}"
            )));
        }
        Ok(found)
    };
    let factor = |own: &crate::scenario::FactorSettings| {
        let target = match &own.target {
            FactorTarget::Variable(number) => Target::Forecast(*number),
            FactorTarget::Biases(names) => {
                let mut numbers = names.iter().map(resolve).collect::<Result<Vec<_>, _>>()?.concat();
                numbers.sort_unstable();
                numbers.dedup();
                Target::Observations(numbers)
            }
        };
        let (name, shape, patterns) = (own.name.clone(), own.shape, own.patterns.clone());
        Ok(Factor { name, target, shape, patterns, evolution: own.evolution })
    };
    options.factors.iter().map(factor).collect()
}

fn candidate(settings: &CorrectionSettings) -> Candidate {
    // Steps that are small changes of any atmosphere, and large against the rounding of a forecast.
    let (name, unit, step) = match settings.candidate {
        Correction::AdvectionX => ("advection_x_m_per_s", "m s-1", 0.1),
        Correction::AdvectionY => ("advection_y_m_per_s", "m s-1", 0.1),
        Correction::MeanDepth => ("mean_depth_m", "m", 1.0),
        Correction::Gravity => ("gravity_m_per_s2", "m s-2", 0.01),
        Correction::Drag => ("drag_per_s", "s-1", 1e-7),
        Correction::Coriolis => ("coriolis_per_s", "s-1", 1e-7),
    };
    Candidate { name: name.into(), unit: unit.into(), step, sigma_prior: settings.sigma }
}

/// The scenario's model with other parameters.
struct ModelCorrections {
    model: ModelSettings,
    grid: Grid,
    window: Duration,
    /// The state for which a corrected model must be stable.
    background: isobar_model::State,
    candidates: Vec<Candidate>,
    kinds: Vec<Correction>,
}

impl Corrections for ModelCorrections {
    fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        let mut model = self.model.clone();
        for (kind, &change) in self.kinds.iter().zip(corrections) {
            let place = match (&mut model.dynamics, kind) {
                (Dynamics::LinearShallowWater { mean_flow_m_per_s, .. }, Correction::AdvectionX) => mean_flow_m_per_s,
                (Dynamics::LinearShallowWater { mean_flow_y_m_per_s, .. }, Correction::AdvectionY) => {
                    mean_flow_y_m_per_s
                }
                (Dynamics::LinearShallowWater { mean_depth_m, .. }, Correction::MeanDepth) => mean_depth_m,
                (Dynamics::Advection { wind: Wind::Uniform { u_m_per_s, .. }, .. }, Correction::AdvectionX) => {
                    u_m_per_s
                }
                (Dynamics::Advection { wind: Wind::Uniform { v_m_per_s, .. }, .. }, Correction::AdvectionY) => {
                    v_m_per_s
                }
                (Dynamics::LinearShallowWater { settings, .. } | Dynamics::ShallowWater(settings), kind) => {
                    match kind {
                        Correction::Gravity => &mut settings.gravity_m_per_s2,
                        Correction::Drag => &mut settings.drag_per_s,
                        Correction::Coriolis => &mut settings.coriolis_per_s,
                        _ => unreachable!("the scenario's reader knows what the model has"),
                    }
                }
                _ => unreachable!("the scenario's reader knows what the model has"),
            };
            *place += change;
        }
        let fault = |error: isobar_model::ModelError| Error::Setting(format!("the corrected model: {error}"));
        let model = forecast_model::build(&model, &self.grid, self.window).map_err(fault)?;
        check_time_step(&*model, &self.background).map_err(fault)?;
        Ok(model)
    }
}
