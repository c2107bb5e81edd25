//! The verdict on every bias in every cycle; only changes are reported.

use super::freezing::Standing;
use super::judge::doubts;
use super::{Freezing, Stability, Watch};
use crate::verdict::Verdict;
use isobar_assim::{Assimilator, Calibrated, Error, Estimate};
use serde::{Deserialize, Serialize};

/// The last verdict on each parameter of a method; a checkpoint has it, so that a run that goes on repeats none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdicts {
    last: Vec<Standing>,
}

impl Verdicts {
    /// Judges the parameters after an analysis, and freezes and thaws them by the rule. Returns the first verdict on each, and
    /// those that have changed since the cycle before; nothing for a method that claims no covariance of biases. `when_frozen`
    /// has the verdicts on parameters that were frozen for good, which stand.
    ///
    /// # Errors
    /// Those of [`Calibrated::hold`].
    pub fn judge(
        &mut self,
        watch: &mut Watch,
        method: &mut Calibrated,
        analysis: &Estimate,
        (variance_ratio, freezing): (f64, Freezing),
        when_frozen: Option<&Stability>,
    ) -> Result<Vec<Verdict>, Error> {
        let mut verdicts = verdicts(watch, method, analysis, variance_ratio, when_frozen);
        verdicts.iter().for_each(|it| watch.add_variance_ratio(it.parameter, it.variance_ratio));
        let before = |number: usize| self.last.get(number).copied();
        let mut now: Vec<Standing> =
            verdicts.iter().map(|it| Standing::after(before(it.parameter), it.stable, it.frozen)).collect();
        if freezing == Freezing::Never {
            now.iter_mut().for_each(|standing| *standing = standing.uncounted());
        }
        if let Freezing::WhileUnstable(rule) = freezing {
            let (mut held, mut thawed) = (Vec::new(), Vec::new());
            for (verdict, standing) in verdicts.iter_mut().zip(&mut now) {
                standing.frozen = standing.is_to_be_frozen(rule);
                match (verdict.frozen, standing.frozen) {
                    (false, true) => held.push(verdict.parameter),
                    (true, false) => thawed.push(verdict.parameter),
                    _ => {}
                }
                verdict.frozen = standing.frozen;
            }
            if !held.is_empty() {
                method.hold(&held)?;
            }
            method.thaw(&thawed);
            thawed.into_iter().for_each(|parameter| watch.forget_correlation_of(parameter));
        }
        let is_new = |verdict: &Verdict| {
            before(verdict.parameter).is_none_or(|it| (it.stable, it.frozen) != (verdict.stable, verdict.frozen))
        };
        verdicts.retain(is_new);
        self.last = now;
        Ok(verdicts)
    }

    /// Whether they are of this number of parameters; those of a file may not be.
    pub fn fits(&self, parameters: usize) -> bool {
        self.last.is_empty() || self.last.len() == parameters
    }
}

/// The verdict on every parameter after an analysis.
fn verdicts(
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
    let verdict = |(number, (&frozen, variance)): (usize, (&bool, f64))| {
        let stands = when_frozen.filter(|_| frozen).and_then(|before| before.parameters.get(number));
        if let Some(before) = stands {
            let (stable, variance_ratio, why) = (before.stable, before.variance_ratio, before.why.clone());
            return Verdict { parameter: number, stable, frozen, variance_ratio, why };
        }
        let ratio = method.variance_if_adjusted(number).unwrap_or(variance) / prior[(number, number)];
        let doubts = doubts(watch, (number, frozen), ratio, variance_ratio);
        let why: Vec<String> = doubts.map(|doubt| doubt.to_string()).collect();
        Verdict { parameter: number, stable: why.is_empty(), frozen, variance_ratio: ratio, why }
    };
    method.frozen().iter().zip(variances).enumerate().map(verdict).collect()
}
