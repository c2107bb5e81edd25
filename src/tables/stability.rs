//! The stability monitor's verdicts in words, for terminal, page and recording.

use super::{Cell, NONE, Table};
use crate::plot::{number, with_unit};
use crate::scores::Summary;
use crate::scores::stability::{ParameterNeeds, ParameterStability, Stability, Undetermined};

/// The most combinations, parameters or sensors that are named.
const MOST_NAMED: usize = 8;

/// Every method with biases, in a few lines each; `None` if there are none.
pub fn on_terminal(summary: &Summary) -> Option<String> {
    let methods = summary.methods.iter().filter_map(|(name, scores)| Some((name, scores.stability.as_ref()?)));
    let lines: Vec<String> = methods
        .filter(|(_, stability)| !stability.parameters.is_empty())
        .map(|(name, stability)| {
            let findings = findings(stability).into_iter().map(|finding| format!("\n  {finding}"));
            format!("\n{name}: {}{}", in_short(stability), findings.collect::<String>())
        })
        .collect();
    (!lines.is_empty()).then(|| format!("Stability of the bias estimates{}", lines.concat()))
}

/// How many parameters are stable, and whether the innovations are what they should be.
pub fn in_short(stability: &Stability) -> String {
    let all = stability.parameters.len();
    let count = |test: &dyn Fn(&&ParameterStability) -> bool| stability.parameters.iter().filter(test).count();
    let (stable, frozen) = (count(&|it| it.stable), count(&|it| it.frozen));
    let mut text = if stable == all { format!("all {all} stable") } else { format!("{stable} of {all} stable") };
    if frozen > 0 {
        text += &format!(", {frozen} frozen");
    }
    if let Some(lag) = &stability.lag_correlation {
        let verdict = if lag.holds() { "white" } else { "not white" };
        text += &format!("; innovations {verdict} (lag correlation {:.2} ± {:.2})", lag.value, lag.tolerance);
    }
    if let Some(chi2) = &stability.innovation_chi2 {
        text += &format!(", χ²/n {:.2} (1 ± {:.2})", chi2.value, chi2.tolerance);
    }
    let growing = stability.variances.iter().filter(|(_, own)| own.trend > 1.1);
    let growing: Vec<&str> = growing.map(|(name, _)| name.as_str()).collect();
    if !growing.is_empty() {
        text += &format!("; claimed variance still grows: {}", growing.join(", "));
    }
    text
}

/// What is wrong, and what would help, one sentence each.
pub fn findings(stability: &Stability) -> Vec<String> {
    let mut findings: Vec<String> = stability.undetermined.iter().take(MOST_NAMED).map(undetermined).collect();
    if stability.undetermined.len() > MOST_NAMED {
        findings.push(format!("{} more combinations are not determined", stability.undetermined.len() - MOST_NAMED));
    }
    if !stability.references.is_empty() {
        let named = shortened(&stability.references);
        findings.push(format!(
            "would be cured by test points (`isobar sensors --help`), or by stations without bias (reference_groups), of {named}"
        ));
    }
    for parameter in stability.parameters.iter().filter(|it| !it.stable).take(MOST_NAMED) {
        let mut finding = format!("{}: {}: {}", parameter.name, parameter.verdict(), parameter.why.join("; "));
        if let Some(needs) = parameter.needs.as_ref().map(|needs| needs_in_words(needs, &parameter.unit)) {
            finding += &format!("; needs {needs}");
        }
        findings.push(finding);
    }
    findings
}

/// What would give a bias with this unit a stable update; each by itself.
fn needs_in_words(needs: &ParameterNeeds, unit: &str) -> String {
    let ParameterNeeds { further_cycles, test_point_sigma, comparison, reconfiguration } = needs;
    let sigma = |sigma: f64| with_unit(number(rounded_down(sigma)), unit);
    let data = [
        further_cycles.map(|cycles| format!("about {cycles} more cycles like the last")),
        test_point_sigma.map(|own| format!("a test point to {} or better", sigma(own))),
        comparison.as_ref().map(|own| format!("a comparison with {} to {} or better", own.with, sigma(own.sigma))),
        reconfiguration.clone(),
    ];
    data.into_iter().flatten().collect::<Vec<_>>().join(", or ")
}

/// At most the value, with two significant digits.
fn rounded_down(value: f64) -> f64 {
    let nearest = rounded(value);
    let unit = 10_f64.powf(value.log10().floor() - 1.0);
    if nearest <= value { nearest } else { rounded(nearest - unit) }
}

fn undetermined(combination: &Undetermined) -> String {
    let Undetermined { direction, variance_ratio, mean } = combination;
    let parts: Vec<String> = direction
        .iter()
        .enumerate()
        .map(|(place, (name, part))| {
            let sign = match (place, *part < 0.0) {
                (_, true) => "− ",
                (0, false) => "",
                (_, false) => "+ ",
            };
            let size = if (part.abs() - 1.0).abs() < 0.05 { String::new() } else { format!("{:.1} ", part.abs()) };
            format!("{sign}{size}{name}")
        })
        .collect();
    let shown = parts.iter().take(MOST_NAMED).cloned().collect::<Vec<_>>().join(" ");
    let more = if parts.len() > MOST_NAMED { " …" } else { "" };
    let percent = 100.0 * variance_ratio;
    let Some(mean) = mean else {
        return format!("not determined: {shown}{more} (keeps {percent:.0} % of its prior variance)");
    };
    let (variable, unit) = (&mean.variable, &mean.unit);
    let cure = if mean.sigma_needed > 0.0 {
        format!(", to {} {unit} or better", number(rounded(mean.sigma_needed)))
    } else {
        String::new()
    };
    format!(
        "cannot be separated: the mean {variable} and {shown}{more} (correlation {:.2}; keeps {percent:.0} % of its prior \
         variance); an unbiased observation of the mean {variable} would tell them apart{cure}",
        mean.correlation
    )
}

/// Two significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

fn shortened(names: &[String]) -> String {
    let shown = names.iter().take(MOST_NAMED).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > MOST_NAMED { format!("{shown} and {} more", names.len() - MOST_NAMED) } else { shown }
}

/// The same as markdown, for a viewer's text view.
pub fn markdown(summary: &Summary) -> String {
    let mut text = String::from("# Stability of the bias estimates\n\n");
    let escaped = |text: &str| text.replace('|', "\\|");
    for (name, stability) in summary.methods.iter().filter_map(|(name, own)| Some((name, own.stability.as_ref()?))) {
        text += &format!("## {}\n\n", escaped(name));
        if stability.parameters.is_empty() {
            text += "It does not estimate biases.\n\n";
            continue;
        }
        text += &format!("{}.\n\n", escaped(&in_short(stability)));
        for finding in findings(stability) {
            text += &format!("- {}\n", escaped(&finding));
        }
        let row = |own: &ParameterStability| -> Vec<Cell> {
            let lag = own.lag_correlation.map(|lag| format!("{:.2} ± {:.2}", lag.value, lag.tolerance));
            vec![
                own.name.as_str().into(),
                own.observations.into(),
                Cell::percent(Some(own.variance_ratio)),
                lag.unwrap_or_else(|| NONE.into()).into(),
                own.verdict().into(),
            ]
        };
        let columns = ["parameter", "observations", "keeps of its prior variance", "lag correlation", "verdict"];
        let parameters = Table::new(&columns, stability.parameters.iter().map(row).collect());
        text += &format!("\n{}", parameters.markdown());
        text += "\n";
    }
    text
}
