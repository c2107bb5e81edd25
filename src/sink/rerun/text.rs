//! The recording's texts: what the run was, and how the methods scored.

use crate::event::RunInfo;
use crate::plot::number;
use crate::summary::Summary;
use std::fmt::Write;

/// The scores of all methods, as a table in markdown.
pub fn scores(info: &RunInfo, summary: &Summary) -> String {
    let mut text = format!("# {}\n\n", info.title);
    let (from, to) = (summary.scored_from_cycle, summary.cycles);
    let _ = writeln!(text, "Scenario `{}`, seed {}. Scores over cycles {from} to {to}.\n", info.scenario, info.seed);
    let mut head = String::from("| method |");
    for variable in &info.layout.variables {
        let _ = write!(head, " RMSE {} [{}] | spread |", variable.name, variable.unit);
    }
    head += " RMSE biases | spread | innovation χ² |";
    let columns = head.matches('|').count() - 1;
    let _ = writeln!(text, "{head}\n|{}", "---|".repeat(columns));
    for (name, scores) in &summary.methods {
        let mark = if scores.failure.is_some() { " (failed)" } else { "" };
        let mut row = format!("| {}{mark} |", cell(name));
        for variable in &info.layout.variables {
            let spread = scores.spread_analysis.as_ref().and_then(|spread| spread.get(variable.name));
            let error = scores.rmse_analysis.get(variable.name);
            let _ = write!(row, " {} | {} |", figure(error.copied()), figure(spread.copied()));
        }
        for value in [scores.bias_rmse, scores.bias_spread, scores.innovation_chi2] {
            let _ = write!(row, " {} |", figure(value));
        }
        let _ = writeln!(text, "{row}");
    }
    for (name, failure) in summary.failures() {
        let _ = writeln!(text, "\n**{name}** failed in cycle {}: {}", failure.cycle, failure.reason);
    }
    text +=
        "\nRMSE and spread (claimed standard deviation) are those of the analysis; they should agree, and χ² be 1.\n\n";
    for method in &info.methods {
        let _ = writeln!(text, "- **{}**: {}", method.name, method.description);
    }
    text
}

/// What stands in the place of the scores while the run computes.
pub fn unfinished(info: &RunInfo) -> String {
    let mut text = format!("# {}\n\nThe run is not complete yet.\n\n", info.title);
    for method in &info.methods {
        let _ = writeln!(text, "- **{}**: {}", method.name, method.description);
    }
    text
}

/// The scenario file, as markdown.
pub fn scenario(info: &RunInfo) -> String {
    // A fence longer than any in the text.
    let fence = "`".repeat(3 + info.scenario_text.split(|c| c != '`').map(str::len).max().unwrap_or(0));
    format!("{fence}toml\n{}\n{fence}\n", info.scenario_text.trim_end())
}

fn figure(value: Option<f64>) -> String {
    value.map_or_else(|| "–".into(), number)
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
