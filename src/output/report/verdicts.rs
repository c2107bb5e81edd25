//! When which bias became determined: the cycles in which each had a stable update.

use crate::output::history::History;
use crate::scores::Summary;
use crate::scores::stability::{ParameterStability, Stability};
use crate::tables::{Cell, MOST_PARAMETERS, Table};
use crate::verdict::Verdict;

/// In which cycles each bias had a stable update, up to [`MOST_PARAMETERS`], by every method that estimates biases.
pub fn table(history: &History, summary: &Summary) -> Option<Table> {
    let info = &history.info;
    let methods: Vec<(usize, &str, &Stability)> = info
        .methods
        .iter()
        .enumerate()
        .filter_map(|(number, method)| {
            let stability = summary.methods.get(&method.name)?.stability.as_ref()?;
            (!stability.parameters.is_empty()).then_some((number, method.name.as_str(), stability))
        })
        .collect();
    let names = |(_, name, _): &(usize, &str, _)| format!("{name}\nstable");
    let header = ["parameter".to_string()].into_iter().chain(methods.iter().map(names)).collect();
    let row = |number: usize| -> Vec<Cell> {
        let of_method = |&(method, _, stability): &(usize, &str, &Stability)| match stability.parameters.get(number) {
            Some(end) => cell(&changes(history, method, number), end, info.done + 1),
            None => Cell::default(),
        };
        let name = info.calibration.parameters[number].name.as_str().into();
        [name].into_iter().chain(methods.iter().map(of_method)).collect()
    };
    let count = methods.iter().map(|(_, _, own)| own.parameters.len()).max()?;
    let rows = (0..count.min(info.calibration.len()).min(MOST_PARAMETERS)).map(row).collect();
    Table { header, rows }.filled()
}

/// The changes of a method's verdict on a parameter, with their cycles.
fn changes(history: &History, method: usize, parameter: usize) -> Vec<(usize, &Verdict)> {
    let own = history.verdicts.iter().filter(|(_, _, of, verdict)| (*of, verdict.parameter) == (method, parameter));
    own.map(|(cycle, _, _, verdict)| (*cycle, verdict)).collect()
}

/// When a parameter was stable and, in small print, when it was frozen, of a run that begins with the cycle `first`.
fn cell(changes: &[(usize, &Verdict)], end: &ParameterStability, first: usize) -> Cell {
    let of = |is: fn(&Verdict) -> bool| -> Vec<(usize, bool)> {
        changes.iter().map(|&(cycle, verdict)| (cycle, is(verdict))).collect()
    };
    let stable = spans(&of(|verdict| verdict.stable), end.stable, first);
    let frozen = spans(&of(|verdict| verdict.frozen), end.frozen, first);
    let note = if frozen.is_empty() { String::new() } else { format!("frozen {}", in_words(&frozen, first)) };
    let class = if end.stable { "words" } else { "words open" };
    Cell { text: in_words(&stable, first), note, class }
}

/// The cycles, first and last, in which something was so that was so or not from the cycles of `changes` on; what has no last cycle
/// is so at the end. What is not said to change in an earlier run's continuation is `at_end` what it was all along.
fn spans(changes: &[(usize, bool)], at_end: bool, first: usize) -> Vec<(usize, Option<usize>)> {
    let mut spans: Vec<(usize, Option<usize>)> = Vec::new();
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
