//! Going on from an earlier run: the state in which a run ends, in a file of its directory, is that in which another begins.
//!
//! The second run is the rest of the longer one that both are: it counts its cycles on, draws its random numbers from the same
//! streams on, and asks what is to happen in a cycle by its number and time in the whole. Only its outputs and its scores are
//! those of the cycles that it does.

mod known;
mod settings;

pub use known::Earlier;

use super::checkpoint::saved::{Saved, save};
use super::experiment::Experiment;
use crate::calendar::utc;
use crate::options::RunOptions;
use crate::output::directory::{SEEDS_FILE, SUMMARY_FILE, SWEEP_FILE, Stage, stage};
use crate::output::{STATE_FILE, SinkError};
use crate::scenario::Scenario;
use crate::sealed::{Contents, Format, Memories};
use crate::shell::command;
use crate::text::{clean, listed};
use isobar_assim::Recalibration;
use isobar_model::{Duration, Time};
use isobar_obs::Calibration;
use serde::{Deserialize, Serialize};
use settings::Settings;
use std::fs::File;
use std::path::Path;

const FORMAT: Format = Format { name: "final state", number: 4 };

/// The most differences that a message lists.
const MOST_LISTED: usize = 20;

/// The state in which a run ends, but for the methods' own memory, which follows in the file. The same cycles lead to the same
/// bits, in however many runs.
#[derive(Debug, Serialize, Deserialize)]
struct FinalState {
    settings: Settings,
    seed: u64,
    /// Valid time of the state before cycle 1.
    start: Time,
    window: Duration,
    /// The parameters, with what was known of them at the start.
    calibration: Calibration,
    /// The recalibrations that were known.
    recalibrations: Vec<Recalibration>,
    saved: Saved,
}

impl FinalState {
    /// Whether one can calculate with start, window and cycles; those of a file that no run wrote may be any numbers.
    fn has_possible_times(&self) -> bool {
        const MOST_CYCLES: usize = 1_000_000_000;
        const LONGEST_S: i64 = 1_000_000_000_000;
        (-LONGEST_S..LONGEST_S).contains(&self.start.seconds())
            && (1..=366 * 86_400).contains(&self.window.seconds())
            && (1..=MOST_CYCLES).contains(&self.saved.cycle)
    }
}

/// Writes the final state of an experiment whose last cycle is done into the directory of its outputs.
///
/// # Errors
/// If it cannot be written.
pub fn write(directory: &Path, scenario: &Scenario, experiment: &mut Experiment) -> Result<(), SinkError> {
    let mut saved = Saved::of(experiment.info.cycles, experiment);
    saved.methods.iter_mut().flat_map(|method| &mut method.progress).for_each(|progress| progress.forget_cost());
    let info = &experiment.info;
    let state = FinalState {
        settings: Settings::of(scenario),
        seed: info.seed,
        start: info.start,
        window: info.window,
        calibration: info.calibration.clone(),
        recalibrations: experiment.recalibrations.clone(),
        saved,
    };
    let path = directory.join(STATE_FILE);
    let written = FORMAT.write(&path, &state, experiment.methods.len(), &|number, to| save(experiment, number, to));
    written.map_err(|error| SinkError { path, reason: error.to_string() })
}

/// A run from whose final state another goes on.
#[derive(Debug)]
pub struct EarlierRun {
    state: FinalState,
    memories: Memories<File>,
    checksum: u32,
}

impl EarlierRun {
    /// Reads the final state in a run's directory.
    ///
    /// # Errors
    /// In words: there is no such run, it is not complete or has no final state, or that cannot be used.
    pub fn read(directory: &Path) -> Result<Self, String> {
        if [SEEDS_FILE, SWEEP_FILE].iter().any(|file| directory.join(file).is_file()) {
            return Err("it holds a batch of runs, which ends in no single state".into());
        }
        if !directory.join(SUMMARY_FILE).is_file() {
            return Err(match stage(directory) {
                Ok(Stage::Interrupted | Stage::Complete) => {
                    format!("that run is not complete: `{}` goes on with it", command("isobar resume", &[directory]))
                }
                _ if directory.is_dir() => format!("it is not the directory of a run: it has no {SUMMARY_FILE}"),
                _ => "there is no such directory".into(),
            });
        }
        if !directory.join(STATE_FILE).exists() {
            return Err(format!(
                "it has no {STATE_FILE}: the run was made with --no-state or `output.state = false`, or by a version of isobar \
                 that kept none"
            ));
        }
        let contents = FORMAT.read::<FinalState>(&directory.join(STATE_FILE));
        let Contents { head: state, memories, checksum } =
            contents.map_err(|reason| format!("{STATE_FILE}: {reason}"))?;
        if !state.has_possible_times() {
            return Err(format!("{STATE_FILE}: its times are impossible"));
        }
        Ok(Self { state, memories, checksum })
    }

    /// What a run of a scenario must know to be set up.
    ///
    /// # Errors
    /// What keeps the scenario and the options from going on, a line for each.
    pub fn check(&self, scenario: &Scenario, options: &RunOptions) -> Result<Earlier, String> {
        let mut lines = Vec::new();
        let end = self.end();
        if scenario.start != end {
            let (end, now) = (utc(end), utc(scenario.start));
            lines.push(format!("start: it must be where that run ended, `start = \"{end}\"`; now {now}"));
        }
        lines.extend(self.differences_from(scenario, options));
        let count = options.cycles.unwrap_or(scenario.cycle.count);
        let (last, scored) = (self.state.saved.cycle + count, scenario.cycle.score_from_cycle);
        if last < scored {
            lines.push(format!(
                "cycle.score_from_cycle: no cycle counts, for cycles go on and {last} is the last; now {scored}"
            ));
        }
        self.unless(lines, scenario)
    }

    /// What must be known to look at the state in which the run ended: of the run's own scenario, or of one that goes on from
    /// it.
    ///
    /// # Errors
    /// As [`EarlierRun::check`].
    pub fn check_end(&self, scenario: &Scenario, options: &RunOptions) -> Result<Earlier, String> {
        let (start, end) = (self.state.start, self.end());
        let mut lines = Vec::new();
        if ![start, end].contains(&scenario.start) {
            let (start, end, now) = (utc(start), utc(end), utc(scenario.start));
            lines.push(format!("start: that run, or those before it, went from {start} to {end}; now {now}"));
        }
        lines.extend(self.differences_from(scenario, options));
        self.unless(lines, scenario)
    }

    /// The seed of the run.
    pub fn seed(&self) -> u64 {
        self.state.seed
    }

    /// The time of the state in which the run ended.
    fn end(&self) -> Time {
        self.state.start + self.state.window * self.state.saved.cycle
    }

    /// What a run must know, unless something differs.
    fn unless(&self, lines: Vec<String>, scenario: &Scenario) -> Result<Earlier, String> {
        if !lines.is_empty() {
            return Err(in_lines(lines));
        }
        let FinalState { start, calibration, recalibrations, saved, .. } = &self.state;
        let sensors = scenario.sensors.is_some().then(|| (calibration.clone(), recalibrations.clone()));
        Ok(Earlier { start: *start, cycles: saved.cycle, sensors, checksum: self.checksum })
    }

    /// How a scenario and the options differ from those of the run, a line for each difference.
    fn differences_from(&self, scenario: &Scenario, options: &RunOptions) -> Vec<String> {
        let FinalState { settings, seed, saved, .. } = &self.state;
        let had: Vec<&str> = saved.methods.iter().map(|method| method.name.as_str()).collect();
        let chosen = |name: &&str| options.methods.as_ref().is_none_or(|chosen| chosen.iter().any(|it| it == name));
        let methods: Vec<&str> = scenario.methods.keys().map(String::as_str).filter(chosen).collect();
        let (continued, new): (Vec<&str>, Vec<&str>) = methods.into_iter().partition(|name| had.contains(name));
        let mut lines = Vec::new();
        let seed_now = options.seed.unwrap_or(scenario.seed);
        if seed_now != *seed {
            lines.push(format!("seed: {seed} before, {seed_now} now"));
        }
        if !new.is_empty() {
            let (new, had) = (listed(new), listed(had.iter().copied()));
            lines.push(format!("methods: that run has no state of {new}, but of {had}; --methods leaves others out"));
        }
        lines.extend(Settings::of(scenario).differences(settings, &continued));
        lines
    }

    /// Sets an experiment that has just been built to the final state of this run.
    ///
    /// # Errors
    /// In words, if its calibration parameters are others, or it is another experiment in another way.
    pub fn restore(self, experiment: &mut Experiment) -> Result<(), String> {
        let Self { state, mut memories, .. } = self;
        let lines = differences(&state.calibration, &experiment.info.calibration);
        if !lines.is_empty() {
            return Err(in_lines(lines));
        }
        state.saved.restore(&mut memories, experiment).map_err(|reason| format!("{STATE_FILE}: {reason}"))
    }
}

/// How the parameters of now differ from those before.
fn differences(before: &Calibration, now: &Calibration) -> Vec<String> {
    let only = |these: &Calibration, those: &Calibration, when: &str| {
        let is_there = |name: &str| those.parameters.iter().any(|it| it.name == name);
        let names = these.parameters.iter().filter(|it| !is_there(&it.name));
        names.map(|it| format!("calibration parameter {}: only {when}", clean(&it.name))).collect::<Vec<_>>()
    };
    let mut lines = only(before, now, "before");
    lines.extend(only(now, before, "now"));
    if lines.is_empty() && before != now {
        let pairs = before.parameters.iter().zip(&now.parameters);
        let changed = pairs.filter(|(before, now)| before != now).map(|(_, now)| clean(&now.name));
        lines
            .extend(changed.map(|name| format!("calibration parameter {name}: another one stood in its place before")));
        if lines.is_empty() {
            lines.push("covariances of the calibration parameters: others before".into());
        }
    }
    lines
}

fn in_lines(mut lines: Vec<String>) -> String {
    let more = lines.len().saturating_sub(MOST_LISTED);
    lines.truncate(MOST_LISTED);
    if more > 0 {
        lines.push(format!("and {more} more"));
    }
    format!("the scenario does not fit the state in which that run ended:\n{}", lines.join("\n"))
}
