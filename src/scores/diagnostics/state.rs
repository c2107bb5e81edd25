//! The analysis of a variable against the truth, as a distribution.

use super::normal::{crps, probability_below};
use crate::scores::statistics::{self, Interval, root_interval};
use serde::{Deserialize, Serialize};

/// Bins of the histogram of probabilities.
pub const BINS: usize = 20;

/// Half the width of the central interval of a normal distribution that holds 95 %, in standard deviations.
const CENTRAL_95: f64 = 1.959_963_984_540_054;

/// What becomes of a variable, summed over grid points and cycles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct StateSums {
    /// Mean CRPS of each cycle.
    crps: Vec<f64>,
    /// Mean claimed variance of each cycle; empty without a claim.
    variance: Vec<f64>,
    /// Number of points with a positive claimed spread.
    count: u64,
    /// Those whose truth is within the central 95 % of what is claimed.
    within: u64,
    /// Those in each bin of Φ((truth − analysis)/spread).
    probabilities: Vec<u64>,
    /// Σ s², Σ e², Σ s⁴, Σ s² e² with spread s and error e.
    products: [f64; 4],
}

/// How good the analysis of a variable is as a distribution N(analysis, spread²).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StateDiagnostics {
    /// Mean continuous ranked probability score, in the variable's unit; the mean absolute error for a method without a
    /// spread.
    pub crps: f64,
    /// Its 95 % interval.
    pub crps_interval: Option<Interval>,
    /// 95 % interval of the root-mean-square spread.
    pub spread_interval: Option<Interval>,
    /// Root-mean-square spread divided by root-mean-square error; 1 if the spread is right.
    pub spread_over_error: Option<f64>,
    /// The share of grid points whose truth is within the central 95 % of what is claimed; 0.95 if that is right.
    pub coverage_95: Option<f64>,
    /// Slope of the regression of squared errors on claimed variances: 1 if the spread tells where errors are large, 0 if it
    /// tells nothing. `None` if the claimed variance is the same everywhere and always.
    pub reliability_slope: Option<f64>,
    /// Histogram of Φ((truth − analysis)/spread), as shares of its bins: flat if the claimed distribution is right, a U if
    /// the spread is too small, a hill if it is too large. The rank histogram of an ensemble of infinitely many members.
    pub probability_histogram: Option<Vec<f64>>,
}

impl StateSums {
    /// Those of one cycle, from errors (analysis − truth) and claimed standard deviations.
    pub fn of_cycle(errors: &[f64], spread: Option<&[f64]>) -> Self {
        let mut sums = Self::default();
        let cells = errors.len() as f64;
        let Some(spread) = spread else {
            sums.crps.push(errors.iter().map(|error| error.abs()).sum::<f64>() / cells);
            return sums;
        };
        sums.probabilities.resize(BINS, 0);
        let (mut total, mut variance) = (0.0, 0.0);
        for (&error, &spread) in errors.iter().zip(spread) {
            total += crps(error, spread);
            variance += spread * spread;
            if spread > 0.0 {
                let z = -error / spread;
                sums.count += 1;
                sums.within += u64::from(z.abs() <= CENTRAL_95);
                let bin = (probability_below(z) * BINS as f64) as usize;
                sums.probabilities[bin.min(BINS - 1)] += 1;
                let (s, e) = (spread * spread, error * error);
                for (sum, term) in sums.products.iter_mut().zip([s, e, s * s, s * e]) {
                    *sum += term;
                }
            }
        }
        sums.crps.push(total / cells);
        sums.variance.push(variance / cells);
        sums
    }

    /// Takes in another cycle's.
    pub fn add(&mut self, other: &Self) {
        self.crps.extend_from_slice(&other.crps);
        self.variance.extend_from_slice(&other.variance);
        self.count += other.count;
        self.within += other.within;
        self.probabilities.resize(self.probabilities.len().max(other.probabilities.len()), 0);
        self.probabilities.iter_mut().zip(&other.probabilities).for_each(|(own, other)| *own += other);
        self.products.iter_mut().zip(other.products).for_each(|(own, other)| *own += other);
    }

    /// What they come to; `None` without a finite score.
    pub fn diagnostics(&self) -> Option<StateDiagnostics> {
        let crps = statistics::mean(&self.crps)?;
        let count = self.count as f64;
        let claimed = |value: f64| (self.count > 0 && value.is_finite()).then_some(value);
        let [s, e, ss, se] = self.products.map(|sum| sum / count.max(1.0));
        let scatter = ss - s * s;
        // Rounding leaves that much of a variance that never varies.
        let varies = scatter > 1e-10 * ss;
        Some(StateDiagnostics {
            crps: crps.mean,
            crps_interval: crps.interval(),
            spread_interval: root_interval(&self.variance),
            spread_over_error: claimed((s / e).sqrt()),
            coverage_95: claimed(self.within as f64 / count),
            reliability_slope: claimed((se - s * e) / scatter).filter(|_| varies),
            probability_histogram: (self.count > 0)
                .then(|| self.probabilities.iter().map(|&own| own as f64 / count).collect()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};
    use std::f64::consts::PI;

    /// Errors of standard deviation `actual(i)` that are claimed to be `claimed(i)`, over a hundred cycles.
    fn gathered(actual: impl Fn(usize) -> f64, claimed: impl Fn(usize) -> f64) -> StateDiagnostics {
        let mut sums = StateSums::default();
        for cycle in 0..100 {
            let normals = standard_normals(&mut stream(3, &format!("cycle {cycle}")), 1000);
            let errors: Vec<f64> = normals.iter().enumerate().map(|(i, z)| actual(i) * z).collect();
            let spread: Vec<f64> = (0..1000).map(&claimed).collect();
            sums.add(&StateSums::of_cycle(&errors, Some(&spread)));
        }
        sums.diagnostics().unwrap()
    }

    #[test]
    fn an_honest_claim_has_the_known_scores() {
        let sigma = |i: usize| if i.is_multiple_of(2) { 1.0 } else { 3.0 };
        let found = gathered(sigma, sigma);
        assert!((found.crps / (2.0 / PI.sqrt()) - 1.0).abs() < 0.01, "σ/√π on average: {}", found.crps);
        let interval = found.crps_interval.unwrap();
        assert!(interval.low < 2.0 / PI.sqrt() && 2.0 / PI.sqrt() < interval.high);
        assert!((found.spread_over_error.unwrap() - 1.0).abs() < 0.01);
        assert!((found.coverage_95.unwrap() - 0.95).abs() < 0.003);
        assert!((found.reliability_slope.unwrap() - 1.0).abs() < 0.03, "{:?}", found.reliability_slope);
        let histogram = found.probability_histogram.unwrap();
        assert!(histogram.iter().all(|share| (share - 0.05).abs() < 0.004), "{histogram:?}");
    }

    #[test]
    fn a_spread_that_is_half_too_small_or_tells_nothing_shows() {
        let found = gathered(|_| 2.0, |_| 1.0);
        assert!((found.spread_over_error.unwrap() - 0.5).abs() < 0.01);
        // P(|N(0, 2²)| < 1.96) = 0.673.
        assert!((found.coverage_95.unwrap() - 0.673).abs() < 0.005, "{:?}", found.coverage_95);
        let histogram = found.probability_histogram.unwrap();
        assert!(histogram[0] > 3.0 * histogram[10] && histogram[19] > 3.0 * histogram[10], "a U: {histogram:?}");
        assert_eq!(found.reliability_slope, None, "the spread is the same everywhere");
        let found = gathered(|_| 2.0, |i| if i.is_multiple_of(2) { 1.0 } else { 3.0 });
        assert!(found.reliability_slope.unwrap().abs() < 0.02);
    }

    #[test]
    fn without_a_spread_the_score_is_the_absolute_error() {
        let mut sums = StateSums::of_cycle(&[1.0, -3.0], None);
        sums.add(&StateSums::of_cycle(&[0.0, 4.0], None));
        let found = sums.diagnostics().unwrap();
        assert_eq!((found.crps, found.coverage_95, found.probability_histogram), (2.0, None, None));
        assert_eq!(StateSums::default().diagnostics(), None);
    }
}
