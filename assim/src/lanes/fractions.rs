//! The inverse square root as a sum of simple fractions.

use std::f64::consts::PI;

/// The greatest relative error of the approximations, but for rounding.
const TOLERANCE: f64 = 1e-14;

/// Positive numbers with
///
/// ```text
/// x^-½ = Σ_j ω_j / (x + σ_j),    (x + x^½)⁻¹ = Σ_j ω_j / (1 + σ_j) / (x + σ_j),    1 ≤ x ≤ κ
/// ```
///
/// to a relative error ε for the first, and ε/(x − 1) for the second, which is (1 − x^-½)/(x − 1); ε is 10⁻¹⁴ beside the
/// rounding of σ and ω, with which it reaches 10⁻¹³ for κ = 10⁹.
///
/// They are the trapezoidal rule for x^-½ = 2/π ∫₀^∞ dt/(x + t²) after t = sc(u | 1 − 1/κ), in which the integrand is periodic
/// and analytic, so that the error falls exponentially (Hale, Higham and Trefethen 2008, SIAM J. Numer. Anal. 46, 2505–2523,
/// method 3); these are the poles of Zolotarev's best approximation (van den Eshof et al. 2002, Comput. Phys. Commun. 146,
/// 203–224):
///
/// ```text
/// σ_j = τ_j²,    τ_j = sc((2j − 1) K/2n),    ω_j = 2K/πn √((1 + τ_j²)(1 + τ_j²/κ)),    error ≈ 2 exp(−2πn K'/K)
/// ```
///
/// with the complete elliptic integrals K of the modulus √(1 − 1/κ) and K' of 1/√κ.
#[derive(Clone, Debug)]
pub(crate) struct Fractions {
    /// σ.
    pub shifts: Vec<f64>,
    /// ω.
    pub weights: Vec<f64>,
    /// ω/(1 + σ).
    pub of_difference: Vec<f64>,
}

impl Fractions {
    /// Those for x from 1 to `largest`, κ > 1.
    pub fn new(largest: f64) -> Self {
        // Landen's descending transformation (Abramowitz and Stegun 1964, 16.4), by the arithmetic-geometric mean.
        let mut means = Vec::new();
        let (mut a, mut b) = (1.0, 1.0 / largest.sqrt());
        while a - b > f64::EPSILON * a {
            let c = 0.5 * (a - b);
            (a, b) = (0.5 * (a + b), (a * b).sqrt());
            means.push((a, c));
        }
        let quarter = 0.5 * PI / a;
        let conjugate = 0.5 * PI / arithmetic_geometric_mean(1.0, (1.0 - 1.0 / largest).sqrt());
        let count = ((4.0 / TOLERANCE).ln() * quarter / (2.0 * PI * conjugate)).ceil();
        let sc = |part: f64| {
            let mut phase = 2f64.powi(means.len() as i32) * a * part * quarter;
            for &(a, c) in means.iter().rev() {
                phase = 0.5 * (phase + (c / a * phase.sin()).asin());
            }
            phase.tan()
        };
        let (mut shifts, mut weights) = (Vec::new(), Vec::new());
        for j in 0..count as usize {
            let part = (j as f64 + 0.5) / count;
            // sc(K − u) = √κ / sc(u), without the cancellation near the pole of the tangent.
            let tau = if part <= 0.5 { sc(part) } else { largest.sqrt() / sc(1.0 - part) };
            let square = tau * tau;
            shifts.push(square);
            weights.push(2.0 * quarter / (PI * count) * ((1.0 + square) * (1.0 + square / largest)).sqrt());
        }
        let of_difference = weights.iter().zip(&shifts).map(|(weight, shift)| weight / (1.0 + shift)).collect();
        Self { shifts, weights, of_difference }
    }
}

fn arithmetic_geometric_mean(mut a: f64, mut b: f64) -> f64 {
    while (a - b).abs() > f64::EPSILON * a {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_the_inverse_square_root_from_one_to_the_largest() {
        for largest in [4.0, 16.0, 1e3, 1e6, 1e9] {
            let fractions = Fractions::new(largest);
            let sum = |x: f64, weights: &[f64]| -> f64 {
                weights.iter().zip(&fractions.shifts).map(|(weight, shift)| weight / (x + shift)).sum()
            };
            for step in 0..=1000 {
                let x = largest.powf(f64::from(step) / 1000.0);
                let error = sum(x, &fractions.weights) * x.sqrt() - 1.0;
                assert!(error.abs() < 2e-13, "{x} of {largest}: {error:e}");
                // It is multiplied by x − 1.
                let error = sum(x, &fractions.of_difference) - 1.0 / (x + x.sqrt());
                assert!(
                    error.abs() < 1e-11 && (x - 1.0) * error.abs() < 2e-13,
                    "{x} of {largest}: difference {error:e}"
                );
            }
            // Few of them do.
            assert!(fractions.shifts.len() as f64 <= 6.0 + 1.8 * largest.ln(), "{}", fractions.shifts.len());
        }
    }
}
