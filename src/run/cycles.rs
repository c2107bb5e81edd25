//! The loop over cycles.

use super::after_cycle::{AfterCycle, Results, after_cycle};
use super::ahead::Pending;
use super::checkpoint::saved::take_part;
use super::cost::with_cost;
use super::error::RunError;
use super::events::Events;
use super::experiment::{Competitor, Experiment};
use super::monitor::Fault;
use super::reference::Reference;
use super::summary::summary;
use super::truth::Truth;
use crate::correlations::Correlations;
use crate::event::{Analysed, Estimated, Event, Forecast, Judged, RunInfo, Smoothed};
use crate::outcome::Outcome;
use crate::scores::forecast::{self, Verifying};
use crate::scores::{Exchanged, Failure, Outlook, RunScores, Scorecard, Summary, TrueValues, WarningCase, measures};
use crate::text::clean;
use crate::threshold_warning::PlacedWarning;
use crate::verdict::Verdict;
use isobar_assim::Estimate;
use isobar_model::communicator::{Communicator, Sent};
use isobar_obs::ObservationWindow;
use rayon::ThreadPool;
use std::borrow::Cow;

/// A run in its cycles.
pub(super) struct Cycles<'a, 'b> {
    /// The truth, the observing systems and the methods.
    pub experiment: &'a mut Experiment,
    /// The scores so far.
    pub scores: RunScores,
    /// Where events go.
    pub events: &'a mut Events<'b>,
    /// The threads that compute.
    pub workers: &'a ThreadPool,
    /// The ranks that compute it together. Each does all that is here, but for what `events` has on rank 0 only.
    pub communicator: &'a dyn Communicator,
    /// What is found out beside the scores.
    pub shown: Shown,
    /// Whether another run may go on from the end of this one, so that forecasts ahead are made to beyond it.
    pub goes_on: bool,
}

/// What is found out beside the scores.
#[derive(Clone, Copy)]
pub(super) struct Shown {
    /// The memory of each method, which is known only where no other experiment runs at the same time.
    pub memory: bool,
    /// Blocks, common factors and correlations.
    pub structure: bool,
}

/// The observations of a cycle as the methods receive them.
struct Observed {
    /// With their biases.
    window: ObservationWindow,
    /// Without the true biases, if a method is given them.
    bias_removed: Option<ObservationWindow>,
}

impl Observed {
    /// As a method receives them.
    fn as_given_to(&self, method: &Competitor) -> &ObservationWindow {
        self.bias_removed.as_ref().filter(|_| method.bias_known).unwrap_or(&self.window)
    }
}

impl Cycles<'_, '_> {
    /// Runs the cycles after those that are done.
    ///
    /// # Errors
    /// A truth that cannot go on, an output that cannot be written, or a signal; a rank that has come to other results, or in
    /// which a method panics.
    pub fn run(&mut self, done: usize) -> Result<Summary, RunError> {
        let cycles = self.experiment.info.cycles;
        if done == self.experiment.info.done {
            self.send_truth(done)?;
        }
        let (mut results, sent_before) = (Results::default(), self.communicator.sent());
        for cycle in done + 1..=cycles {
            let observed = self.observe(cycle)?;
            for number in 0..self.experiment.methods.len() {
                let outcome = self.one_method(number, cycle, &observed)?;
                if self.communicator.ranks() > 1 {
                    results.add(outcome.as_ref());
                }
                if let Some(outcome) = outcome {
                    self.send_smoothed(number, cycle, &outcome)?;
                    self.send_forecasts(number, cycle, &outcome.analysis.estimate, &observed)?;
                    self.send_parameters(number, cycle)?;
                    self.send_verdicts(number, cycle, outcome.verdicts)?;
                }
            }
            self.events.send(&Event::CycleEnded(cycle))?;
            let AfterCycle { keeps, ends } =
                after_cycle(self.communicator, cycle, self.events.keeper.as_ref(), &results)?;
            if keeps {
                match &mut self.events.keeper {
                    Some(keeper) => keeper.write(cycle, self.experiment, &self.scores)?,
                    None => take_part(self.experiment).map_err(RunError::Unsaved)?,
                }
            }
            if ends && cycle < cycles {
                return Err(RunError::Interrupted { cycle, cycles });
            }
        }
        let ranks = exchanged(self.communicator, sent_before, cycles - done);
        Ok(summary(self.experiment, &self.scores, self.shown.memory, ranks))
    }

    fn send_truth(&mut self, cycle: usize) -> Result<(), RunError> {
        let Experiment { info, truth, observing, .. } = &*self.experiment;
        let Some(truth) = truth else { return Ok(()) };
        let (state, calibration) = (Cow::Borrowed(truth.state()), observing.true_calibration().into());
        Ok(self.events.send(&Event::Truth { cycle, time: info.time(cycle), state, calibration })?)
    }

    /// Advances truth and reference by a cycle, and observes the truth if there is one.
    fn observe(&mut self, cycle: usize) -> Result<Observed, RunError> {
        let Experiment { info, truth, reference, observing, comparisons, methods, .. } = &mut *self.experiment;
        if let Some(truth) = truth {
            self.workers.install(|| truth.advance()).map_err(|error| RunError::Truth { cycle, error })?;
        }
        if let Some(reference) = reference {
            self.workers.install(|| reference.advance(cycle));
        }
        let state = truth.as_ref().map(Truth::state);
        let through = truth.as_ref().map(Truth::window);
        let mut window = observing.observe_checked(through, reference.as_ref().map(Reference::now));
        window.comparisons = comparisons.of_cycle(window.time, info.window, observing.true_calibration());
        self.scores.observations.add(&window, &info.layout);
        if let Some(state) = state {
            let truth = TrueValues { state, calibration: observing.true_calibration() };
            let lags = methods.iter().filter_map(|method| method.runner.smoother_lag());
            self.scores.earlier_truths.add(truth, lags.max());
        }
        self.send_truth(cycle)?;
        let Experiment { observing, methods, .. } = &*self.experiment;
        let values_bias_removed = observing.values_bias_removed();
        let bias_removed =
            methods.iter().any(|method| method.bias_known).then(|| window.with_values(values_bias_removed));
        let event = Event::Observed { window: Cow::Borrowed(&window), values_bias_removed: values_bias_removed.into() };
        self.events.send(&event)?;
        let Experiment { info, units, .. } = &mut *self.experiment;
        let warnings = units.check(&window, &info.calibration);
        warnings.iter().try_for_each(|warning| self.events.send(&Event::Warning(warning)))?;
        Ok(Observed { window, bias_removed })
    }

    /// A cycle of one method, with its scores; `None` if the method fails, or has failed before.
    fn one_method(&mut self, number: usize, cycle: usize, observed: &Observed) -> Result<Option<Outcome>, RunError> {
        let Experiment { info, influence_every_cycles, truth, observing, methods, .. } = &mut *self.experiment;
        let method = &mut methods[number];
        if method.failure.is_some() {
            return Ok(None);
        }
        let is_scored = cycle >= info.scored_from();
        let with_influence = is_scored && influence_every_cycles.is_some_and(|every| cycle.is_multiple_of(every));
        let observed = observed.as_given_to(method);
        let last = cycle == info.cycles;
        let outcome = self.workers.install(|| method.runner.cycle(info.window, observed, with_influence, last));
        let outcome = match outcome {
            Ok(outcome) => outcome,
            Err(fault) => {
                refuse_panic(self.communicator, &fault, cycle, &info.methods[number].name)?;
                method.ahead.clear();
                let failure = method.failure.insert(Failure { cycle, reason: clean(&fault.to_string()) });
                self.events.send(&Event::Failed { method: number, failure: Cow::Borrowed(failure) })?;
                return Ok(None);
            }
        };
        let calibration = observing.true_calibration();
        let truth = truth.as_ref().map(|truth| TrueValues { state: truth.state(), calibration });
        let of_corrections = || measures::of_corrections(&method.runner.parameters(), &method.true_corrections);
        let corrections = (!method.true_corrections.is_empty()).then(of_corrections);
        let scores = Scorecard::of_cycle(truth, &outcome, observed, &info.calibration, method.scores_bias, corrections);
        if is_scored {
            self.scores.totals[number].add(&scores);
        }
        let factors = shown_factors(cycle, info);
        let structure = || method.runner.structure(observed, &outcome.background.state, factors);
        let middle = Correlations::middle(&info.layout);
        let correlations = || method.runner.correlations(middle, &outcome.analysis.estimate);
        let bytes = self.shown.memory.then_some(method.runner.progress().peak_bytes);
        self.events.send(&Event::Analysed(Analysed {
            method: number,
            cycle,
            time: observed.time,
            background: Cow::Borrowed(&outcome.background),
            analysis: Cow::Borrowed(&outcome.analysis),
            unused: Cow::Borrowed(&outcome.unused),
            readings: outcome.readings.as_ref().map(Cow::Borrowed),
            scores: Cow::Owned(with_cost(scores.values(), outcome.seconds, bytes)),
            structure: self.shown.structure.then(structure).flatten().map(Cow::Owned),
            correlations: (self.shown.structure && last).then(correlations).flatten().map(Cow::Owned),
        }))?;
        if let Some(warning) = outcome.analysis.warnings.first()
            && !std::mem::replace(&mut method.has_warned, true)
        {
            let name = &info.methods[number].name;
            let text = format!("method {name}, cycle {cycle}: {warning}; said of the first such cycle only");
            self.events.send(&Event::Warning(&text))?;
        }
        Ok(Some(outcome))
    }

    /// Scores and sends the estimates of earlier cycles that a method has revised.
    fn send_smoothed(&mut self, number: usize, cycle: usize, outcome: &Outcome) -> Result<(), RunError> {
        let Experiment { info, methods, .. } = &*self.experiment;
        // The cycles of earlier runs are in files that are complete.
        for smoothed in outcome.smoothed.iter().filter(|smoothed| cycle - smoothed.cycles_ago > info.done) {
            let (ago, truths) = (smoothed.cycles_ago, &self.scores.earlier_truths);
            let earlier = cycle - ago;
            let scores = Scorecard::of_smoothed(truths, ago, &smoothed.estimate, methods[number].scores_bias);
            if earlier >= info.scored_from() {
                self.scores.totals[number].add(&scores);
            }
            self.events.send(&Event::Smoothed(Smoothed {
                method: number,
                cycle: earlier,
                later_cycles: ago,
                estimate: Cow::Borrowed(&smoothed.estimate),
                scores: Cow::Owned(scores.values()),
            }))?;
        }
        Ok(())
    }

    /// Scores and sends the forecasts ahead of a method that are valid now, and makes those from its analysis if they are due.
    fn send_forecasts(
        &mut self,
        number: usize,
        cycle: usize,
        analysis: &Estimate,
        observed: &Observed,
    ) -> Result<(), RunError> {
        let Experiment { info, climate, truth, methods, .. } = &mut *self.experiment;
        let Some(times) = info.lead_times else { return Ok(()) };
        let method = &mut methods[number];
        let is_start = times.starts_from(cycle, info.score_from_cycle);
        let observed = observed.as_given_to(method);
        let passive = info.networks.iter().any(|network| network.has_passive);
        let verifying = match truth {
            Some(truth) => Verifying::Truth { truth: truth.state(), climate },
            None => Verifying::Observations { observed, passive },
        };
        let mut due = method.ahead.due(cycle);
        due.extend(is_start.then(|| Pending { from_cycle: cycle, cycle, estimate: analysis.clone() }));
        for Pending { from_cycle, cycle, estimate } in due {
            let measured = forecast::measure(&estimate, &verifying);
            let totals = &mut self.scores.totals[number];
            totals.forecasts.add(cycle - from_cycle, &measured);
            let warnings: Vec<WarningCase> =
                info.warnings.iter().map(|warning| judged(warning, &estimate, &verifying)).collect();
            totals.warnings.add(cycle - from_cycle, &warnings, estimate.state_spread.is_some());
            self.events.send(&Event::Forecast(Forecast {
                method: number,
                from_cycle,
                cycle,
                estimate: Cow::Owned(estimate),
                scores: Cow::Owned(forecast::values(&measured)),
                warnings: Cow::Owned(warnings),
            }))?;
        }
        if !is_start {
            return Ok(());
        }
        let Competitor { runner, ahead, memory_limit_bytes, .. } = method;
        let (limit, last) = (*memory_limit_bytes, if self.goes_on { usize::MAX } else { info.cycles });
        let communicator = self.communicator;
        let start = || ahead.start(runner, cycle, &times, info.window, last, limit, communicator);
        let made = self.workers.install(start);
        if let Err(fault) = &made {
            refuse_panic(communicator, fault, cycle, &info.methods[number].name)?;
        }
        if !info.warnings.is_empty() {
            let probabilities = |forecast: &Pending| {
                let all = info.warnings.iter().map(|warning| warning.probability(&forecast.estimate)).collect();
                (forecast.cycle - cycle, all)
            };
            let outlook = Outlook { from_cycle: cycle, leads: ahead.from(cycle).map(probabilities).collect() };
            self.scores.totals[number].warnings.add_outlook(outlook.clone());
            self.events.send(&Event::Outlook { method: number, outlook: Cow::Owned(outlook) })?;
        }
        let Err(fault) = made else { return Ok(()) };
        self.scores.totals[number].forecasts.add_failed();
        if !std::mem::replace(&mut method.has_warned_ahead, true) {
            let name = &info.methods[number].name;
            let fault = clean(&fault.to_string());
            let text = format!(
                "method {name}: a forecast ahead of cycle {cycle} cannot be made to its end: {fault}; said of the first \
                 such forecast only"
            );
            self.events.send(&Event::Warning(&text))?;
        }
        Ok(())
    }

    /// Sends what a method has estimated beside state and calibration.
    fn send_parameters(&mut self, number: usize, cycle: usize) -> Result<(), RunError> {
        let Experiment { info, methods, .. } = &*self.experiment;
        let parameters = methods[number].runner.parameters();
        if !parameters.is_empty() {
            let (time, parameters) = (info.time(cycle), parameters.into());
            self.events.send(&Event::Estimated(Estimated { method: number, cycle, time, parameters }))?;
        }
        Ok(())
    }

    /// Sends the verdicts on a method's biases that are new.
    fn send_verdicts(&mut self, number: usize, cycle: usize, verdicts: Vec<Verdict>) -> Result<(), RunError> {
        if !verdicts.is_empty() {
            let time = self.experiment.info.time(cycle);
            self.events.send(&Event::Judged(Judged { method: number, cycle, time, verdicts: verdicts.into() }))?;
        }
        Ok(())
    }
}

/// What the ranks have sent in some cycles, given what this one had sent before; `None` if there is one rank.
fn exchanged(communicator: &dyn Communicator, before: Sent, cycles: usize) -> Option<Exchanged> {
    let count = communicator.ranks();
    if count == 1 {
        return None;
    }
    let Sent { messages, bytes } = communicator.sent();
    let own = [messages - before.messages, bytes - before.bytes].map(|sent| sent as f64 / cycles.max(1) as f64);
    let of_ranks = communicator.gather_all(&own);
    let most = |number: usize| of_ranks.iter().map(|of_rank| of_rank[number]).fold(0.0, f64::max);
    Some(Exchanged { count, messages_per_cycle: most(0), bytes_per_cycle: most(1) })
}

/// Ends a run of several ranks with a panic: the others may wait for what this one was to send.
fn refuse_panic(communicator: &dyn Communicator, fault: &Fault, cycle: usize, method: &str) -> Result<(), RunError> {
    match fault {
        Fault::Panic(_) if communicator.ranks() > 1 => {
            Err(RunError::Panic { cycle, method: method.to_string(), fault: clean(&fault.to_string()) })
        }
        _ => Ok(()),
    }
}

/// A warning of a forecast whose valid time has come.
fn judged(warning: &PlacedWarning, forecast: &Estimate, verifying: &Verifying<'_>) -> WarningCase {
    let probability = warning.probability(forecast);
    let occurred = match verifying {
        Verifying::Truth { truth, .. } => Some(warning.occurred(truth)),
        Verifying::Observations { observed, passive } => warning.observed(observed, *passive, forecast.state.layout()),
    };
    WarningCase { probability, issued: warning.issues(probability), occurred }
}

/// How many common factors are shown: a few, and in the first, the last and some cycles between, since each is as large
/// as a state.
fn shown_factors(cycle: usize, info: &RunInfo) -> usize {
    const FACTORS: usize = 5;
    let every = info.count().div_ceil(8);
    if cycle == info.done + 1 || cycle == info.cycles || cycle.is_multiple_of(every) { FACTORS } else { 0 }
}
