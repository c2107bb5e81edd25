//! Inflation: the remedy for the spread that a small ensemble loses.

use super::moments::spread;
use faer::Mat;

/// How large the observations of an analysis are, with their weights (1 without localisation).
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    /// |Ỹ|².
    pub perturbations: f64,
    /// |d̃|².
    pub departures: f64,
    /// Σρ.
    pub weight: f64,
}

impl Sizes {
    /// The largest f |Ỹ|² of an analysis that is not graded.
    pub const LARGEST_SQUARE: f64 = 1e-7 / f64::EPSILON;

    /// Whether an eigendecomposition of Ỹ Ỹᵀ or Ỹᵀ Ỹ may be off by more than 10⁻⁷ of the analysed spread: its errors are
    /// epsilons of |Ỹ|², and move the mean by that times the departures over |Ỹ|.
    pub fn are_graded(&self, inflation: f64) -> bool {
        let norm = (inflation * self.perturbations).sqrt();
        norm * norm.max(self.departures.sqrt()) > Self::LARGEST_SQUARE
    }
}

/// Inflation of the background's perturbations in an analysis. Where nothing is observed there is none: with localisation it
/// falls off with the greatest weight that an observation has in a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BackgroundInflation {
    /// Perturbations are multiplied by this factor (Anderson and Anderson 1999); 1 for none.
    Factor(f64),
    /// A factor for each analysis that follows the innovations (Li, Kalnay and Miyoshi 2009; Miyoshi 2011).
    Adaptive {
        /// Standard deviation by which the factor on the covariance may have changed since the last analysis.
        sigma: f64,
    },
}

/// How an ensemble is kept from collapsing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inflation {
    /// Of the background, before the analysis.
    pub background: BackgroundInflation,
    /// α of relaxation to the prior perturbations (Zhang, Snyder and Sun 2004), `X_a ← (1−α) X_a + α X_b`; 0 for none.
    pub relaxation_to_prior_perturbations: f64,
    /// α of relaxation to the prior spread (Whitaker and Hamill 2012), `σ_a ← (1−α) σ_a + α σ_b`; 0 for none.
    pub relaxation_to_prior_spread: f64,
}

impl Inflation {
    /// None at all.
    pub const NONE: Inflation = Inflation {
        background: BackgroundInflation::Factor(1.0),
        relaxation_to_prior_perturbations: 0.0,
        relaxation_to_prior_spread: 0.0,
    };

    /// The factor on the background's covariance at the first analysis.
    pub(super) fn initial_variance_factor(&self) -> f64 {
        match self.background {
            BackgroundInflation::Factor(factor) => factor * factor,
            BackgroundInflation::Adaptive { .. } => 1.0,
        }
    }

    /// The factor on the background's covariance in an analysis of observations of these sizes, from that of the last
    /// analysis.
    ///
    /// Adaptive: the innovations' estimate `f_o = (|d̃|² − Σρ)/|Ỹ|²`, of variance `(2/Σρ) ((f |Ỹ|² + Σρ)/|Ỹ|²)²`, is
    /// weighed against the last factor with its variance σ² (Miyoshi 2011, eqs. 7–11).
    pub(super) fn variance_factor(&self, last: f64, observed: &Sizes) -> f64 {
        let BackgroundInflation::Adaptive { sigma } = self.background else { return self.initial_variance_factor() };
        let Sizes { perturbations: explained, departures, weight } = *observed;
        if explained <= 0.0 || weight <= 0.0 {
            return last;
        }
        let found = (departures - weight) / explained;
        let found_variance = 2.0 / weight * ((last * explained + weight) / explained).powi(2);
        let variance = sigma * sigma;
        // A factor below one half is no inflation but a sign that the observation errors are assumed too large.
        ((found_variance * last + variance * found) / (found_variance + variance)).max(0.5)
    }

    /// The factor with which analysed perturbations of a standard deviation are relaxed to that of the background.
    pub(super) fn spread_factor(&self, before: f64, after: f64) -> f64 {
        if after > 0.0 { 1.0 + self.relaxation_to_prior_spread * (before - after) / after } else { 1.0 }
    }

    /// Relaxes the spread of analysed perturbations to the background's: that of the state, whose first rows have a
    /// background spread. Biases are few beside the members, which lose no spread of theirs for want of directions.
    pub(super) fn relax_spread(&self, background_spread: &[f64], perturbations: &mut Mat<f64>) {
        if self.relaxation_to_prior_spread == 0.0 {
            return;
        }
        let factors: Vec<f64> = spread(perturbations)
            .iter()
            .zip(background_spread)
            .map(|(&after, &before)| self.spread_factor(before, after))
            .collect();
        for j in 0..perturbations.ncols() {
            let column = perturbations.col_as_slice_mut(j);
            column.iter_mut().zip(&factors).for_each(|(value, factor)| *value *= factor);
        }
    }
}
