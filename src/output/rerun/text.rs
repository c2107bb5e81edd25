//! The recording's texts: what the run was, and how the methods scored.

use crate::event::RunInfo;
use crate::scores::Summary;
use crate::tables::scores::errors;
use crate::tables::{forecasts, warnings};
use std::fmt::Write;

/// The scores of all methods, as a table in markdown.
pub fn scores(info: &RunInfo, summary: &Summary) -> String {
    let mut text = format!("# {}\n\n", info.title);
    let (from, to) = (summary.scored_from_cycle, summary.cycles);
    let _ = writeln!(text, "Scenario `{}`, seed {}. Scores over cycles {from} to {to}.\n", info.scenario, info.seed);
    text += &errors(summary, &info.variables()).markdown();
    for (name, failure) in summary.failures() {
        let _ = writeln!(text, "\n**{name}** failed in cycle {}: {}", failure.cycle, failure.reason);
    }
    for table in forecasts::on_page(summary, &info.variables()) {
        let _ = writeln!(text, "\nForecasts ahead by lead time\n\n{}", table.markdown());
    }
    for name in warnings::names(summary) {
        let _ = writeln!(text, "\nWarning {name}: {}\n", warnings::frequency(summary, &name));
        text += &warnings::table(summary, &name).markdown();
    }
    text += if info.has_truth {
        "\nRoot-mean-square errors of background and analysis."
    } else {
        "\nRoot-mean-square departures of observations from background (O−B) and analysis (O−A)."
    };
    text += " The spread is the claimed standard deviation of the analysis: it \
         should agree with its error, and χ²/n should be 1.\n\n";
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
