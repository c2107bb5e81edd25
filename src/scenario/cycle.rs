//! `[cycle]`, `[diagnostics]` and `[output]`: how long the run is, what is found out and written.

use crate::output::{OUTPUTS, Outputs};
use crate::reader::{Absent, AnyKey, Described, Form, Key, Limits, Read, Section, Whole};
use isobar_model::{Duration, Time};

/// The cycles of forecast and analysis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSettings {
    /// Number of cycles.
    pub count: usize,
    /// Length of a cycle: a whole multiple of the time steps of model and truth.
    pub window: Duration,
    /// First cycle, from 1, that counts for the scores.
    pub score_from_cycle: usize,
}

/// The last time a run may reach: the year 9000.
const LAST_SECONDS: i64 = 221_845_392_000;

/// The most cycles.
const MOST_CYCLES: usize = 1_000_000;

const COUNT: Key<Whole> = Key::required("count", "cycles", Whole(1, MOST_CYCLES), "number of cycles");

const WINDOW_HOURS: Key<Limits> = Key::required(
    "window_hours",
    "h",
    Limits::Between(1.0 / 3600.0, 8760.0),
    "length of a cycle: whole seconds, and a whole multiple of the time step",
);

const SCORE_FROM_CYCLE: Key<Described> = Key::absent(
    "score_from_cycle",
    "",
    Described("a whole number from 1 to `count`", || Form::Whole(1, MOST_CYCLES as i64)),
    Absent::Means("1"),
    "the first cycle that counts for the scores",
);

/// The keys of `[cycle]`.
pub(super) const KEYS: &[&dyn AnyKey] = &[&COUNT, &WINDOW_HOURS, &SCORE_FROM_CYCLE];

const INFLUENCE: Key<Whole> = Key::required(
    "influence_every_cycles",
    "cycles",
    Whole(1, 1_000_000),
    "how often it is found out what each type of observations is worth; each time costs additional analyses, one more than \
     there are types",
);

/// The keys of `[diagnostics]`.
pub(super) const DIAGNOSTICS_KEYS: &[&dyn AnyKey] = &[&INFLUENCE];

/// The form of `[output]`: whether each output is written.
pub(super) fn output_form() -> Form {
    Form::Entries(OUTPUTS.iter().filter(|output| output.by_default).map(|output| (output.name, Form::YesNo)).collect())
}

pub(super) fn read(root: &Section<'_>, start: Time, steps: &[(&str, Duration)]) -> Read<CycleSettings> {
    let section = root.required("cycle")?.section_with(KEYS)?;
    let (count_field, count) = (section.required(COUNT.name)?, section.get(&COUNT)?);
    let (window_field, hours) = (section.required(WINDOW_HOURS.name)?, section.get(&WINDOW_HOURS)?);
    let seconds = (hours * 3600.0).round();
    if (hours * 3600.0 - seconds).abs() > 1e-6 {
        let message = format!("a window of {hours} hours is not a whole number of seconds");
        return Err(window_field.invalid(message, "must be a whole number of seconds"));
    }
    let window = Duration::from_seconds(seconds as i64);
    for (key, step) in steps {
        if window.steps_of(*step).is_none() {
            let message = format!("a window of {hours} hours ({window}) is not a whole multiple of {key} = {step}");
            return Err(window_field.invalid(message, &format!("must be a whole multiple of {step}")));
        }
    }
    if start.seconds() + window.seconds() * count as i64 > LAST_SECONDS {
        let message = format!("{count} cycles of {hours} hours end after the year 9000");
        return Err(count_field.invalid(message, "too many"));
    }
    let score_from_cycle = section.whole_or(SCORE_FROM_CYCLE.name, 1, 1, count)?;
    Ok(CycleSettings { count, window, score_from_cycle })
}

/// Reads `[diagnostics]`: the number of cycles between two in which the influence of each type of observations is computed;
/// `None`: never.
pub(super) fn read_diagnostics(root: &Section<'_>) -> Read<Option<usize>> {
    let Some(field) = root.optional("diagnostics") else { return Ok(None) };
    Ok(Some(field.section_with(DIAGNOSTICS_KEYS)?.get(&INFLUENCE)?))
}

/// Reads `[output]`: which outputs are written beside the summary and the scores.
pub(super) fn read_output(root: &Section<'_>) -> Read<Outputs> {
    let mut outputs = Outputs::by_default();
    let Some(field) = root.optional("output") else { return Ok(outputs) };
    let keys: Vec<&str> = OUTPUTS.iter().filter(|output| output.by_default).map(|output| output.name).collect();
    let section = field.section(&keys)?;
    for key in keys {
        outputs.set(key, section.yes_or_no_or(key, true)?);
    }
    Ok(outputs)
}
