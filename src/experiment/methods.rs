//! `[methods.NAME]` as methods.

use crate::scenario::{Algorithm, Method};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, Residual};
use isobar_assim::free::FreeRun;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::variational::ThreeDVar;
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem};

pub(super) fn build(ground: &Problem, method: &Method) -> Result<Box<dyn Assimilator>, Error> {
    let mut problem = Problem { bias: method.bias, ..ground.clone() };
    Ok(match method.algorithm {
        Algorithm::Free => Box::new(FreeRun::new(problem)),
        Algorithm::ThreeDVar(ref settings) => Box::new(ThreeDVar::new(problem, settings.clone())),
        Algorithm::Kalman { memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(KalmanFilter::new(problem)?)
        }
        Algorithm::FastKalman { settings, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(FastKalmanFilter::new(problem, settings)?)
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
        Algorithm::FastKalman { settings, .. } => {
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
            let factors = match settings.retained_energy {
                retained if retained < 1.0 => {
                    format!(
                        "up to {} common factors, which hold {} % of their energy",
                        settings.factors,
                        100.0 * retained
                    )
                }
                _ => format!("{} common factors", settings.factors),
            };
            format!(
                "Fast Kalman Filter, {factors}, {blocks} {residual}, covariance with biases {coupling}, \
                 {bias}"
            )
        }
    }
}
