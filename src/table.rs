//! Scores as tables: at the end of a run, and against the accepted ones.

use crate::scenario::{Expected, ExpectedScores};
use crate::stability::words;
use crate::summary::{MethodScores, Summary};
use comfy_table::{CellAlignment, ContentArrangement, Table};
use isobar_assim::block_angular::PartitionReport;

/// Width of all tables, on a terminal and in a pipe.
const WIDTH: u16 = 100;

/// The scores of a run: errors of the state, method by method; then everything else that a method has a figure for.
///
/// `variables` are names and units. Figures that a method does not have are shown as –.
pub fn scores(summary: &Summary, variables: &[(&str, &str)]) -> String {
    let mut header = vec!["method".to_string()];
    for (name, unit) in variables {
        header.extend(["background", "analysis", "spread"].map(|what| format!("{name} [{unit}]\n{what}")));
    }
    let mut state = table(header);
    let mut rest = table(
        [
            "method",
            "bias RMSE\n[own units]",
            "bias spread\n[own units]",
            "innovation\nχ²/n [1]",
            "time\n[s/cycle]",
            "memory\n[MB]",
        ]
        .map(String::from)
        .to_vec(),
    );
    for (method, scores) in &summary.methods {
        let mut row = vec![marked(method, scores)];
        for (name, _) in variables {
            let spread = scores.spread_analysis.as_ref().and_then(|spread| spread.get(*name));
            row.extend([scores.rmse_background.get(*name), scores.rmse_analysis.get(*name), spread].map(figure));
        }
        state.add_row(row);
        rest.add_row([
            marked(method, scores),
            figure(scores.bias_rmse.as_ref()),
            figure(scores.bias_spread.as_ref()),
            figure(scores.innovation_chi2.as_ref()),
            figure(Some(&scores.seconds_per_cycle)),
            scores.peak_memory_bytes.map_or("–".into(), |bytes| format!("{:.1}", bytes as f64 / 1e6)),
        ]);
    }
    format!(
        "Root-mean-square error of background and analysis, and claimed analysis spread, cycles {} to {}\n{}\n\n\
         Biases, consistency, cost\n{}{}",
        summary.scored_from_cycle,
        summary.cycles,
        trimmed(&state),
        trimmed(&rest),
        smoothed(summary, variables)
            + &partitions(summary)
            + &words::on_terminal(summary)
            + &rejections(summary)
            + &failures(summary)
    )
}

/// The errors and claims of smoothed estimates; nothing if no method has a smoother.
fn smoothed(summary: &Summary, variables: &[(&str, &str)]) -> String {
    let mut header = vec!["method".to_string(), "lag\n[cycles]".to_string()];
    for (name, unit) in variables {
        header.extend(["smoothed", "spread"].map(|what| format!("{name} [{unit}]\n{what}")));
    }
    header.extend(["bias RMSE", "bias spread"].map(|what| format!("{what}\n[own units]")));
    let mut rows = table(header);
    for (method, scores) in &summary.methods {
        let Some(own) = &scores.smoothed else { continue };
        let mut row = vec![method.clone(), own.lag_cycles.to_string()];
        for (name, _) in variables {
            row.extend([own.rmse.get(*name), own.spread.as_ref().and_then(|it| it.get(*name))].map(figure));
        }
        row.extend([own.bias_rmse.as_ref(), own.bias_spread.as_ref()].map(figure));
        rows.add_row(row);
    }
    match rows.is_empty() {
        true => String::new(),
        false => format!("\n\nEstimates of the same cycles as later observations revise them\n{}", trimmed(&rows)),
    }
}

/// The method's name, with a mark if it failed.
fn marked(method: &str, scores: &MethodScores) -> String {
    if scores.failure.is_some() { format!("{method} (failed)") } else { method.to_string() }
}

/// How many observations failed quality control; nothing if none did.
fn rejections(summary: &Summary) -> String {
    summary.observations.describe_rejected().map_or_else(String::new, |text| format!("\n\n{text}"))
}

/// When and why methods failed; nothing if none did.
fn failures(summary: &Summary) -> String {
    let lines: Vec<String> =
        summary.failures().map(|(name, it)| format!("\n{name}: failed in cycle {}: {}", it.cycle, it.reason)).collect();
    if lines.is_empty() { String::new() } else { format!("\n\nFailed, and so without scores{}", lines.concat()) }
}

/// How observations linked the blocks of each method that has some, in the cycle with the largest component.
fn partitions(summary: &Summary) -> String {
    let described: Vec<String> = summary
        .methods
        .iter()
        .filter_map(|(name, scores)| {
            let own = scores.partition.as_ref()?;
            let cut = match (own.separators, own.nested) {
                (0, _) => String::new(),
                (count, false) => format!(", {} of them from {count} separators", own.separator_unknowns),
                (count, true) => format!("; {count} separators of {} unknowns, nested", own.separator_unknowns),
            };
            Some(format!(
                "{name}: {} blocks, of which observations link up to {} ({} variables) into one; {} factors; border {}{cut}",
                own.blocks,
                own.largest_component_blocks,
                own.largest_component_variables,
                factors(own),
                own.border
            ))
        })
        .collect();
    match described.is_empty() {
        true => String::new(),
        false => format!("\n\nPartition\n{}", described.join("\n")),
    }
}

/// The number of common factors, or from where to where it went.
pub(crate) fn factors(partition: &PartitionReport) -> String {
    match (partition.fewest_factors, partition.most_factors) {
        (fewest, most) if fewest == most => most.to_string(),
        (fewest, most) => format!("{fewest} to {most}"),
    }
}

/// How one score compares with the accepted one.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// The method.
    pub method: String,
    /// Dotted name of the score, `rmse_analysis.h`.
    pub score: String,
    /// The accepted value; `None` if there is none yet.
    pub from: Option<f64>,
    /// The value of the run; `None` if the run has none.
    pub to: Option<f64>,
    /// The change relative to the accepted value \[%\]; `None` unless there are both, or if it is infinite.
    pub change_percent: Option<f64>,
    /// Whether both values exist and differ by no more than the tolerance.
    pub within_tolerance: bool,
}

/// The scores of a run against the accepted ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The relative tolerance.
    pub relative_tolerance: f64,
    /// Every score that either has.
    pub scores: Vec<Moved>,
}

impl Comparison {
    /// Compares a run with what is expected of it.
    pub fn new(expected: &Expected, summary: &Summary) -> Self {
        let none = ExpectedScores::default();
        let gone = expected.methods.keys().filter(|name| !summary.methods.contains_key(*name));
        let mut scores = Vec::new();
        for method in summary.methods.keys().chain(gone) {
            let accepted = expected.methods.get(method).unwrap_or(&none).entries();
            let found = summary.methods.get(method).map_or(none.clone(), ExpectedScores::from).entries();
            let gone = accepted.keys().filter(|name| !found.contains_key(*name));
            for score in found.keys().chain(gone) {
                let (from, to) = (accepted.get(score).copied(), found.get(score).copied());
                scores.push(moved(method, score, from, to, expected.relative_tolerance));
            }
        }
        Self { relative_tolerance: expected.relative_tolerance, scores }
    }

    /// Whether there are scores, all within the tolerance.
    pub fn passed(&self) -> bool {
        !self.scores.is_empty() && self.outside() == 0
    }

    /// Number of scores that are not within the tolerance.
    pub fn outside(&self) -> usize {
        self.scores.iter().filter(|score| !score.within_tolerance).count()
    }

    /// The scores that moved, as a table; a sentence if none did.
    pub fn describe(&self) -> String {
        let mut moved = table(["method", "score", "from", "to", "change [%]", "tolerance"].map(String::from).to_vec());
        for score in self.scores.iter().filter(|score| score.from != score.to) {
            let verdict = match (score.from, score.to) {
                (None, _) => "not accepted yet",
                (_, None) => "missing",
                _ if score.within_tolerance => "within",
                _ => "OUTSIDE",
            };
            let percent = score.change_percent.map_or("–".into(), |percent| format!("{percent:+.3}"));
            let number = |value: Option<f64>| value.map_or("–".into(), |value| format!("{value:.5}"));
            let (from, to) = (number(score.from), number(score.to));
            moved.add_row([score.method.clone(), score.score.clone(), from, to, percent, verdict.to_string()]);
        }
        if let Some(column) = moved.column_mut(1) {
            column.set_cell_alignment(CellAlignment::Left);
        }
        let (all, outside) = (self.scores.len(), self.outside());
        let tolerance = 100.0 * self.relative_tolerance;
        let verdict = format!("{outside} of {all} scores outside of the tolerance of {tolerance} %");
        match moved.is_empty() {
            true if all == 0 => "no scores".to_string(),
            true => format!("{all} scores, none moved"),
            false => format!("{}\n{verdict}", trimmed(&moved)),
        }
    }
}

fn moved(method: &str, score: &str, from: Option<f64>, to: Option<f64>, tolerance: f64) -> Moved {
    let both = from.zip(to);
    Moved {
        method: method.to_string(),
        score: score.to_string(),
        from,
        to,
        change_percent: both.map(|(from, to)| 100.0 * (to - from) / from.abs()).filter(|percent| percent.is_finite()),
        // Accepted scores are rounded to five digits: a relative 5e-5 at most.
        within_tolerance: both.is_some_and(|(from, to)| (to - from).abs() <= tolerance.max(5e-5) * from.abs()),
    }
}

fn table(header: Vec<String>) -> Table {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
    table.set_width(WIDTH).set_header(header);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    for column in table.column_iter_mut() {
        column.set_padding((0, 1));
    }
    table
}

/// The table without blanks at the ends of lines.
fn trimmed(table: &Table) -> String {
    table.to_string().lines().map(str::trim_end).collect::<Vec<_>>().join("\n")
}

/// Three or four significant digits.
fn figure(value: Option<&f64>) -> String {
    match value {
        None => "–".into(),
        Some(value) if !value.is_finite() => value.to_string(),
        Some(&0.0) => "0".into(),
        Some(value) if value.abs() >= 1e5 || value.abs() < 1e-3 => format!("{value:.2e}"),
        Some(value) => format!("{value:.*}", (2 - value.abs().log10().floor() as i32).clamp(0, 5) as usize),
    }
}

/// A table of several columns of text, without lines.
pub(crate) fn plain(header: &[&str], rows: Vec<Vec<String>>) -> String {
    let mut plain = table(header.iter().map(|word| word.to_string()).collect());
    for column in plain.column_iter_mut() {
        column.set_cell_alignment(CellAlignment::Left);
    }
    plain.add_rows(rows);
    trimmed(&plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::{Failure, PerVariable};

    fn per_variable(entries: &[(&str, f64)]) -> PerVariable {
        entries.iter().map(|&(name, value)| (name.to_string(), value)).collect()
    }

    fn summary() -> Summary {
        let free = MethodScores {
            rmse_background: per_variable(&[("h", 19.25), ("u", 4.0), ("v", 3.5)]),
            rmse_analysis: per_variable(&[("h", 19.25), ("u", 4.0), ("v", 3.5)]),
            seconds_per_cycle: 0.0012,
            ..MethodScores::default()
        };
        let filter = MethodScores {
            rmse_background: per_variable(&[("h", 5.0), ("u", 2.0), ("v", 2.0)]),
            rmse_analysis: per_variable(&[("h", 3.84), ("u", 1.5), ("v", 1.25)]),
            spread_analysis: Some(per_variable(&[("h", 3.95), ("u", 1.5), ("v", 1.5)])),
            bias_rmse: Some(0.77),
            innovation_chi2: Some(1.02),
            peak_memory_bytes: Some(12_345_678),
            ..MethodScores::default()
        };
        Summary {
            scenario: "test".into(),
            seed: 1,
            cycles: 40,
            scored_from_cycle: 10,
            version: "0".into(),
            observations: Default::default(),
            methods: [("free".to_string(), free), ("a-method-with-a-long-name".to_string(), filter)].into(),
        }
    }

    #[test]
    fn the_table_fits_into_100_columns_and_holds_every_figure_with_its_unit() {
        let text = scores(&summary(), &[("h", "m"), ("u", "m/s"), ("v", "m/s")]);
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        for part in
            ["h [m]", "u [m/s]", "χ²/n", "[s/cycle]", "[MB]", "19.2", "3.84", "3.95", "0.770", "1.02", "12.3", "–"]
        {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
        let free = text.lines().find(|line| line.starts_with("free")).unwrap();
        assert_eq!(free.matches('–').count(), 3, "{free}");
    }

    #[test]
    fn a_failed_method_is_marked_and_its_end_is_told() {
        let mut summary = summary();
        let failure = Failure { cycle: 7, reason: "P is not positive definite".into() };
        summary.methods["free"] = MethodScores { failure: Some(failure), ..MethodScores::default() };
        let text = scores(&summary, &[("h", "m")]);
        assert_eq!(text.lines().filter(|line| line.starts_with("free (failed)")).count(), 2, "{text}");
        assert!(text.ends_with("without scores\nfree: failed in cycle 7: P is not positive definite"), "{text}");
    }

    #[test]
    fn a_run_agrees_with_itself_and_not_with_another() {
        let summary = summary();
        let expected = Expected::from_summary(&summary, 0.02);
        let same = Comparison::new(&expected, &summary);
        assert!(same.passed(), "{}", same.describe());
        assert_eq!(same.describe(), format!("{} scores, none moved", same.scores.len()));

        let mut other = summary.clone();
        other.methods["free"].rmse_analysis["h"] *= 1.05;
        other.methods["free"].rmse_analysis["u"] *= 0.99;
        let moved = Comparison::new(&expected, &other);
        assert_eq!((moved.passed(), moved.outside()), (false, 1));
        let text = moved.describe();
        assert!(text.contains("+5.000") && text.contains("OUTSIDE"), "{text}");
        assert!(text.contains("-1.000") && text.contains("within"), "{text}");
    }

    #[test]
    fn a_score_that_only_one_side_has_is_outside() {
        let mut summary = summary();
        let expected = Expected::from_summary(&summary, 0.02);
        summary.methods["a-method-with-a-long-name"].bias_rmse = None;
        summary.methods["free"].bias_rmse = Some(1.0);
        let comparison = Comparison::new(&expected, &summary);
        assert_eq!(comparison.outside(), 2);
        assert!(comparison.describe().contains("missing") && comparison.describe().contains("not accepted yet"));
        let nothing = Comparison::new(&Expected { relative_tolerance: 0.02, methods: Default::default() }, &summary);
        assert!(!nothing.passed());
    }
}
