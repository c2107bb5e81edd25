//! The normal distribution, and how far a normal forecast is from what came.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Φ(z), the probability of a standard normal variable to be below z.
pub fn probability_below(z: f64) -> f64 {
    0.5 * libm::erfc(-z * FRAC_1_SQRT_2)
}

/// The continuous ranked probability score of the forecast N(μ, σ²), from its error e = μ − x:
///
/// ```text
/// CRPS = σ { z [2 Φ(z) − 1] + 2 φ(z) − 1/√π },     z = e/σ
/// ```
///
/// (Gneiting, Raftery, Westveld and Goldman 2005, Mon. Wea. Rev. 133, eq. 5). It is in the unit of x; the less the better;
/// of a forecast without a spread (σ = 0) it is the absolute error. If x ~ N(μ, σ²), it is σ/√π on average.
pub fn crps(error: f64, sigma: f64) -> f64 {
    if sigma <= 0.0 {
        return error.abs();
    }
    let z = error / sigma;
    let density = (-0.5 * z * z).exp() / TAU.sqrt();
    sigma * (z * (2.0 * probability_below(z) - 1.0) + 2.0 * density - 1.0 / PI.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ (F(y) − [y ≥ x])² dy, its definition.
    fn by_quadrature(error: f64, sigma: f64) -> f64 {
        let (steps, reach) = (400_000, 12.0 * sigma + error.abs());
        let width = 2.0 * reach / f64::from(steps);
        let term = |step| {
            let y = (f64::from(step) + 0.5) * width - reach;
            let step = if y >= -error { 1.0 } else { 0.0 };
            (probability_below(y / sigma) - step).powi(2)
        };
        (0..steps).map(term).sum::<f64>() * width
    }

    #[test]
    fn the_closed_form_is_the_integral() {
        for (error, sigma) in [(0.0, 1.0), (0.7, 1.0), (-3.0, 0.5), (0.2, 4.0)] {
            let (found, expected) = (crps(error, sigma), by_quadrature(error, sigma));
            assert!((found - expected).abs() < 1e-4 * sigma, "{error}, {sigma}: {found} and {expected}");
        }
        assert!((crps(0.0, 1.0) - (2f64.sqrt() - 1.0) / PI.sqrt()).abs() < 1e-15);
        assert_eq!(crps(-2.5, 0.0), 2.5);
        assert!((crps(2.5, 1e-9) - 2.5).abs() < 1e-8, "no spread is the limit of little");
    }

    #[test]
    fn probabilities_are_those_of_the_tables() {
        for (z, expected) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.959_963_985, 0.025), (-6.0, 9.865_876_45e-10)] {
            assert!((probability_below(z) / expected - 1.0).abs() < 1e-8, "{z}");
        }
    }
}
