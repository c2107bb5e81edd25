//! What a run has found, in a few sentences and one figure: which method is best, how far the others are behind and at what
//! cost, and whether they know their errors.

use super::section::Drawing;
use crate::event::{MethodInfo, RunInfo};
use crate::plot::colors::of_method_on_paper;
use crate::plot::intervals::{Known, Row};
use crate::plot::{IntervalPlot, unit};
use crate::scores::kinds::SECONDS;
use crate::scores::{MethodScores, Summary};
use crate::tables::diagnostics::RIGHT;
use crate::tables::figure;
use crate::text::listed;

/// The most methods that a sentence names.
const MOST_NAMED: usize = 6;

/// A time between these multiples of the best method's is not mentioned.
const SAME_TIME: [f64; 2] = [0.67, 1.5];

/// A method with its error.
struct Entry<'a> {
    number: usize,
    name: &'a str,
    error: f64,
    scores: &'a MethodScores,
}

/// The methods that have a score of a variable, the best first.
fn ranked<'a>(info: &'a RunInfo, summary: &'a Summary, kind: &str, variable: &str) -> Vec<Entry<'a>> {
    let key = format!("{kind}.{variable}");
    let entry = |(number, method): (usize, &'a MethodInfo)| {
        let scores = summary.methods.get(&method.name)?;
        let error = *scores.values.get(&key).filter(|error| error.is_finite() && **error > 0.0)?;
        Some(Entry { number, name: &method.name, error, scores })
    };
    let mut all: Vec<Entry<'_>> = info.methods.iter().enumerate().filter_map(entry).collect();
    all.sort_by(|a, b| a.error.total_cmp(&b.error));
    all
}

/// The score by which methods are compared, and what it is called.
fn measure(info: &RunInfo) -> (&'static str, &'static str) {
    if info.has_truth {
        ("rmse_analysis", "analysis error")
    } else {
        // Every method can fit what it has seen.
        ("departure_background", "departure of the observations from the background")
    }
}

/// The sentences; none if fewer than two methods have a score.
pub fn sentences(info: &RunInfo, summary: &Summary) -> Vec<String> {
    let Some(variable) = info.layout.variables.first() else { return Vec::new() };
    let (kind, called) = measure(info);
    let all = ranked(info, summary, kind, variable.name);
    let Some((best, others)) = all.split_first().filter(|(_, others)| !others.is_empty()) else { return Vec::new() };
    let mut sentences = vec![format!(
        "{} has the smallest {called} of {}: {} {}.",
        best.name,
        variable.name,
        figure(best.error),
        unit(variable.unit)
    )];
    let behind: Vec<String> = others.iter().take(MOST_NAMED).map(|other| behind(best, other)).collect();
    let more = others.len().saturating_sub(MOST_NAMED);
    let more = if more > 0 { format!(", and {more} more are further behind") } else { String::new() };
    sentences.push(format!("Behind it: {}{more}.", behind.join(", ")));
    sentences.extend(claims(&all, variable.name));
    let failed: Vec<&str> = summary.failures().map(|(name, _)| name).collect();
    if !failed.is_empty() {
        sentences.push(format!("Failed: {}.", listed(failed.into_iter())));
    }
    sentences
}

/// How far a method is behind the best, and its time if that differs.
fn behind(best: &Entry<'_>, other: &Entry<'_>) -> String {
    let ratio = other.error / best.error;
    let distance = match ratio {
        ratio if ratio < 1.005 => "as good".to_string(),
        ratio if ratio < 1.995 => format!("{:.0} % larger", 100.0 * (ratio - 1.0)),
        ratio if ratio < 9.95 => format!("{ratio:.1} times as large"),
        ratio => format!("{ratio:.0} times as large"),
    };
    let seconds = |entry: &Entry<'_>| entry.scores.values.get(SECONDS).copied().filter(|seconds| *seconds > 0.0);
    let time = seconds(other).zip(seconds(best)).map(|(own, best)| own / best);
    let time = time.filter(|time| !(SAME_TIME[0]..SAME_TIME[1]).contains(time) && ratio < 1.995);
    let time = time.map_or(String::new(), |time| match time {
        time if time < 0.01 => " in less than 1 % of its time".into(),
        time if time < 1.0 => format!(" in {:.0} % of its time", 100.0 * time),
        time if time < 9.95 => format!(" in {time:.1} times its time"),
        time => format!(" in {time:.0} times its time"),
    });
    format!("{} ({distance}{time})", other.name)
}

/// Whether the methods claim the errors that they have.
fn claims(all: &[Entry<'_>], variable: &str) -> Option<String> {
    let key = format!("spread_analysis.{variable}");
    let claim = |entry: &Entry<'_>| Some(entry.scores.values.get(&key)? / entry.error);
    let mut groups: [(&str, Vec<String>); 3] = [("right", vec![]), ("too small", vec![]), ("too large", vec![])];
    for entry in all {
        let Some(ratio) = claim(entry).filter(|ratio| ratio.is_finite()) else { continue };
        let (group, text) = match ratio {
            ratio if ratio < RIGHT[0] => (1, format!("{} (by {:.0} %)", entry.name, 100.0 * (1.0 - ratio))),
            ratio if ratio > RIGHT[1] => (2, format!("{} (by {:.0} %)", entry.name, 100.0 * (ratio - 1.0))),
            _ => (0, entry.name.to_string()),
        };
        groups[group].1.push(text);
    }
    let parts = groups.iter().filter(|(_, names)| !names.is_empty());
    let parts: Vec<String> = parts.map(|(verdict, names)| format!("{verdict} for {}", names.join(", "))).collect();
    (!parts.is_empty()).then(|| format!("The claimed error is {}.", parts.join("; ")))
}

/// The errors of all methods with their intervals and claims, the best above.
pub fn drawing(info: &RunInfo, summary: &Summary, variable: usize) -> Option<Drawing<IntervalPlot>> {
    let variable = info.layout.variables.get(variable)?;
    let (kind, called) = measure(info);
    let (key, claimed) = (format!("{kind}.{}", variable.name), format!("spread_analysis.{}", variable.name));
    let row = |entry: Entry<'_>| {
        let interval = entry.scores.intervals.get(&key).map(|it| [it.low, it.high]);
        let claimed = entry.scores.values.get(&claimed).copied().filter(|_| info.has_truth);
        let title = format!("{}: {} {}", entry.name, figure(entry.error), unit(variable.unit));
        let known = Known { series: entry.number, value: entry.error, interval, claimed, title };
        Row { label: entry.name.to_string(), values: vec![known] }
    };
    let rows: Vec<Row> = ranked(info, summary, kind, variable.name).into_iter().map(row).collect();
    let series = (0..info.methods.len()).map(|number| (None, of_method_on_paper(number))).collect();
    let claims = if info.has_truth { "; ring: what the method claims it to be" } else { "" };
    (!rows.is_empty()).then(|| Drawing {
        stem: format!("scores_{}", variable.name),
        caption: format!(
            "Root-mean-square {called} of {} over the cycles that count, with its 95 % interval{claims}.",
            variable.long_name
        ),
        plot: IntervalPlot {
            title: format!("{} of {}", if info.has_truth { "error" } else { "departure" }, variable.name),
            label: format!("[{}]", unit(variable.unit)),
            series,
            rows,
            reference: None,
            from_zero: true,
            width: 440.0,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(error: f64, spread: Option<f64>, seconds: f64) -> MethodScores {
        let mut values: crate::scores::Values =
            [("rmse_analysis.h".to_string(), error), (SECONDS.to_string(), seconds)].into();
        values.extend(spread.map(|spread| ("spread_analysis.h".to_string(), spread)));
        MethodScores { values, ..MethodScores::default() }
    }

    #[test]
    fn distances_and_times_are_put_in_words() {
        let methods = [scores(4.0, Some(4.1), 2.0), scores(4.4, Some(3.0), 0.3), scores(40.0, None, 0.1)];
        let names = ["kf", "fkf", "free"];
        let entries: Vec<Entry<'_>> = methods
            .iter()
            .enumerate()
            .map(|(number, scores)| Entry {
                number,
                name: names[number],
                error: scores.values["rmse_analysis.h"],
                scores,
            })
            .collect();
        assert_eq!(behind(&entries[0], &entries[1]), "fkf (10 % larger in 15 % of its time)");
        assert_eq!(behind(&entries[0], &entries[2]), "free (10 times as large)");
        let claims = claims(&entries, "h").unwrap();
        assert_eq!(claims, "The claimed error is right for kf; too small for fkf (by 32 %).");
    }
}
