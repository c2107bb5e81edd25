//! Departures of observations from background and analysis.

use serde::{Deserialize, Serialize};

/// Departures of one type of observations, summed over observations and cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct DepartureSums {
    count: u64,
    /// Σ d and Σ d² of background and analysis.
    sums: [[f64; 2]; 2],
}

/// Departures of one type of observations, in their unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Departures {
    /// Number of observations.
    pub count: u64,
    /// Mean of O−B, observation minus background.
    pub background_mean: f64,
    /// Root mean square of O−B.
    pub background_rms: f64,
    /// Mean of O−A, observation minus analysis.
    pub analysis_mean: f64,
    /// Root mean square of O−A.
    pub analysis_rms: f64,
}

impl DepartureSums {
    /// Adds an observation's departures from background and analysis.
    pub fn add(&mut self, departures: [f64; 2]) {
        self.count += 1;
        for (sums, d) in self.sums.iter_mut().zip(departures) {
            sums[0] += d;
            sums[1] += d * d;
        }
    }

    /// Takes in those of another cycle.
    pub fn take(&mut self, other: &Self) {
        self.count += other.count;
        for (own, other) in self.sums.iter_mut().flatten().zip(other.sums.iter().flatten()) {
            *own += other;
        }
    }

    /// What they come to.
    pub fn departures(&self) -> Departures {
        let count = self.count as f64;
        let [background, analysis] = self.sums.map(|[sum, squares]| [sum / count, (squares / count).sqrt()]);
        Departures {
            count: self.count,
            background_mean: background[0],
            background_rms: background[1],
            analysis_mean: analysis[0],
            analysis_rms: analysis[1],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_are_taken_together() {
        let mut sums = DepartureSums::default();
        sums.add([3.0, 1.0]);
        let mut other = DepartureSums::default();
        other.add([-4.0, -2.0]);
        sums.take(&other);
        let found = sums.departures();
        assert_eq!((found.count, found.background_mean, found.analysis_mean), (2, -0.5, -0.5));
        assert_eq!((found.background_rms, found.analysis_rms), (12.5f64.sqrt(), 2.5f64.sqrt()));
    }
}
