//! Whether a method's claimed spread is that of its errors: sums over grid points, gathered cycle by cycle.

use std::collections::BTreeMap;

/// Half of the range of normalised errors, and the number of their bins.
const LARGEST: f64 = 4.0;
const BINS: usize = 32;

/// Bins of claimed spread in a factor of two.
const BINS_PER_OCTAVE: f64 = 3.0;

/// The errors of one variable against the claimed standard deviations.
#[derive(Clone, Debug, Default)]
pub struct Reliability {
    /// Number of errors in each bin of (estimate − truth) / spread; those beyond the last bins are in neither.
    normalised: Vec<u64>,
    count: u64,
    /// By the logarithm of the claimed spread: number, sum of spread², sum of error².
    spreads: BTreeMap<i32, (u64, f64, f64)>,
}

impl Reliability {
    /// Takes in errors with their claimed standard deviations; pairs without a positive spread are left out.
    pub fn add(&mut self, pairs: impl Iterator<Item = (f64, f64)>) {
        self.normalised.resize(BINS, 0);
        for (error, spread) in pairs.filter(|(error, spread)| error.is_finite() && spread.is_finite() && *spread > 0.0)
        {
            self.count += 1;
            let place = (error / spread / LARGEST + 1.0) * 0.5 * BINS as f64;
            if (0.0..BINS as f64).contains(&place) {
                self.normalised[place as usize] += 1;
            }
            let bin = self.spreads.entry((spread.log2() * BINS_PER_OCTAVE).floor() as i32).or_default();
            *bin = (bin.0 + 1, bin.1 + spread * spread, bin.2 + error * error);
        }
    }

    /// Probability density of the normalised errors: centre of each bin, and density.
    pub fn density(&self) -> Vec<[f64; 2]> {
        let width = 2.0 * LARGEST / BINS as f64;
        let center = |bin: usize| (bin as f64 + 0.5) * width - LARGEST;
        let density = |count: u64| count as f64 / (self.count.max(1) as f64 * width);
        self.normalised.iter().enumerate().map(|(bin, &count)| [center(bin), density(count)]).collect()
    }

    /// Root-mean-square spread and error of each bin of spread that holds at least one in a thousand of all values.
    pub fn curve(&self) -> Vec<[f64; 2]> {
        let enough = |bin: &&(u64, f64, f64)| bin.0 * 1000 >= self.count;
        let root = |&(count, spread, error): &(u64, f64, f64)| [spread, error].map(|sum| (sum / count as f64).sqrt());
        self.spreads.values().filter(enough).map(root).collect()
    }

    /// Whether nothing was gathered.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// The normal distribution's density, as [`Reliability::density`] would show it.
pub fn normal_density() -> Vec<[f64; 2]> {
    let at = |z: f64| [z, (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt()];
    (-40..=40).map(|step| at(f64::from(step) * LARGEST / 40.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    #[test]
    fn an_honest_spread_gives_the_normal_distribution_and_the_diagonal() {
        let noise = standard_normals(&mut stream(1, "reliability"), 100_000);
        let mut honest = Reliability::default();
        let spread = |number: usize| if number.is_multiple_of(2) { 1.0 } else { 6.0 };
        let (first, second) = noise.split_at(50_000);
        for (part, offset) in [(first, 0), (second, 50_000)] {
            honest
                .add(part.iter().enumerate().map(|(number, z)| (spread(number + offset) * z, spread(number + offset))));
        }
        for [z, density] in honest.density() {
            let expected = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            assert!((density - expected).abs() < 0.01, "{z}: {density} {expected}");
        }
        let curve = honest.curve();
        assert_eq!(curve.len(), 2);
        for [spread, error] in curve {
            assert!((error / spread - 1.0).abs() < 0.02, "{spread} {error}");
        }
    }

    #[test]
    fn what_has_no_spread_is_left_out() {
        let mut reliability = Reliability::default();
        reliability.add([(1.0, 0.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)].into_iter());
        assert!(reliability.is_empty() && reliability.curve().is_empty());
        reliability.add([(100.0, 1.0)].into_iter());
        assert_eq!(reliability.density().iter().map(|bin| bin[1]).sum::<f64>(), 0.0);
        assert_eq!(reliability.curve(), [[1.0, 100.0]]);
    }
}
