//! The verdicts on the biases that are not stable all along, and since when the others are.

use crate::output::history::History;
use crate::scores::Summary;
use crate::scores::stability::{ParameterStability, Stability};
use crate::tables::{Cell, MOST_PARAMETERS, NONE, Table, figure};
use crate::verdict::Verdict;
use std::collections::HashMap;

/// The cycles, first and last, in which something was so; what has no last cycle is so at the end.
type Spans = Vec<(usize, Option<usize>)>;

/// The verdicts of the methods that estimate biases.
pub struct Verdicts {
    /// A row for each bias, up to [`MOST_PARAMETERS`], that some method ends without a stable update of, or has lost or frozen on
    /// the way.
    pub exceptions: Option<Table>,
    /// How many other biases there are, and from which cycles on all methods have a stable update of them.
    pub others: String,
}

/// A method's verdict on a bias.
struct Course<'a> {
    end: &'a ParameterStability,
    stable: Spans,
    frozen: Spans,
}

/// The verdicts; `None` if no method estimates biases.
pub fn verdicts<'a>(history: &History, summary: &'a Summary) -> Option<Verdicts> {
    let info = &history.info;
    let methods: Vec<(usize, &str, &'a Stability)> = info
        .methods
        .iter()
        .enumerate()
        .filter_map(|(number, method)| {
            let stability = summary.methods.get(&method.name)?.stability.as_ref()?;
            (!stability.parameters.is_empty()).then_some((number, method.name.as_str(), stability))
        })
        .collect();
    let count = methods.iter().map(|(_, _, own)| own.parameters.len()).max()?;
    let first = info.done + 1;
    let mut changes: HashMap<(usize, usize), Vec<(usize, &Verdict)>> = HashMap::new();
    for (cycle, _, method, verdict) in &history.verdicts {
        changes.entry((*method, verdict.parameter)).or_default().push((*cycle, verdict));
    }
    let courses = |parameter: usize| -> Vec<Option<Course<'a>>> {
        let course = |&(method, _, stability): &(usize, &str, &'a Stability)| {
            let end = stability.parameters.get(parameter)?;
            let own = changes.get(&(method, parameter)).map_or(&[][..], Vec::as_slice);
            let of = |is: fn(&Verdict) -> bool| own.iter().map(|&(cycle, it)| (cycle, is(it))).collect::<Vec<_>>();
            let stable = spans(&of(|verdict| verdict.stable), end.stable, first);
            let frozen = spans(&of(|verdict| verdict.frozen), end.frozen, first);
            Some(Course { end, stable, frozen })
        };
        methods.iter().map(course).collect()
    };
    let names = methods.iter().map(|(_, name, _)| name.to_string());
    let header = ["parameter".to_string(), "observations".into()].into_iter().chain(names).collect();
    let (mut rows, mut since) = (Vec::new(), Vec::new());
    for courses in (0..count).map(courses) {
        let known = || courses.iter().flatten();
        if known().all(Course::is_smooth) {
            since.extend(known().filter_map(|course| course.stable.first()).map(|span| span.0).max());
        } else if let Some(Course { end, .. }) = known().next().filter(|_| rows.len() < MOST_PARAMETERS) {
            let cells = courses.iter().map(|course| course.as_ref().map_or(NONE.into(), |course| course.cell(first)));
            rows.push([end.name.as_str().into(), end.observations.into()].into_iter().chain(cells).collect());
        }
    }
    Some(Verdicts { others: others(&since, rows.is_empty(), first), exceptions: Table { header, rows }.filled() })
}

impl Course<'_> {
    /// Whether the bias once had a stable update, kept it, and was never frozen.
    fn is_smooth(&self) -> bool {
        self.end.stable && self.stable.len() == 1 && self.frozen.is_empty()
    }

    /// The verdict at the end and, in small print, what came before, of a run that begins with the cycle `first`.
    fn cell(&self, first: usize) -> Cell {
        let mut note = format!("keeps {} % of its prior variance", figure(100.0 * self.end.variance_ratio));
        note += &match self.stable.as_slice() {
            [] => "; never stable".to_string(),
            spans => format!("; stable {}", in_words(spans, first)),
        };
        if !self.frozen.is_empty() {
            note += &format!("; frozen {}", in_words(&self.frozen, first));
        }
        let class = if self.end.stable { "words" } else { "words open" };
        Cell { text: self.end.verdict().into(), note, class }
    }
}

/// In words, since which cycles all methods have a stable update of each bias that is no exception.
fn others(since: &[usize], all: bool, first: usize) -> String {
    let (Some(&earliest), Some(&latest)) = (since.iter().min(), since.iter().max()) else { return String::new() };
    let which = match (all, since.len()) {
        (true, 1) => "The bias has".to_string(),
        (true, count) => format!("All {count} biases have"),
        (false, 1) => "The other bias has".into(),
        (false, count) => format!("The other {count} biases have"),
    };
    let when = match (earliest, latest) {
        (_, latest) if latest == first => "in all cycles".to_string(),
        (earliest, latest) if earliest == latest => format!("from cycle {latest} on"),
        (earliest, latest) => format!("from cycle {earliest} to {latest} on"),
    };
    format!("{which} a stable update with every method, {when}.")
}

/// The cycles in which something was so that was so or not from the cycles of `changes` on. A run that goes on from another says
/// only what changes: before its first change it was the opposite, and without a change what it is `at_end`.
fn spans(changes: &[(usize, bool)], at_end: bool, first: usize) -> Spans {
    let mut spans = Spans::new();
    let before = changes.first().map_or(at_end, |(cycle, is)| *cycle > first && !is);
    if before {
        spans.push((first, None));
    }
    for &(cycle, is) in changes {
        match spans.last_mut().filter(|(_, last)| last.is_none()) {
            Some((_, last)) if !is => *last = Some(cycle - 1),
            None if is => spans.push((cycle, None)),
            _ => {}
        }
    }
    spans
}

fn in_words(spans: &[(usize, Option<usize>)], first: usize) -> String {
    let words = |&(from, to): &(usize, Option<usize>)| match to {
        None if from == first => "in all cycles".to_string(),
        None => format!("from cycle {from}"),
        Some(to) if to == from => format!("in cycle {from}"),
        Some(to) => format!("in cycles {from}–{to}"),
    };
    match spans {
        [] => "never".into(),
        spans => spans.iter().map(words).collect::<Vec<_>>().join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_of_a_new_run_and_of_one_that_goes_on() {
        let said = |changes: &[(usize, bool)], at_end, first| in_words(&spans(changes, at_end, first), first);
        assert_eq!(said(&[(1, false)], false, 1), "never");
        assert_eq!(said(&[(1, true)], true, 1), "in all cycles");
        assert_eq!(said(&[(1, false), (4, true)], true, 1), "from cycle 4");
        assert_eq!(
            said(&[(1, false), (4, true), (5, false), (7, true), (9, false)], false, 1),
            "in cycle 4, in cycles 7–8"
        );
        // Of a run that goes on from another, whose verdicts stand until they change.
        assert_eq!(said(&[], true, 11), "in all cycles");
        assert_eq!(said(&[], false, 11), "never");
        assert_eq!(said(&[(15, false)], false, 11), "in cycles 11–14");
        assert_eq!(said(&[(11, false)], false, 11), "never");
        assert_eq!(said(&[(15, true)], true, 11), "from cycle 15");
    }
}
