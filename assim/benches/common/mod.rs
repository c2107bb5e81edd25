//! What the benchmarks of shallow water have in common.

use isobar_assim::covariance::{Balanced, BalancedParameters, Covariance, Sum, White};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanSettings, Precision, Residual};
use isobar_model::Layout;
use std::sync::Arc;

pub const PROBES: usize = 8;

/// Balanced errors and white ones.
pub fn covariance(layout: &Layout, sigma_height_m: f64, length_m: f64, white: f64) -> Arc<dyn Covariance> {
    let parameters = BalancedParameters {
        sigma_height_m,
        length_m,
        gravity_m_per_s2: 9.8,
        coriolis_per_s: 1e-4,
        beta_per_m_per_s: 0.0,
        balanced_at_walls: false,
    };
    let mut terms: Vec<Box<dyn Covariance>> = vec![Box::new(Balanced::new(layout, &parameters).expect("rotation"))];
    for (variable, factor) in [(0, 1.0), (1, 0.1), (2, 0.1)] {
        terms.push(Box::new(White::new(layout, variable, factor * white)));
    }
    Arc::new(Sum::new(layout.len(), terms))
}

/// Blocks of a cell beside common factors.
pub fn with_factors(factors: usize) -> FastKalmanSettings {
    FastKalmanSettings {
        blocks: BlockShape::Cell,
        bias_coupling: BiasCoupling::Carry,
        factors,
        residual: Residual::Probe { count: PROBES },
        retained_energy: 1.0,
        largest_component: 500,
        separator_factors: 0,
        factor_precision: Precision::Double,
    }
}

/// A small value for the number of an entry of increments.
pub fn small(index: usize) -> f64 {
    1e-3 * ((index % 1013) as f64 / 1013.0 - 0.5)
}
