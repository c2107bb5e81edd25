//! The scores of a complete run.

use super::cost::with_cost;
use super::experiment::Experiment;
use crate::scores::{Exchanged, MethodScores, RunScores, Scorecard, Summary, VerifiedBy};

/// The scores of a run, with what its ranks exchanged; `with_memory`: also the memory of each method.
pub(super) fn summary(
    experiment: &Experiment,
    scores: &RunScores,
    with_memory: bool,
    ranks: Option<Exchanged>,
) -> Summary {
    let Experiment { info, methods, .. } = experiment;
    let by = VerifiedBy::in_world(info.has_truth, info.networks.iter().any(|network| network.has_passive));
    let forecasts = |total: &Scorecard| total.forecasts.scores(&info.layout, info.window, by);
    let names: Vec<String> = info.warnings.iter().map(|it| it.warning.name.clone()).collect();
    let longest_hours = info.lead_times.map_or(0.0, |times| info.lead_hours(times.longest_cycles));
    let methods = info.methods.iter().zip(&scores.totals).zip(methods).map(|((own, total), method)| {
        let last = method.failure.as_ref().map_or(info.cycles, |failure| failure.cycle);
        let mut scores = match &method.failure {
            None => MethodScores {
                stability: method.runner.stability(&info.layout).ok(),
                smoother_lag_cycles: own.smoother_lag_cycles,
                ..total
                    .scores(&info.layout, &info.calibration)
                    .with_forecasts(forecasts(total), longest_hours)
                    .with_warnings(total.warnings.scores(&names, |cycles| info.lead_hours(cycles)))
            },
            // Scores of fewer cycles could not be compared with those of the other methods.
            Some(failure) => MethodScores { failure: Some(failure.clone()), ..MethodScores::default() },
        };
        scores.parameters = method.runner.parameters();
        let progress = method.runner.progress();
        let (seconds, bytes) = (
            progress.seconds / last.saturating_sub(info.done).max(1) as f64,
            with_memory.then_some(progress.peak_bytes),
        );
        scores.values = with_cost(scores.values, seconds, bytes);
        (own.name.clone(), scores)
    });
    Summary {
        scenario: info.scenario.clone(),
        seed: info.seed,
        cycles: info.cycles,
        scored_from_cycle: info.scored_from(),
        version: crate::VERSION.to_string(),
        observations: scores.observations.clone(),
        methods: methods.collect(),
        ranks,
    }
}
