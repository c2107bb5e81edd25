//! `[forecast]`: forecasts ahead of the analyses, and their lead times.

use crate::lead_times::LeadTimes;
use crate::reader::{Absent, AnyKey, Field, Key, Limits, Read, Section, Whole};
use isobar_model::Duration;

const LEAD_HOURS: Key<Limits> = Key::required(
    "lead_hours",
    "h",
    Limits::Positive,
    "how far a forecast goes: whole cycles; one from the first cycle that counts must end within the run",
);

const EVERY_HOURS: Key<Limits> = Key::absent(
    "every_hours",
    "h",
    Limits::Positive,
    Absent::Explained("the length of a cycle"),
    "the lead times at which forecasts are looked at: whole cycles; `lead_hours` is a multiple",
);

const FROM_EVERY_CYCLES: Key<Whole> = Key::absent(
    "from_every_cycles",
    "cycles",
    Whole(1, 1_000_000),
    Absent::Means(1),
    "the number of cycles from one forecast's start to the next, from the first cycle that counts on",
);

/// All keys.
pub(crate) const KEYS: &[&dyn AnyKey] = &[&LEAD_HOURS, &EVERY_HOURS, &FROM_EVERY_CYCLES];

/// Reads `[forecast]` of a run with this number and length of cycles.
pub(crate) fn read(
    root: &Section<'_>,
    window: Duration,
    cycles: usize,
    score_from_cycle: usize,
) -> Read<Option<LeadTimes>> {
    let Some(field) = root.optional("forecast") else { return Ok(None) };
    let section = field.section_with(KEYS)?;
    let longest = section.required(LEAD_HOURS.name)?;
    let longest_cycles = whole_cycles(&longest, window)?;
    if score_from_cycle + longest_cycles > cycles {
        let message = format!(
            "`{}` is {longest_cycles} cycles: a forecast from cycle {score_from_cycle}, the first that counts, would end \
             after the last, cycle {cycles}",
            longest.title()
        );
        let most = window.hours() * (cycles - score_from_cycle) as f64;
        let allowed = if most > 0.0 { format!("must be at most {most}") } else { "no cycle comes after it".into() };
        return Err(longest.invalid(message, &allowed));
    }
    let every = section.optional(EVERY_HOURS.name);
    let every_cycles = every.as_ref().map_or(Ok(1), |field| whole_cycles(field, window))?;
    if let Some(every) = every.filter(|_| !longest_cycles.is_multiple_of(every_cycles)) {
        let message = format!(
            "`{}` is {longest_cycles} cycles, which is no multiple of the {every_cycles} cycles of `{}`",
            longest.title(),
            every.title()
        );
        return Err(every.invalid(message, "must go into lead_hours"));
    }
    let from_every_cycles = section.get(&FROM_EVERY_CYCLES)?;
    Ok(Some(LeadTimes { longest_cycles, every_cycles, from_every_cycles }))
}

/// A time in hours as a number of cycles, at least one.
fn whole_cycles(field: &Field<'_>, window: Duration) -> Read<usize> {
    let (given, cycle) = (field.number(Limits::Positive)?, window.hours());
    let cycles = (given / cycle).round();
    if cycles < 1.0 || (given - cycles * cycle).abs() * 3600.0 > 1e-6 * cycles.max(1.0) || cycles > 1e6 {
        let message = format!("`{}` is {given}, which is not a whole number of cycles of {cycle} hours", field.title());
        return Err(field.invalid(message, &format!("must be a multiple of {cycle}")));
    }
    Ok(cycles as usize)
}
