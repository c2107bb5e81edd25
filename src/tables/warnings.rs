//! Warnings of forecasts ahead: how right their probabilities were, and what they say of the time to come.

use super::terminal::sentences;
use super::{Cell, NONE, Table};
use crate::plot;
use crate::scores::warnings::{LeadProbability, VerifiedWarnings};
use crate::scores::{Summary, WarningScores};
use indexmap::IndexSet;

/// The most lead times that a table shows.
const MOST_LEADS: usize = 11;

/// What the terminal shows: of each warning the scores of all methods over all lead times after the analysis, and the
/// probabilities in the last forecasts; `None` without warnings.
pub fn on_terminal(summary: &Summary, width: usize) -> Option<String> {
    let of_warning = |name: &String| {
        let title = format!("Warning {name}, over all lead times after the analysis: {}", frequency(summary, name));
        let mut text = format!("{}\n{}", sentences(&title, width), table(summary, name).terminal(width));
        if let Some((from_cycle, outlook)) = outlook(summary, name) {
            let title = format!("Probability of {name} ahead of the analysis of cycle {from_cycle}");
            text += &format!("\n{}\n{}", sentences(&title, width), outlook.terminal(width));
        }
        text
    };
    let names = names(summary);
    let notes = deterministic(summary).map(|text| sentences(&text, width));
    (!names.is_empty()).then(|| names.iter().map(of_warning).chain(notes).collect::<Vec<_>>().join("\n\n"))
}

/// The names of the warnings.
pub fn names(summary: &Summary) -> IndexSet<String> {
    all(summary).map(|(_, scores)| scores.name.clone()).collect()
}

/// Which methods claim no standard deviation, in words.
pub fn deterministic(summary: &Summary) -> Option<String> {
    let methods = summary.methods.iter().filter(|(_, scores)| scores.warnings.iter().any(|it| it.deterministic));
    let names: Vec<&str> = methods.map(|(name, _)| name.as_str()).collect();
    (!names.is_empty())
        .then(|| format!("Without a claimed spread, the probability of an event is 0 or 1: {}", names.join(", ")))
}

/// How often the event of a warning came about, in words.
pub fn frequency(summary: &Summary, name: &str) -> String {
    let most = of(summary, name).map(|(_, scores)| &scores.ahead).max_by_key(|ahead| ahead.cases);
    match most.filter(|ahead| ahead.cases > 0) {
        None => "nothing is known of the event yet".into(),
        Some(ahead) if ahead.occurred == 0 => format!("the event never occurred in {} cases", ahead.cases),
        Some(ahead) if ahead.occurred == ahead.cases => format!("the event occurred in all {} cases", ahead.cases),
        Some(ahead) => format!("the event occurred in {} of {} cases", ahead.occurred, ahead.cases),
    }
}

/// For each warning whose event never or always occurred, a note that its skill is undefined.
pub fn without_skill(summary: &Summary) -> Vec<String> {
    let says_nothing = |name: &&String| {
        let mut all = of(summary, name).map(|(_, scores)| &scores.ahead).filter(|ahead| ahead.cases > 0).peekable();
        all.peek().is_some() && all.all(|ahead| ahead.occurred == 0 || ahead.occurred == ahead.cases)
    };
    let names = names(summary);
    let text = |name: &String| {
        format!(
            "warnings.{name}: {}, so that nothing can be said of the skill of its warnings",
            frequency(summary, name)
        )
    };
    names.iter().filter(says_nothing).map(text).collect()
}

/// The columns of the scores of a warning.
const SCORES: [&str; 8] = [
    "Brier\n[1]",
    "skill\n[1]",
    "reliability\n[1]",
    "resolution\n[1]",
    "uncertainty\n[1]",
    "hits",
    "misses",
    "false\nalarms",
];

/// The scores of one warning over all lead times after the analysis, a row for each method.
pub fn table(summary: &Summary, name: &str) -> Table {
    let row =
        |(method, scores): (&str, &WarningScores)| std::iter::once(method.into()).chain(cells(&scores.ahead)).collect();
    Table::new(&[&["method"][..], &SCORES].concat(), of(summary, name).map(row).collect())
}

/// The same at each lead time, a row for each method and lead time.
pub fn by_lead(summary: &Summary, name: &str) -> Table {
    let rows = of(summary, name).flat_map(|(method, scores)| {
        scores.leads.iter().map(move |lead| {
            let first = [method.into(), plot::number(lead.lead_hours).into(), lead.scores.cases.into()];
            first.into_iter().chain(cells(&lead.scores)).collect::<Vec<Cell>>()
        })
    });
    Table::new(&[&["method", "lead time\n[h]", "cases"][..], &SCORES].concat(), rows.collect())
}

/// The cells of [`SCORES`].
fn cells(verified: &VerifiedWarnings) -> Vec<Cell> {
    let brier = verified.brier.as_ref();
    let interval = brier.and_then(|it| it.score.interval);
    let figures = [
        Cell::known(brier.map(|it| it.score.value), interval.as_ref()),
        Cell::figure(brier.and_then(|it| it.skill)),
        Cell::figure(brier.map(|it| it.reliability)),
        Cell::figure(brier.map(|it| it.resolution)),
        Cell::figure(brier.map(|it| it.uncertainty)),
    ];
    let counts = [verified.hits, verified.misses, verified.false_alarms].map(Cell::from);
    figures.into_iter().chain(counts).collect()
}

/// The cycle of the last analysis from which there are forecasts, and the probabilities of a warning's event in them, a row
/// for each method.
pub fn outlook(summary: &Summary, name: &str) -> Option<(usize, Table)> {
    let from_cycle = of(summary, name).filter_map(|(_, scores)| scores.outlook_from_cycle).max()?;
    let methods: Vec<(&str, &[LeadProbability])> = of(summary, name)
        .filter(|(_, scores)| scores.outlook_from_cycle == Some(from_cycle))
        .map(|(method, scores)| (method, &*scores.outlook))
        .collect();
    let longest = methods.iter().map(|(_, outlook)| *outlook).max_by_key(|outlook| outlook.len())?;
    let hours = longest.iter().step_by(longest.len().div_ceil(MOST_LEADS).max(1)).map(|it| it.lead_hours);
    let hours: Vec<f64> = hours.collect();
    let header = std::iter::once("method".to_string());
    let header = header.chain(hours.iter().map(|&hours| format!("{}\u{a0}h", plot::number(hours))));
    let row = |(method, outlook): &(&str, &[LeadProbability])| {
        let at = |hours: &f64| outlook.iter().find(|it| it.lead_hours == *hours).map(|it| it.probability);
        std::iter::once((*method).into()).chain(hours.iter().map(|hours| percent(at(hours)))).collect()
    };
    let rows = methods.iter().map(row).collect();
    Table { header: header.collect(), rows }.filled().filter(|_| !hours.is_empty()).map(|table| (from_cycle, table))
}

/// A probability in percent; one that is neither 0 nor 1 does not look like it.
fn percent(probability: Option<f64>) -> Cell {
    match probability {
        None => NONE.into(),
        Some(p) if p > 0.0 && p < 0.005 => "<1 %".into(),
        Some(p) if p < 1.0 && p > 0.995 => ">99 %".into(),
        Some(p) => format!("{:.0} %", 100.0 * p).into(),
    }
}

fn all(summary: &Summary) -> impl Iterator<Item = (&str, &WarningScores)> {
    summary.methods.iter().flat_map(|(name, scores)| scores.warnings.iter().map(move |it| (name.as_str(), it)))
}

/// The scores of the warning of this name, with the methods.
fn of<'a>(summary: &'a Summary, name: &str) -> impl Iterator<Item = (&'a str, &'a WarningScores)> {
    all(summary).filter(move |(_, scores)| scores.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probability_that_is_not_certain_does_not_look_so() {
        let shown = [0.0, 0.004, 0.006, 0.5, 0.996, 1.0].map(|p| percent(Some(p)).text);
        assert_eq!(shown, ["0 %", "<1 %", "1 %", "50 %", ">99 %", "100 %"]);
        assert_eq!(percent(None).text, NONE);
    }
}
