//! What the departures of one type of observations tell of the covariances that a method assumes.

use crate::scores::PerVariable;
use crate::scores::statistics::{self, Interval};
use serde::{Deserialize, Serialize};

/// Departures of one type, summed over observations and cycles.
///
/// With d_b = y − h(background), d_a = y − h(analysis) and d_ab = d_b − d_a, of a linear analysis with the gain of right
/// covariances (Desroziers, Berre, Chapnik and Poli 2005, Q. J. R. Meteorol. Soc. 131, eqs. 1–4)
///
/// ```text
/// E[d_b d_bᵀ] = H B Hᵀ + R     E[d_ab d_bᵀ] = H B Hᵀ     E[d_a d_bᵀ] = R     E[d_ab d_aᵀ] = H A Hᵀ
/// ```
///
/// of which the diagonals are estimated here. B is here all that is not R: the error of the bias estimate too, which is part
/// of h. With R as the method assumes it, Σ d_ab d_a / R estimates the degrees of freedom for signal, tr(H K) (Lupu,
/// Gauthier and Laroche 2011, Mon. Wea. Rev. 139, eq. 13).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ObservationSums {
    count: u64,
    /// Cycles with such observations.
    cycles: u64,
    /// Mean background departure of each of these cycles.
    means: Vec<f64>,
    analysis: f64,
    /// Σ d_b², Σ d_a d_b, Σ d_ab d_b, Σ d_ab d_a.
    products: [f64; 4],
    /// Σ R.
    variance: f64,
    /// Σ d_ab d_a / R.
    signal: f64,
    /// Of the successive departures d, d' of each place: their number, Σ d d', Σ d², Σ d'².
    lagged: (u64, [f64; 3]),
    /// Cycles that were probed, and sums over them: tr(H K), and impact on the mean square error of each variable.
    probed: u64,
    trace: f64,
    impact: Vec<f64>,
}

/// What the departures of one type of observations tell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservationDiagnostics {
    /// Number of observations.
    pub count: u64,
    /// Mean of y − h(background), in the unit of the observations.
    pub innovation_mean: f64,
    /// 95 % interval of the mean over cycles of the innovations' mean.
    pub innovation_mean_interval: Option<Interval>,
    /// Root-mean-square of y − h(background).
    pub innovation_rms: f64,
    /// Mean of y − h(analysis).
    pub residual_mean: f64,
    /// The observation error's standard deviation that the method assumes.
    pub sigma_assumed: f64,
    /// The same as the departures have it; `None` where their product is negative.
    pub sigma_observation: Option<f64>,
    /// The standard deviation of the background's error in observed quantities, as the departures have it.
    pub sigma_background: Option<f64>,
    /// That of the analysis.
    pub sigma_analysis: Option<f64>,
    /// Degrees of freedom for signal per cycle with such observations, estimated from the departures.
    pub signal_from_departures: f64,
    /// The same, tr(H K), as a probe of the analysis has it; `None` without probes.
    pub signal: Option<f64>,
    /// Mean product of successive innovations of the same place.
    pub lagged_covariance: Option<f64>,
    /// The same divided by their root-mean-squares: 0 if the filter is optimal.
    pub lagged_correlation: Option<f64>,
    /// How much these observations take off the mean square error of each variable in an analysis, in the square of its unit;
    /// `None` without probes. Over all types it adds up to what the analysis takes off.
    pub impact: Option<PerVariable>,
}

impl ObservationSums {
    /// Takes in an observation of a cycle.
    pub fn observe(&mut self, background: f64, analysis: f64, variance: f64) {
        let fit = background - analysis;
        self.count += 1;
        self.analysis += analysis;
        let terms = [background * background, analysis * background, fit * background, fit * analysis];
        self.products.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        self.variance += variance;
        self.signal += fit * analysis / variance;
        match self.means.first_mut() {
            None => self.means.push(background),
            Some(sum) => *sum += background,
        }
    }

    /// Ends the cycle whose observations it was given.
    pub fn end_cycle(&mut self) {
        self.cycles = 1;
        self.means.iter_mut().for_each(|sum| *sum /= self.count as f64);
    }

    /// Takes in two successive background departures of the same place.
    pub fn follow(&mut self, before: f64, now: f64) {
        self.lagged.0 += 1;
        let terms = [before * now, before * before, now * now];
        self.lagged.1.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }

    /// Takes in what probes of a cycle's analysis have shown.
    pub fn probe(&mut self, trace: f64, impact: &[f64]) {
        self.probed += 1;
        self.trace += trace;
        self.impact.resize(impact.len(), 0.0);
        self.impact.iter_mut().zip(impact).for_each(|(sum, term)| *sum += term);
    }

    /// Takes in another cycle's.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.cycles += other.cycles;
        self.means.extend_from_slice(&other.means);
        self.analysis += other.analysis;
        self.products.iter_mut().zip(other.products).for_each(|(own, other)| *own += other);
        self.variance += other.variance;
        self.signal += other.signal;
        self.lagged.0 += other.lagged.0;
        self.lagged.1.iter_mut().zip(other.lagged.1).for_each(|(own, other)| *own += other);
        self.probed += other.probed;
        self.trace += other.trace;
        self.impact.resize(self.impact.len().max(other.impact.len()), 0.0);
        self.impact.iter_mut().zip(&other.impact).for_each(|(own, other)| *own += other);
    }

    /// Whether there was no such observation.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// What they come to; `variables` are the names of the state's.
    pub fn diagnostics<'a>(&self, variables: impl Iterator<Item = &'a str>) -> ObservationDiagnostics {
        let count = self.count as f64;
        let root = |sum: f64| (sum >= 0.0).then(|| (sum / count).sqrt());
        let [innovation, observation, background, analysis] = self.products;
        let (pairs, [product, before, now]) = self.lagged;
        let correlation = product / (before * now).sqrt();
        let probed = |sum: f64| sum / self.probed as f64;
        let mean = statistics::mean(&self.means);
        ObservationDiagnostics {
            count: self.count,
            innovation_mean: self.means.iter().sum::<f64>() / self.cycles as f64,
            innovation_mean_interval: mean.and_then(|mean| mean.interval()),
            innovation_rms: (innovation / count).sqrt(),
            residual_mean: self.analysis / count,
            sigma_assumed: (self.variance / count).sqrt(),
            sigma_observation: root(observation),
            sigma_background: root(background),
            sigma_analysis: root(analysis),
            signal_from_departures: self.signal / self.cycles as f64,
            signal: (self.probed > 0).then(|| probed(self.trace)),
            lagged_covariance: (pairs > 0).then(|| product / pairs as f64),
            lagged_correlation: (pairs > 0 && correlation.is_finite()).then_some(correlation),
            impact: (self.probed > 0 && !self.impact.is_empty())
                .then(|| variables.zip(&self.impact).map(|(name, &sum)| (name.to_string(), probed(sum))).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    /// A scalar filter with x' = a x + q, whose gain may be that of wrong variances: departures of many cycles.
    fn scalar(assumed_r: f64, actual_r: f64) -> ObservationDiagnostics {
        let (a, q, cycles) = (0.9f64, 0.5f64, 40_000);
        let normals = standard_normals(&mut stream(11, "scalar"), 2 * cycles);
        let (mut error, mut p, mut last) = (0.0, 1.0, None);
        let mut sums = ObservationSums::default();
        for pair in normals.chunks_exact(2) {
            error = a * error - q.sqrt() * pair[0];
            p = a * a * p + q;
            let gain = p / (p + assumed_r);
            let background = actual_r.sqrt() * pair[1] - error;
            error += gain * background;
            p *= 1.0 - gain;
            let mut own = ObservationSums::default();
            own.observe(background, (1.0 - gain) * background, assumed_r);
            own.end_cycle();
            if let Some(last) = last.replace(background) {
                own.follow(last, background);
            }
            sums.add(&own);
        }
        sums.diagnostics(std::iter::empty())
    }

    /// Variances of the steady state: p = a² p_a + q.
    fn steady(r: f64) -> (f64, f64) {
        let (a, q) = (0.9f64, 0.5f64);
        let p = (0..1000).fold(1.0, |p: f64, _| a * a * p * r / (p + r) + q);
        (p, p * r / (p + r))
    }

    #[test]
    fn of_an_optimal_filter_the_variances_come_back_and_innovations_are_white() {
        let found = scalar(2.0, 2.0);
        let (background, analysis) = steady(2.0);
        let near = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
        near(found.sigma_observation.unwrap(), 2f64.sqrt());
        near(found.sigma_background.unwrap(), background.sqrt());
        near(found.sigma_analysis.unwrap(), analysis.sqrt());
        near(found.innovation_rms, (background + 2.0).sqrt());
        // tr(H K) of one observation is the gain.
        near(found.signal_from_departures, background / (background + 2.0));
        assert!(found.lagged_correlation.unwrap().abs() < 3.0 / 40_000f64.sqrt(), "{found:?}");
        let interval = found.innovation_mean_interval.unwrap();
        assert!(interval.low < 0.0 && 0.0 < interval.high && found.innovation_mean.abs() < 0.05);
        assert_eq!((found.count, found.sigma_assumed), (40_000, 2f64.sqrt()));
    }

    #[test]
    fn a_wrong_variance_shows_in_its_estimate_and_in_the_lagged_correlation() {
        let small = scalar(0.5, 2.0);
        assert!(small.sigma_observation.unwrap() > 1.2 * 0.5f64.sqrt(), "{small:?}");
        assert!(small.lagged_correlation.unwrap() < -0.05, "it follows errors, which then turn: {small:?}");
        let large = scalar(8.0, 2.0);
        assert!(large.sigma_observation.unwrap() < 0.8 * 8f64.sqrt(), "{large:?}");
        assert!(large.lagged_correlation.unwrap() > 0.05, "{large:?}");
    }
}
