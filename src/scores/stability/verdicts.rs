//! The verdict on every bias in every cycle, of which those are told that are others than in the cycle before.

use super::judge::doubts;
use super::{Stability, Watch, in_words};
use isobar_assim::{Assimilator, Calibrated, Estimate};
use serde::{Deserialize, Serialize};

/// The verdict on a bias parameter in a cycle, by the rule of the verdict at the end: of what the observations so far leave of
/// the variance that it would have without them, which for an evolving parameter tends to its stationary variance, and of
/// its innovations so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Number of the parameter in the calibration.
    pub parameter: usize,
    /// Whether it has a stable update.
    pub stable: bool,
    /// Whether it is adjusted no more.
    pub frozen: bool,
    /// The share of its prior variance that it still has.
    pub variance_ratio: f64,
    /// Why it is not stable; empty if it is.
    pub why: Vec<String>,
}

impl Verdict {
    /// The verdict, in words.
    pub fn in_words(&self) -> &'static str {
        in_words(self.stable, self.frozen)
    }
}

/// The last verdict on each parameter of a method; a checkpoint has it, so that a run that goes on repeats none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdicts {
    last: Vec<Standing>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Standing {
    stable: bool,
    frozen: bool,
}

impl Verdicts {
    /// Judges the parameters after an analysis: those verdicts that are the first or other than in the cycle before. None of a
    /// method that claims no covariance of biases. `when_frozen` is what was said of parameters when they were frozen for
    /// good, which stands.
    pub fn judge(
        &mut self,
        watch: &Watch,
        method: &Calibrated,
        analysis: &Estimate,
        variance_ratio: f64,
        when_frozen: Option<&Stability>,
    ) -> Vec<Verdict> {
        let prior = method.prior_covariance();
        let Some(claims) = method.can().calibration.filter(|_| prior.nrows() > 0) else { return Vec::new() };
        let variances: Vec<f64> = match &analysis.calibration_spread {
            Some(spread) => spread.iter().map(|sigma| sigma * sigma).collect(),
            None => claims.calibration_accuracy().covariance().diagonal().column_vector().iter().copied().collect(),
        };
        let mut changed = Vec::new();
        for (number, (&frozen, variance)) in method.frozen().iter().zip(variances).enumerate() {
            let before = when_frozen.filter(|_| frozen).and_then(|before| before.parameters.get(number));
            let verdict = match before {
                Some(before) => Verdict {
                    parameter: number,
                    stable: before.stable,
                    frozen,
                    variance_ratio: before.variance_ratio,
                    why: before.why.clone(),
                },
                None => {
                    let ratio = variance / prior[(number, number)];
                    let why: Vec<String> =
                        doubts(watch, number, ratio, variance_ratio).map(|doubt| doubt.to_string()).collect();
                    Verdict { parameter: number, stable: why.is_empty(), frozen, variance_ratio: ratio, why }
                }
            };
            let standing = Standing { stable: verdict.stable, frozen };
            match self.last.get_mut(number) {
                Some(last) if *last == standing => continue,
                Some(last) => *last = standing,
                None => self.last.push(standing),
            }
            changed.push(verdict);
        }
        changed
    }

    /// Whether they are of this number of parameters; those of a file may not be.
    pub fn fits(&self, parameters: usize) -> bool {
        self.last.is_empty() || self.last.len() == parameters
    }
}
