//! `[methods.NAME]` as methods.

use super::{forecast_model, time_volume};
use crate::scenario::{Algorithm, Method, Scenario};
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::climatology::Climatology;
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, InitialMembers,
    LocalEnsembleTransformKalmanFilter, ModelErrorTreatment, StochasticEnsembleKalmanFilter,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::federated::FederatedKalmanFilter;
use isobar_assim::free::FreeRun;
use isobar_assim::high_pass::HighPassSettings;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::variational::{FourDVar, HybridThreeDVar, ThreeDVar};
use isobar_assim::{
    AdaptedCovariance, Adaptive, AdaptiveSettings, Assimilator, BiasTreatment, Error, Initialised, Problem,
};
use std::sync::Arc;

pub(super) fn build(ground: &Problem, method: &Method, scenario: &Scenario) -> Result<Box<dyn Assimilator>, Error> {
    let mut problem = Problem { bias: method.bias, ..ground.clone() };
    Ok(match method.algorithm {
        Algorithm::Free => Box::new(FreeRun::new(problem)),
        Algorithm::Climatology => Box::new(Climatology::new(problem)),
        Algorithm::OptimalInterpolation { covariance_scale } => {
            Box::new(OptimalInterpolation::new(problem, covariance_scale))
        }
        Algorithm::FourDVar(ref settings) => Box::new(FourDVar::new(problem, settings.clone())?),
        Algorithm::HybridThreeDVar { ref settings, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(HybridThreeDVar::new(problem, settings.clone())?)
        }
        Algorithm::ThreeDVar(ref settings) => Box::new(ThreeDVar::new(problem, settings.clone())),
        Algorithm::Kalman { smoother_lag_cycles, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(smoothing(KalmanFilter::new(problem)?, smoother_lag_cycles, KalmanFilter::smoothing)?)
        }
        Algorithm::SerialKalman { smoother_lag_cycles, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(smoothing(KalmanFilter::serial(problem)?, smoother_lag_cycles, KalmanFilter::smoothing)?)
        }
        Algorithm::BandedKalman { half_bandwidth, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(BandedKalmanFilter::new(problem, half_bandwidth)?)
        }
        Algorithm::FederatedKalman { ref settings, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(FederatedKalmanFilter::new(problem, settings.clone())?)
        }
        Algorithm::FastKalman { settings, factor_grid, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            if factor_grid == 1 {
                return Ok(Box::new(FastKalmanFilter::new(problem, settings)?));
            }
            let model = forecast_model::build_coarser(scenario, factor_grid)?;
            Box::new(FastKalmanFilter::new(problem, settings)?.with_factors_on(model)?)
        }
        Algorithm::TimeVolume { settings, ref options, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(time_volume::build(problem, settings, options, scenario)?)
        }
        Algorithm::EnsembleTransform { settings, smoother_lag_cycles, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            let filter = EnsembleTransformKalmanFilter::new(problem, settings)?;
            Box::new(smoothing(filter, smoother_lag_cycles, EnsembleTransformKalmanFilter::smoothing)?)
        }
        Algorithm::LocalEnsembleTransform { settings, local, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(LocalEnsembleTransformKalmanFilter::new(problem, settings, local)?)
        }
        Algorithm::StochasticEnsemble { settings, localization_radius_m, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(StochasticEnsembleKalmanFilter::new(problem, settings, localization_radius_m)?)
        }
    })
}

/// The method, with factors on its errors' covariances if the scenario says so.
pub(super) fn adapted(
    method: Box<dyn Assimilator>,
    name: &str,
    ground: &Problem,
    scenario: &Scenario,
) -> Result<Box<dyn Assimilator>, Error> {
    let Method { adapt, algorithm, .. } = &scenario.methods[name];
    let Some(adapt) = adapt else { return Ok(method) };
    let background = |scale: f64| AdaptedCovariance {
        name: "background_error",
        covariance: Arc::clone(&ground.background_error),
        scale,
    };
    let covariance = match algorithm {
        Algorithm::OptimalInterpolation { covariance_scale } => Some(background(*covariance_scale)),
        Algorithm::ThreeDVar(settings) => Some(background(settings.covariance_scale)),
        _ => {
            let model_error = ground.model_error.clone();
            model_error.map(|covariance| AdaptedCovariance { name: "model_error", covariance, scale: 1.0 })
        }
    };
    let settings = AdaptiveSettings {
        observation_error: adapt.observation_error,
        state_error: covariance.filter(|_| adapt.state_error),
        memory_cycles: adapt.memory_cycles,
    };
    Ok(Box::new(Adaptive::new(method, ground.background.layout().clone(), settings)?))
}

/// The method as it starts: from its first observations if the scenario says so.
pub(super) fn initialised(
    method: Box<dyn Assimilator>,
    name: &str,
    ground: &Problem,
    scenario: &Scenario,
) -> Result<Box<dyn Assimilator>, Error> {
    Ok(match initialisation(name, scenario) {
        Some(high_pass) => Box::new(Initialised::new(method, ground.clone(), high_pass)?),
        None => method,
    })
}

/// How the method of this name is initialised from its first observations, if it is.
fn initialisation(name: &str, scenario: &Scenario) -> Option<HighPassSettings> {
    let initialise = scenario.initialise.as_ref()?;
    initialise.methods.iter().any(|it| it == name).then_some(initialise.high_pass)
}

/// The method with its smoother, if it has one.
fn smoothing<M>(method: M, lag: Option<usize>, add: impl FnOnce(M, usize) -> Result<M, Error>) -> Result<M, Error> {
    match lag {
        Some(lag) => add(method, lag),
        None => Ok(method),
    }
}

/// Whether a method does anything with observations.
pub(super) fn sees_observations(method: &Method) -> bool {
    !matches!(method.algorithm, Algorithm::Free | Algorithm::Climatology)
}

/// A method's settings, in words.
pub(super) fn describe(method: &Method, name: &str, scenario: &Scenario) -> String {
    let mut own = describe_alone(method);
    if let Some(adapt) = &method.adapt {
        let is_static =
            matches!(method.algorithm, Algorithm::OptimalInterpolation { .. } | Algorithm::ThreeDVar { .. });
        let errors = match (adapt.observation_error, adapt.state_error, is_static) {
            (true, true, true) => "observation and background errors",
            (true, true, false) => "observation and model errors",
            (true, false, _) => "observation errors",
            (false, _, true) => "background errors",
            (false, _, false) => "model errors",
        };
        own += &format!(", {errors} adapted to the innovations of {} cycles", adapt.memory_cycles);
    }
    match initialisation(name, scenario) {
        Some(settings) => {
            format!("{own}, calibration initialised from {} cycles by a high-pass filter", settings.cycles)
        }
        None => own,
    }
}

fn describe_alone(method: &Method) -> String {
    let bias = match method.bias {
        BiasTreatment::Estimate => "biases estimated",
        BiasTreatment::Ignore => "biases ignored",
        BiasTreatment::Known => "biases known",
    };
    match &method.algorithm {
        Algorithm::Free => "no assimilation".to_string(),
        Algorithm::Climatology => "the first background for ever".to_string(),
        Algorithm::OptimalInterpolation { covariance_scale } => {
            format!("optimal interpolation, B × {covariance_scale}, {bias}")
        }
        Algorithm::FourDVar(settings) => format!(
            "4D-Var over {} cycles, {} outer {}, B × {}, {bias}",
            settings.window_cycles,
            settings.outer_loops,
            if settings.outer_loops == 1 { "loop" } else { "loops" },
            settings.covariance_scale
        ),
        Algorithm::HybridThreeDVar { settings, .. } => format!(
            "hybrid 3D-Var, B × {}, an ensemble with weight {}, {} localised within {} km, {bias}",
            settings.variational.covariance_scale,
            settings.ensemble_weight,
            describe_ensemble(&settings.ensemble),
            settings.local.localization_radius_m / 1e3
        ),
        Algorithm::ThreeDVar(settings) => format!("3D-Var, B × {}, {bias}", settings.covariance_scale),
        Algorithm::Kalman { smoother_lag_cycles, .. } => {
            format!("Kalman filter{}, {bias}", describe_smoother(*smoother_lag_cycles))
        }
        Algorithm::SerialKalman { smoother_lag_cycles, .. } => {
            format!("Kalman filter, one observation at a time{}, {bias}", describe_smoother(*smoother_lag_cycles))
        }
        Algorithm::BandedKalman { half_bandwidth, .. } => {
            format!("Kalman filter, {half_bandwidth} diagonals on either side of the covariance's main one, {bias}")
        }
        Algorithm::FederatedKalman { settings, .. } => {
            let reset = match settings.reset_every_cycles {
                None => "never reset".to_string(),
                Some(1) => "reset in every cycle".to_string(),
                Some(cycles) => format!("reset every {cycles} cycles"),
            };
            let shares = settings.systems.iter().map(|(name, share)| format!("{name} {share:.3}"));
            let shares = shares.collect::<Vec<_>>().join(", ");
            format!("federated Kalman filter, information shared as {shares}, {reset}, {bias}")
        }
        Algorithm::FastKalman { settings, factor_grid, .. } => {
            format!("Fast Kalman Filter, {}, {bias}", describe_filter(settings, *factor_grid))
        }
        Algorithm::TimeVolume { settings, options, .. } => format!(
            "moving time volume of {} cycles, {} factors of observations and model, {} candidates of transition, {}",
            options.window_cycles,
            options.factors.len(),
            options.corrections.len(),
            describe_filter(settings, 1)
        ),
        Algorithm::EnsembleTransform { settings, smoother_lag_cycles, .. } => {
            format!("ETKF{}, {}, {bias}", describe_smoother(*smoother_lag_cycles), describe_ensemble(settings))
        }
        Algorithm::LocalEnsembleTransform { settings, local, .. } => {
            let radius = local.localization_radius_m / 1e3;
            format!("LETKF, localised within {radius} km, {}, {bias}", describe_ensemble(settings))
        }
        Algorithm::StochasticEnsemble { settings, localization_radius_m, .. } => {
            let localization = match localization_radius_m.is_finite() {
                true => format!("localised within {} km", localization_radius_m / 1e3),
                false => "not localised".to_string(),
            };
            format!("stochastic EnKF, {localization}, {}, {bias}", describe_ensemble(settings))
        }
    }
}

/// A Fast Kalman Filter's settings, in words.
fn describe_filter(settings: &FastKalmanSettings, factor_grid: usize) -> String {
    let blocks = match settings.blocks {
        BlockShape::Cell => "blocks of one cell".to_string(),
        BlockShape::Tile { nx, ny } => format!("blocks of {nx} × {ny} cells"),
        BlockShape::Domain => "one block".to_string(),
    };
    let residual = match settings.residual {
        Residual::Exact => "forecast exactly".to_string(),
        Residual::Persist => "that persist".to_string(),
        Residual::Probe { count } => format!("forecast by {count} probes"),
    };
    let coupling = match settings.bias_coupling {
        BiasCoupling::Carry => "carried",
        BiasCoupling::Drop => "dropped",
    };
    let mut factors = match settings.retained_energy {
        retained if retained < 1.0 => {
            format!("up to {} common factors, which hold {} % of their energy", settings.factors, 100.0 * retained)
        }
        _ => format!("{} common factors", settings.factors),
    };
    if settings.factor_precision == Precision::Single {
        factors += " in single precision";
    }
    if factor_grid > 1 {
        factors += &format!(" on a grid {factor_grid} times as wide");
    }
    format!("{factors}, {blocks} {residual}, covariance with biases {coupling}")
}

/// A smoother, in words; nothing if there is none.
fn describe_smoother(lag_cycles: Option<usize>) -> String {
    lag_cycles.map_or_else(String::new, |lag| format!(" with a smoother of lag {lag} cycles"))
}

/// An ensemble's settings, in words.
fn describe_ensemble(settings: &EnsembleSettings) -> String {
    let mut words = format!("{} members", settings.members);
    if settings.initial_members == InitialMembers::SecondOrderExact {
        words.push_str(" drawn second-order exact");
    }
    if settings.model_error == ModelErrorTreatment::SquareRoot {
        words.push_str(", model error by square root");
    }
    let inflation = &settings.inflation;
    match inflation.background {
        BackgroundInflation::Factor(1.0) => {}
        BackgroundInflation::Factor(factor) => words.push_str(&format!(", inflation {factor}")),
        BackgroundInflation::Adaptive { .. } => words.push_str(", adaptive inflation"),
    }
    for (name, value) in
        [("RTPS", inflation.relaxation_to_prior_spread), ("RTPP", inflation.relaxation_to_prior_perturbations)]
    {
        if value > 0.0 {
            words.push_str(&format!(", {name} {value}"));
        }
    }
    words
}
