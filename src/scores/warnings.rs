//! Scores of warnings: how right the probabilities of forecasts ahead were.
//!
//! With probabilities p and outcomes o, 1 if the event came about and 0 if not, of N cases that fall into bins k of n_k cases
//! by their probability, with means p̄_k and ō_k there, and ō of all
//!
//! ```text
//! brier        Σ (p − o)²/N = reliability − resolution + uncertainty
//! reliability  Σ n_k (p̄_k − ō_k)²/N                              0 if the event is as frequent as stated
//! resolution   Σ n_k (ō_k − ō)²/N − Σ_k Σ_i (p_i − p̄_k)²/N + 2 Σ_k Σ_i (p_i − p̄_k)(o_i − ō_k)/N
//! uncertainty  ō (1 − ō)
//! brier_skill  1 − brier/uncertainty
//! ```
//!
//! (Brier 1950, Mon. Wea. Rev. 78; Murphy 1973, J. Appl. Meteor. 12.) The second and third term of the resolution are what the
//! bins leave within them, without which the sum is not exact (Stephenson, Coelho and Jolliffe 2008, Wea. Forecasting 23). The
//! skill is relative to a forecast whose probability is always the frequency of the event in these cases: 0 is no better than
//! that, 1 is perfect. There is no skill if the event never or always occurred. With few cases in a bin the reliability is too
//! large by about Σ ō_k (1 − ō_k)/N, and the resolution with it.

use super::forecast::Known;
use super::statistics::mean;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Number of bins by probability, all as wide.
pub const BINS: usize = 10;

/// A warning at one lead time of one forecast, once its valid time has come.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WarningCase {
    /// The probability that the forecast gave to the event.
    pub probability: f64,
    /// Whether the warning was issued.
    pub issued: bool,
    /// Whether the event came about; `None` if nothing says so.
    pub occurred: Option<bool>,
}

/// Probabilities of the forecasts ahead of one analysis, by lead time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outlook {
    /// The cycle from whose analysis they start.
    pub from_cycle: usize,
    /// Lead times in cycles, in increasing order, with the probability of each warning.
    pub leads: Vec<(usize, Vec<f64>)>,
}

/// The warnings of one method so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WarningSums {
    /// By the number of the warning and the lead time in cycles, in the order of the starts.
    cases: BTreeMap<(usize, usize), Vec<WarningCase>>,
    /// Whether a forecast had no standard deviation.
    deterministic: bool,
    /// The last forecasts.
    last: Option<Outlook>,
}

impl WarningSums {
    /// Takes the warnings of a forecast whose valid time has come, in their order, and whether it has a standard deviation.
    pub fn add(&mut self, lead_cycles: usize, cases: &[WarningCase], has_spread: bool) {
        for (number, case) in cases.iter().enumerate() {
            self.cases.entry((number, lead_cycles)).or_default().push(*case);
        }
        self.deterministic |= !has_spread && !cases.is_empty();
    }

    /// Takes the forecasts of an analysis that have just been made.
    pub fn add_outlook(&mut self, outlook: Outlook) {
        self.last = Some(outlook);
    }

    /// The scores of the warnings with these names, at lead times that a function gives in hours.
    pub fn scores(&self, names: &[String], hours: impl Fn(usize) -> f64) -> Vec<WarningScores> {
        let of = |(number, name): (usize, &String)| {
            let own = || self.cases.range((number, 0)..=(number, usize::MAX));
            let lead = |(&(_, lead), cases): (&(usize, usize), &Vec<WarningCase>)| LeadWarningScores {
                lead_hours: hours(lead),
                scores: verified(cases.iter()),
            };
            let ahead = || own().filter(|((_, lead), _)| *lead > 0).flat_map(|(_, cases)| cases);
            let outlook = self.last.iter().flat_map(|last| &last.leads).filter_map(|(lead, probabilities)| {
                Some(LeadProbability { lead_hours: hours(*lead), probability: *probabilities.get(number)? })
            });
            WarningScores {
                name: name.clone(),
                deterministic: self.deterministic,
                ahead: verified(ahead()),
                leads: own().map(lead).collect(),
                bins: bins(ahead()),
                outlook_from_cycle: self.last.as_ref().map(|last| last.from_cycle),
                outlook: outlook.collect(),
            }
        };
        names.iter().enumerate().map(of).collect()
    }
}

/// The scores of one warning of one method over a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WarningScores {
    /// Its name.
    pub name: String,
    /// Whether the method claims no standard deviation, so that its probabilities are 0 or 1.
    pub deterministic: bool,
    /// The scores over all lead times after the analysis.
    pub ahead: VerifiedWarnings,
    /// The scores at each lead time, from 0, the analysis.
    pub leads: Vec<LeadWarningScores>,
    /// The reliability diagram over all lead times after the analysis: the bins that have cases.
    pub bins: Vec<ProbabilityBin>,
    /// The cycle of the last analysis from which there are forecasts.
    pub outlook_from_cycle: Option<usize>,
    /// The probabilities of the event in the forecasts from there.
    pub outlook: Vec<LeadProbability>,
}

/// The scores at one lead time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadWarningScores {
    /// The lead time \[h\].
    pub lead_hours: f64,
    /// The scores.
    #[serde(flatten)]
    pub scores: VerifiedWarnings,
}

/// The probability of an event at one lead time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadProbability {
    /// The lead time \[h\].
    pub lead_hours: f64,
    /// The probability.
    pub probability: f64,
}

/// Probabilities and outcomes, compared.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VerifiedWarnings {
    /// Number of cases of which it is known whether the event came about.
    pub cases: usize,
    /// Those in which it did.
    pub occurred: usize,
    /// Issued, and the event came about.
    pub hits: usize,
    /// Not issued, and it did.
    pub misses: usize,
    /// Issued, and it did not.
    pub false_alarms: usize,
    /// The Brier score and its parts; `None` without a case.
    pub brier: Option<BrierScore>,
}

/// The Brier score and its parts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BrierScore {
    /// The score, and its 95 % interval over successive cases of one lead time.
    pub score: Known,
    /// How far the frequency of the event is from the stated probability.
    pub reliability: f64,
    /// How much the frequency of the event differs between forecasts with different probabilities.
    pub resolution: f64,
    /// The score of a forecast whose probability is always the frequency of the event.
    pub uncertainty: f64,
    /// The skill beside that forecast; `None` if the event never or always came about.
    pub skill: Option<f64>,
}

/// Cases with about the same probability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProbabilityBin {
    /// Number of cases.
    pub cases: usize,
    /// Their mean probability.
    pub probability: f64,
    /// The share of them in which the event came about.
    pub frequency: f64,
}

/// Sums over the cases of a bin.
#[derive(Clone, Copy, Default)]
struct BinSums {
    /// n, Σ p, Σ o, Σ p², Σ p o.
    n: f64,
    p: f64,
    o: f64,
    pp: f64,
    po: f64,
}

fn known<'a>(cases: impl Iterator<Item = &'a WarningCase>) -> impl Iterator<Item = (f64, bool, bool)> {
    cases.filter_map(|case| Some((case.probability, case.issued, case.occurred?)))
}

fn sums<'a>(cases: impl Iterator<Item = &'a WarningCase>) -> [BinSums; BINS] {
    let mut bins = [BinSums::default(); BINS];
    for (p, _, occurred) in known(cases) {
        let o = f64::from(u8::from(occurred));
        let bin = &mut bins[((p * BINS as f64) as usize).min(BINS - 1)];
        (bin.n, bin.p, bin.o, bin.pp, bin.po) = (bin.n + 1.0, bin.p + p, bin.o + o, bin.pp + p * p, bin.po + p * o);
    }
    bins
}

fn bins<'a>(cases: impl Iterator<Item = &'a WarningCase>) -> Vec<ProbabilityBin> {
    let filled = sums(cases).into_iter().filter(|bin| bin.n > 0.0);
    filled
        .map(|bin| ProbabilityBin { cases: bin.n as usize, probability: bin.p / bin.n, frequency: bin.o / bin.n })
        .collect()
}

fn verified<'a>(cases: impl Iterator<Item = &'a WarningCase> + Clone) -> VerifiedWarnings {
    let count = |test: &dyn Fn(bool, bool) -> bool| known(cases.clone()).filter(|it| test(it.1, it.2)).count();
    VerifiedWarnings {
        cases: count(&|_, _| true),
        occurred: count(&|_, occurred| occurred),
        hits: count(&|issued, occurred| issued && occurred),
        misses: count(&|issued, occurred| !issued && occurred),
        false_alarms: count(&|issued, occurred| issued && !occurred),
        brier: brier(cases),
    }
}

fn brier<'a>(cases: impl Iterator<Item = &'a WarningCase> + Clone) -> Option<BrierScore> {
    let squares: Vec<f64> =
        known(cases.clone()).map(|(p, _, occurred)| (p - f64::from(u8::from(occurred))).powi(2)).collect();
    let score = mean(&squares)?;
    let filled: Vec<BinSums> = sums(cases).into_iter().filter(|bin| bin.n > 0.0).collect();
    let count = squares.len() as f64;
    let frequency = filled.iter().map(|bin| bin.o).sum::<f64>() / count;
    let over_bins = |part: &dyn Fn(&BinSums) -> f64| filled.iter().map(part).sum::<f64>() / count;
    let reliability = over_bins(&|bin| (bin.p - bin.o).powi(2) / bin.n);
    let between = over_bins(&|bin| bin.n * (bin.o / bin.n - frequency).powi(2));
    let within_variance = over_bins(&|bin| bin.pp - bin.p * bin.p / bin.n);
    let within_covariance = over_bins(&|bin| bin.po - bin.p * bin.o / bin.n);
    let uncertainty = frequency * (1.0 - frequency);
    Some(BrierScore {
        score: Known { value: score.mean, interval: score.interval() },
        reliability,
        resolution: between - within_variance + 2.0 * within_covariance,
        uncertainty,
        skill: (uncertainty > 0.0).then(|| 1.0 - score.mean / uncertainty),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    fn case(probability: f64, occurred: Option<bool>) -> WarningCase {
        WarningCase { probability, issued: probability >= 0.5, occurred }
    }

    /// Uniform numbers in [0, 1).
    fn uniform(count: usize, purpose: &str) -> Vec<f64> {
        let normals = standard_normals(&mut stream(5, purpose), count);
        normals.into_iter().map(crate::scores::diagnostics::probability_below).collect()
    }

    /// Reliability − resolution + uncertainty is the score, whatever is within the bins.
    #[test]
    fn the_parts_add_up_to_the_score() {
        for count in [1, 2, 17, 400] {
            let pairs = uniform(count, "p").into_iter().zip(uniform(count, "o"));
            let cases: Vec<WarningCase> =
                pairs.map(|(p, draw)| case(p, Some(draw < p * p))).chain([case(0.3, None)]).collect();
            let verified = verified(cases.iter());
            let it = verified.brier.unwrap();
            let sum = it.reliability - it.resolution + it.uncertainty;
            assert!((sum - it.score.value).abs() < 1e-14, "{count}: {sum} and {it:?}");
            assert_eq!(verified.cases, count);
            assert_eq!(verified.hits + verified.misses, verified.occurred);
            if let Some(skill) = it.skill {
                assert!((skill - (it.resolution - it.reliability) / it.uncertainty).abs() < 1e-12);
            }
        }
    }

    /// Outcomes as frequent as was said, exactly: perfectly reliable. Then, for p of ¼ and ¾ as often, the parts by hand.
    #[test]
    fn what_is_as_frequent_as_was_said_is_reliable() {
        let outcomes = [true, false, false, false].map(|it| case(0.25, Some(it)));
        let others = [true, true, true, false].map(|it| case(0.75, Some(it)));
        let cases: Vec<WarningCase> = outcomes.into_iter().chain(others).collect();
        let it = brier(cases.iter()).unwrap();
        assert_eq!((it.reliability, it.resolution, it.uncertainty), (0.0, 1.0 / 16.0, 0.25));
        assert_eq!((it.score.value, it.skill), (3.0 / 16.0, Some(0.25)));
        let found = bins(cases.iter());
        assert!(found.iter().all(|bin| bin.cases == 4 && bin.probability == bin.frequency), "{found:?}");
        // Many draws with the probability that was said: reliability only what chance leaves of 10 bins.
        let count = 20_000;
        let draws = uniform(count, "p").into_iter().zip(uniform(count, "o"));
        let cases: Vec<WarningCase> = draws.map(|(p, draw)| case(p, Some(draw < p))).collect();
        let it = brier(cases.iter()).unwrap();
        assert!(it.reliability < 4.0 * BINS as f64 / count as f64 / 6.0, "{it:?}");
        // ∫ p (1 − p) dp and the variance of a uniform number.
        assert!((it.score.value - 1.0 / 6.0).abs() < 0.005 && (it.resolution - 1.0 / 12.0).abs() < 0.005, "{it:?}");
    }

    #[test]
    fn certain_forecasts_are_perfect_or_worthless_and_what_never_comes_has_no_skill() {
        let right = [case(1.0, Some(true)), case(0.0, Some(false))];
        let it = verified(right.iter());
        assert_eq!((it.hits, it.misses, it.false_alarms), (1, 0, 0));
        assert_eq!(it.brier.map(|it| (it.score.value, it.skill, it.resolution)), Some((0.0, Some(1.0), 0.25)));
        let wrong = [case(0.0, Some(true)), case(1.0, Some(false))];
        let it = verified(wrong.iter());
        assert_eq!((it.hits, it.misses, it.false_alarms), (0, 1, 1));
        assert_eq!(it.brier.map(|it| (it.score.value, it.skill)), Some((1.0, Some(-3.0))));
        let never = [case(0.1, Some(false)); 5];
        let it = brier(never.iter()).unwrap();
        assert_eq!((it.uncertainty, it.skill), (0.0, None));
        assert_eq!(verified([case(0.4, None)].iter()), VerifiedWarnings::default());
    }

    #[test]
    fn scores_are_of_each_warning_and_lead_time() {
        let mut sums = WarningSums::default();
        sums.add(0, &[case(1.0, Some(true)), case(0.0, Some(false))], true);
        sums.add(2, &[case(0.6, Some(true)), case(0.2, None)], true);
        sums.add(4, &[case(0.4, Some(true)), case(0.2, Some(false))], true);
        sums.add_outlook(Outlook { from_cycle: 7, leads: vec![(2, vec![0.5, 0.1])] });
        let scores = sums.scores(&["a".into(), "b".into()], |lead| 6.0 * lead as f64);
        let [a, b] = &scores[..] else { panic!("there are two") };
        assert_eq!((a.ahead.cases, a.ahead.hits, a.ahead.misses), (2, 1, 1));
        assert!((a.ahead.brier.unwrap().score.value - 0.26).abs() < 1e-15);
        assert_eq!(a.leads.iter().map(|lead| lead.lead_hours).collect::<Vec<_>>(), [0.0, 12.0, 24.0]);
        assert_eq!((b.leads[1].scores.cases, b.leads[2].scores.cases, b.ahead.cases), (0, 1, 1));
        assert_eq!(b.outlook, [LeadProbability { lead_hours: 12.0, probability: 0.1 }]);
        assert_eq!((a.outlook_from_cycle, a.deterministic), (Some(7), false));
    }
}
