//! Correlations as functions of distance.

use super::taper::gaspari_cohn;

/// An isotropic correlation c of distance over length, r = d/L, that is positive definite in the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorrelationFunction {
    /// exp(−r²/2): smooth errors.
    Gaussian,
    /// exp(−r): errors that are continuous, but have no gradient.
    Exponential,
    /// (1 + r) exp(−r): errors with a gradient; Matérn's function of order 3/2 (Thiebaux 1985, for heights).
    SecondOrderAutoregressive,
    /// (1 + r + r²/3) exp(−r): errors with curvature; Matérn's of order 5/2.
    ThirdOrderAutoregressive,
    /// The function of Gaspari and Cohn (1999) with the Gaussian's curvature: 0 from 2 √(10/3) L on.
    GaspariCohn,
}

impl CorrelationFunction {
    /// c(r), 1 at 0.
    pub fn at(self, r: f64) -> f64 {
        match self {
            CorrelationFunction::Gaussian => (-0.5 * r * r).exp(),
            CorrelationFunction::Exponential => (-r).exp(),
            CorrelationFunction::SecondOrderAutoregressive => (1.0 + r) * (-r).exp(),
            CorrelationFunction::ThirdOrderAutoregressive => (1.0 + r + r * r / 3.0) * (-r).exp(),
            CorrelationFunction::GaspariCohn => gaspari_cohn(r / (2.0 * (10.0_f64 / 3.0).sqrt())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::CorrelationFunction::*;

    #[test]
    fn they_are_one_at_the_place_itself_and_have_their_curvature() {
        let h = 1e-3;
        for (function, curvature) in [
            (Gaussian, -1.0),
            (SecondOrderAutoregressive, -1.0),
            (ThirdOrderAutoregressive, -1.0 / 3.0),
            (GaspariCohn, -1.0),
        ] {
            assert_eq!(function.at(0.0), 1.0);
            let found = 2.0 * (function.at(h) - 1.0) / (h * h);
            assert!((found - curvature).abs() < 2e-3, "{function:?}: {found}");
        }
        assert!((Exponential.at(1.0) - 1.0 / std::f64::consts::E).abs() < 1e-15);
        assert_eq!(GaspariCohn.at(3.66), 0.0);
        assert!(GaspariCohn.at(3.6) > 0.0);
    }
}
