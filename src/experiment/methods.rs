//! `[methods.NAME]` as methods.

use super::forecast_model;
use crate::scenario::{Algorithm, Method, Scenario};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, Residual};
use isobar_assim::free::FreeRun;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::serial_kalman::SerialKalmanFilter;
use isobar_assim::variational::ThreeDVar;
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem};

pub(super) fn build(ground: &Problem, method: &Method, scenario: &Scenario) -> Result<Box<dyn Assimilator>, Error> {
    let mut problem = Problem { bias: method.bias, ..ground.clone() };
    Ok(match method.algorithm {
        Algorithm::Free => Box::new(FreeRun::new(problem)),
        Algorithm::ThreeDVar(ref settings) => Box::new(ThreeDVar::new(problem, settings.clone())),
        Algorithm::Kalman { memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(KalmanFilter::new(problem)?)
        }
        Algorithm::SerialKalman { memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(SerialKalmanFilter::new(problem)?)
        }
        Algorithm::FastKalman { settings, factor_grid, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            if factor_grid == 1 {
                return Ok(Box::new(FastKalmanFilter::new(problem, settings)?));
            }
            let model = forecast_model::build_coarser(scenario, factor_grid)?;
            Box::new(FastKalmanFilter::new(problem, settings)?.with_factors_on(model)?)
        }
    })
}

/// Whether a method does anything with observations.
pub(super) fn sees_observations(method: &Method) -> bool {
    method.algorithm != Algorithm::Free
}

/// A method's settings, in words.
pub(super) fn describe(method: &Method) -> String {
    let bias = match method.bias {
        BiasTreatment::Estimate => "biases estimated",
        BiasTreatment::Ignore => "biases ignored",
        BiasTreatment::Known => "biases known",
    };
    match &method.algorithm {
        Algorithm::Free => "no assimilation".to_string(),
        Algorithm::ThreeDVar(settings) => format!("3D-Var, B × {}, {bias}", settings.covariance_scale),
        Algorithm::Kalman { .. } => format!("Kalman filter, {bias}"),
        Algorithm::SerialKalman { .. } => format!("Kalman filter, one observation at a time, {bias}"),
        Algorithm::FastKalman { settings, factor_grid, .. } => {
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
                    format!(
                        "up to {} common factors, which hold {} % of their energy",
                        settings.factors,
                        100.0 * retained
                    )
                }
                _ => format!("{} common factors", settings.factors),
            };
            if *factor_grid > 1 {
                factors += &format!(" on a grid {factor_grid} times as wide");
            }
            format!(
                "Fast Kalman Filter, {factors}, {blocks} {residual}, covariance with biases {coupling}, \
                 {bias}"
            )
        }
    }
}
