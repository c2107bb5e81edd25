//! `[methods.NAME]` as methods.

use crate::scenario::{Algorithm, BiasCoupling, Blocks, Method};
use isobar_assim::fast_kalman::{self, BlockShape, FastKalmanFilter, FastKalmanSettings};
use isobar_assim::free::FreeRun;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::variational::{ThreeDVar, ThreeDVarSettings};
use isobar_assim::{Assimilator, BiasTreatment, Error, Problem};

pub(super) fn build(ground: &Problem, method: &Method) -> Result<Box<dyn Assimilator>, Error> {
    let mut problem = Problem { bias: method.bias, ..ground.clone() };
    Ok(match method.algorithm {
        Algorithm::Free => Box::new(FreeRun::new(problem)),
        Algorithm::ThreeDVar { covariance_scale, max_iterations, tolerance } => {
            Box::new(ThreeDVar::new(problem, ThreeDVarSettings { covariance_scale, tolerance, max_iterations }))
        }
        Algorithm::Kalman { memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            Box::new(KalmanFilter::new(problem)?)
        }
        Algorithm::FastKalman { blocks, bias_coupling, memory_limit_bytes } => {
            problem.memory_limit_bytes = memory_limit_bytes;
            let blocks = match blocks {
                Blocks::Cell => BlockShape::Cell,
                Blocks::Tile { nx, ny } => BlockShape::Tile { nx, ny },
                Blocks::Domain => BlockShape::Domain,
            };
            let bias_coupling = match bias_coupling {
                BiasCoupling::Carry => fast_kalman::BiasCoupling::Carry,
                BiasCoupling::Drop => fast_kalman::BiasCoupling::Drop,
            };
            Box::new(FastKalmanFilter::new(problem, FastKalmanSettings { blocks, bias_coupling })?)
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
    match method.algorithm {
        Algorithm::Free => "no assimilation".to_string(),
        Algorithm::ThreeDVar { covariance_scale, .. } => format!("3D-Var, B × {covariance_scale}, {bias}"),
        Algorithm::Kalman { .. } => format!("Kalman filter, {bias}"),
        Algorithm::FastKalman { blocks, bias_coupling, .. } => {
            let blocks = match blocks {
                Blocks::Cell => "blocks of one cell".to_string(),
                Blocks::Tile { nx, ny } => format!("blocks of {nx} × {ny} cells"),
                Blocks::Domain => "one block".to_string(),
            };
            let coupling = match bias_coupling {
                BiasCoupling::Carry => "carried",
                BiasCoupling::Drop => "dropped",
            };
            format!("Fast Kalman Filter, {blocks}, covariance with biases {coupling}, {bias}")
        }
    }
}
