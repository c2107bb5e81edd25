//! The estimates of bias parameters against their true values.

use serde::{Deserialize, Serialize};

/// What becomes of one parameter, summed over cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct BiasSums {
    cycles: u64,
    error: f64,
    square: f64,
    /// Number, Σ σ², Σ (e/σ)² and number of |e| ≤ 2σ of cycles with a positive claimed σ.
    claimed: (u64, f64, f64, u64),
}

/// How well one bias parameter is known, and how well the method knows that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BiasDiagnostics {
    /// Mean of estimate − truth, in the parameter's unit.
    pub mean_error: f64,
    /// Root-mean-square error.
    pub rmse: f64,
    /// Root-mean-square claimed standard deviation.
    pub spread: Option<f64>,
    /// Root-mean-square of error/σ: 1 if the claimed σ is right, more if it is too small.
    pub normalised_rmse: Option<f64>,
    /// The share of cycles with an error of at most 2σ; 0.954 if σ is right, over many parameters or seeds: the errors of a
    /// parameter hardly change from cycle to cycle.
    pub within_2_sigma: Option<f64>,
}

impl BiasSums {
    /// Those of one cycle.
    pub fn of_cycle(error: f64, sigma: Option<f64>) -> Self {
        let claimed = match sigma.filter(|&sigma| sigma > 0.0) {
            None => (0, 0.0, 0.0, 0),
            Some(sigma) => (1, sigma * sigma, (error / sigma).powi(2), u64::from(error.abs() <= 2.0 * sigma)),
        };
        Self { cycles: 1, error, square: error * error, claimed }
    }

    /// Takes in another's: another cycle's, or those of another parameter.
    pub fn add(&mut self, other: &Self) {
        self.cycles += other.cycles;
        self.error += other.error;
        self.square += other.square;
        let (own, other) = (&mut self.claimed, other.claimed);
        *own = (own.0 + other.0, own.1 + other.1, own.2 + other.2, own.3 + other.3);
    }

    /// The same in another unit: errors and σ times `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        let (count, variance, normalised, within) = self.claimed;
        let square = factor * factor;
        let claimed = (count, square * variance, normalised, within);
        Self { error: factor * self.error, square: square * self.square, claimed, ..*self }
    }

    /// What they come to; `None` without a cycle of which the truth is known.
    pub fn diagnostics(&self) -> Option<BiasDiagnostics> {
        if self.cycles == 0 {
            return None;
        }
        let cycles = self.cycles as f64;
        let (count, variance, normalised, within) = self.claimed;
        let claimed = |value: f64| (count > 0).then(|| value / count as f64);
        Some(BiasDiagnostics {
            mean_error: self.error / cycles,
            rmse: (self.square / cycles).sqrt(),
            spread: claimed(variance).map(f64::sqrt),
            normalised_rmse: claimed(normalised).map(f64::sqrt),
            within_2_sigma: claimed(within as f64),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    #[test]
    fn a_claim_is_calibrated_if_errors_are_as_large_as_it_says() {
        let mut sums = [BiasSums::default(); 2];
        for z in standard_normals(&mut stream(5, "bias"), 20_000) {
            sums[0].add(&BiasSums::of_cycle(3.0 * z, Some(3.0)));
            sums[1].add(&BiasSums::of_cycle(1.0 + 3.0 * z, Some(1.0)));
        }
        let [honest, vain] = sums.map(|sums| sums.diagnostics().unwrap());
        assert!((honest.normalised_rmse.unwrap() - 1.0).abs() < 0.02, "{honest:?}");
        assert!((honest.within_2_sigma.unwrap() - 0.9545).abs() < 0.005);
        assert!((vain.normalised_rmse.unwrap() - 10f64.sqrt()).abs() < 0.05, "{vain:?}");
        assert!((vain.mean_error - 1.0).abs() < 0.1 && vain.spread == Some(1.0));
        assert!(vain.within_2_sigma.unwrap() < 0.6);
        let none = BiasSums::of_cycle(-2.0, None).diagnostics().unwrap();
        assert_eq!((none.rmse, none.mean_error, none.spread, none.within_2_sigma), (2.0, -2.0, None, None));
        assert_eq!(BiasSums::default().diagnostics(), None);
    }
}
