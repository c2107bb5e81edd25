//! The scores of a run: on the terminal at its end, on its page and in the viewer.

use super::terminal::sentences;
use super::{Cell, Table, forecasts, stability, warnings};
use crate::scores::{MethodScores, Part, Score, Summary, Values};
use crate::text::counted;
use indexmap::IndexMap;
use isobar_assim::block_angular::PartitionReport;

/// The parts whose scores are in the first table: errors and claims of the state.
const STATE: [Part; 2] = [Part::Background, Part::Analysis];

/// All that the terminal shows of a run: errors of the state, method by method; then everything else that a method has a
/// figure for.
///
/// `variables` are names and units, `width` is that of the terminal. Figures that a method does not have are shown as –.
pub fn on_terminal(summary: &Summary, variables: &[(&str, &str)], width: usize) -> String {
    let shown = if summary.has_truth() {
        "Root-mean-square error of background and analysis"
    } else {
        "Root-mean-square departure of observations from background (O−B) and analysis (O−A)"
    };
    let (from, to) = (summary.scored_from_cycle, summary.cycles);
    let shown = format!("{shown}, and claimed analysis spread, cycles {from} to {to}");
    let revised = "Estimates of the same cycles as later observations revise them";
    let tables = [
        Some((shown.as_str(), of_parts(summary, variables, &STATE))),
        Some(("Biases, consistency, cost", of_parts(summary, variables, &[Part::Biases, Part::Cost]))),
        smoothed(summary, variables).map(|table| (revised, table)),
    ];
    let tables = tables.into_iter().flatten();
    let tables = tables.map(|(title, table)| format!("{}\n{}", sentences(title, width), table.terminal(width)));
    let rejected = summary.observations.describe_rejected();
    let texts = [partitions(summary), stability::on_terminal(summary), rejected, failures(summary)];
    let texts = texts.into_iter().flatten().map(|text| sentences(&text, width));
    let ahead = forecasts::on_terminal(summary, variables, width).into_iter();
    tables.chain(ahead).chain(warnings::on_terminal(summary, width)).chain(texts).collect::<Vec<_>>().join("\n\n")
}

/// The scores of all methods but those of smoothed estimates and of cost, with intervals.
pub fn errors(summary: &Summary, variables: &[(&str, &str)]) -> Table {
    of_parts(summary, variables, &[STATE[0], STATE[1], Part::Biases])
}

/// Time and memory.
pub fn costs(summary: &Summary) -> Table {
    of_parts(summary, &[], &[Part::Cost])
}

/// The scores of smoothed estimates; `None` if no method has a smoother.
pub fn smoothed(summary: &Summary, variables: &[(&str, &str)]) -> Option<Table> {
    let columns = columns(summary, variables, &[Part::Smoothed]);
    let mut header = vec!["method".to_string(), "lag\n[cycles]".into()];
    header.extend(columns.iter().map(Score::title));
    let rows = summary.methods.iter().filter_map(|(name, scores)| {
        let lag = scores.smoother_lag_cycles?;
        Some([name.as_str().into(), lag.into()].into_iter().chain(columns.iter().map(|it| cell(it, scores))).collect())
    });
    Table { rows: rows.collect(), header }.filled()
}

/// The scores of these parts that a method of the run has.
fn columns<'a>(summary: &Summary, variables: &[(&'a str, &'a str)], parts: &[Part]) -> Vec<Score<'a>> {
    let mut columns = Score::all(variables, |kind| kind.tabulated && parts.contains(&kind.part));
    columns.retain(|score| {
        let key = score.key();
        summary.methods.values().any(|scores| scores.values.contains_key(&key))
    });
    columns
}

/// A row for each method, with the scores of these parts.
fn of_parts(summary: &Summary, variables: &[(&str, &str)], parts: &[Part]) -> Table {
    let columns = columns(summary, variables, parts);
    let header = std::iter::once("method".to_string()).chain(columns.iter().map(Score::title));
    let row = |(name, scores): (&String, &MethodScores)| {
        let name = if scores.failure.is_some() { format!("{name} (failed)") } else { name.clone() };
        std::iter::once(name.into()).chain(columns.iter().map(|it| cell(it, scores))).collect()
    };
    Table { header: header.collect(), rows: summary.methods.iter().map(row).collect() }
}

/// A row for each method, with all scores that one of them has but those of smoothed estimates and of cost.
pub fn of_values<'a>(methods: &IndexMap<String, Values>, variables: &[(&'a str, &'a str)]) -> Table {
    let mut columns = Score::all(variables, |kind| !matches!(kind.part, Part::Smoothed | Part::Cost));
    columns.retain(|score| methods.values().any(|values| values.contains_key(&score.key())));
    let header = std::iter::once("method".to_string()).chain(columns.iter().map(Score::title));
    let row = |(name, values): (&String, &Values)| {
        let cells = columns.iter().map(|score| Cell::figure(values.get(&score.key()).copied()));
        std::iter::once(name.as_str().into()).chain(cells).collect()
    };
    Table { header: header.collect(), rows: methods.iter().map(row).collect() }
}

fn cell(score: &Score<'_>, scores: &MethodScores) -> Cell {
    let key = score.key();
    Cell::known(scores.values.get(&key).map(|&value| score.in_tables(value)), scores.intervals.get(&key))
}

/// When and why methods failed; `None` if all succeeded.
fn failures(summary: &Summary) -> Option<String> {
    let lines: Vec<String> =
        summary.failures().map(|(name, it)| format!("\n{name}: failed in cycle {}: {}", it.cycle, it.reason)).collect();
    (!lines.is_empty()).then(|| format!("Failed, and so without scores{}", lines.concat()))
}

/// How observations linked the blocks of each method with blocks, in the cycle with the largest component.
fn partitions(summary: &Summary) -> Option<String> {
    let describe = |(name, scores): (&String, &MethodScores)| {
        let it = scores.partition.as_ref()?;
        let cut = match (it.separators, it.nested) {
            (0, _) => String::new(),
            (count, false) => format!(", {} of them from {}", it.separator_unknowns, counted(count, "separator")),
            (count, true) => {
                let unknowns = counted(it.separator_unknowns, "unknown");
                format!("; {} of {unknowns}, nested", counted(count, "separator"))
            }
        };
        Some(format!(
            "\n{name}: {}, of which observations link up to {} ({}) into one; {} factors; border {}{cut}",
            counted(it.blocks, "block"),
            it.largest_component_blocks,
            counted(it.largest_component_variables, "variable"),
            factors(it),
            it.border
        ))
    };
    let described: Vec<String> = summary.methods.iter().filter_map(describe).collect();
    (!described.is_empty()).then(|| format!("Partition{}", described.concat()))
}

/// The number of common factors, or its range over the cycles.
pub fn factors(partition: &PartitionReport) -> String {
    match (partition.fewest_factors, partition.most_factors) {
        (fewest, most) if fewest == most => most.to_string(),
        (fewest, most) => format!("{fewest} to {most}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::Failure;
    use crate::tables::WIDTH;

    fn summary() -> Summary {
        let values = |state: [[f64; 3]; 2], others: &[(&str, f64)]| -> Values {
            let kinds = ["rmse_background", "rmse_analysis"].into_iter().zip(state);
            let state = kinds.flat_map(|(kind, values)| {
                ["h", "u", "v"].into_iter().zip(values).map(move |(name, value)| (format!("{kind}.{name}"), value))
            });
            state.chain(others.iter().map(|&(key, value)| (key.to_string(), value))).collect()
        };
        let free = values([[19.25, 4.0, 3.5], [19.25, 4.0, 3.5]], &[("seconds_per_cycle", 0.0012)]);
        let others = [
            ("spread_analysis.h", 3.95),
            ("spread_analysis.u", 1.5),
            ("spread_analysis.v", 1.5),
            ("bias_rmse", 0.77),
            ("innovation_chi2", 1.02),
            ("seconds_per_cycle", 0.0),
            ("peak_memory_bytes", 12_345_678.0),
        ];
        let filter = values([[5.0, 2.0, 2.0], [3.84, 1.5, 1.25]], &others);
        let of = |values: Values| MethodScores { values, ..MethodScores::default() };
        Summary {
            scenario: "test".into(),
            seed: 1,
            cycles: 40,
            scored_from_cycle: 10,
            version: "0".into(),
            observations: Default::default(),
            methods: [("free".to_string(), of(free)), ("a-method-with-a-long-name".to_string(), of(filter))].into(),
            ranks: None,
        }
    }

    #[test]
    fn the_table_fits_into_100_columns_and_holds_every_figure_with_its_unit() {
        let text = on_terminal(&summary(), &[("h", "m"), ("u", "m s-1"), ("v", "m s-1")], WIDTH);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        for part in [
            "h [m]",
            "u [m\u{a0}s⁻¹]",
            "χ²/n",
            "[s/cycle]",
            "[MB]",
            "19.2",
            "3.84",
            "3.95",
            "0.770",
            "1.02",
            "12.3",
            "–",
        ] {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
        let state = text.split_once("\n\nBiases").unwrap().0;
        let free = state.lines().filter(|line| line.starts_with("free"));
        assert_eq!(free.flat_map(|line| line.matches('–')).count(), 3, "{text}");
    }

    #[test]
    fn a_failed_method_is_marked_and_its_end_is_reported() {
        let mut summary = summary();
        let failure = Failure { cycle: 7, reason: "P is not positive definite".into() };
        summary.methods["free"] = MethodScores { failure: Some(failure), ..MethodScores::default() };
        let text = on_terminal(&summary, &[("h", "m")], WIDTH);
        assert_eq!(text.lines().filter(|line| line.starts_with("free (failed)")).count(), 2, "{text}");
        assert!(text.ends_with("without scores\nfree: failed in cycle 7: P is not positive definite"), "{text}");
    }
}
