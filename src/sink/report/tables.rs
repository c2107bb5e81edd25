//! The tables of the report.

use super::history::{Cycle, History, ParameterHistory};
use crate::event::RunInfo;
use crate::plot::{number, unit};
use crate::statistics::Interval;
use crate::summary::{Failure, MethodScores, Summary};
use serde::Serialize;

/// What stands where there is no figure.
pub const NONE: &str = "–";

/// A table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    /// Names of the columns.
    pub header: Vec<String>,
    /// The cells, row by row; the first of each row names it.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Cell {
    /// What it says.
    pub text: String,
    /// What it adds in small print.
    pub note: String,
    /// Class of its style: `better`, `worse`, `open`, `words` for what may be broken anywhere on paper, or none.
    pub class: &'static str,
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self { text, ..Self::default() }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        text.to_string().into()
    }
}

impl Cell {
    /// A figure, or what stands for none.
    pub fn figure(value: Option<f64>) -> Self {
        value.map_or_else(|| NONE.into(), figure).into()
    }

    /// A figure with its interval.
    pub fn known(value: Option<f64>, interval: Option<&Interval>) -> Self {
        let note = interval.map_or_else(String::new, |it| format!("{} … {}", figure(it.low), figure(it.high)));
        Self { note, ..Self::figure(value) }
    }
}

/// Three significant digits.
pub fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || !(1e-3..1e5).contains(&value.abs()) {
        return number(value);
    }
    format!("{value:.*}", (2 - value.abs().log10().floor() as i32).clamp(0, 5) as usize)
}

/// The methods' names and settings.
pub fn methods(info: &RunInfo) -> Table {
    let header = ["method", "how it is set up"].map(String::from).into();
    let rows = info.methods.iter().map(|it| vec![it.name.as_str().into(), it.description.as_str().into()]).collect();
    Table { header, rows }
}

/// The scores of all methods, with intervals.
pub fn scores(info: &RunInfo, summary: &Summary) -> Table {
    let mut header = vec!["method".to_string()];
    for variable in &info.layout.variables {
        let column = |what: &str| format!("{} {what} [{}]", variable.name, unit(variable.unit));
        header.extend(["background", "analysis", "spread"].map(column));
    }
    header.extend(["bias RMSE [own\u{a0}units]", "bias spread [own\u{a0}units]", "χ²/n [1]"].map(String::from));
    let row = |(name, scores): (&String, &MethodScores)| {
        let intervals = scores.intervals.clone().unwrap_or_default();
        let mut row: Vec<Cell> = vec![match scores.failure {
            None => name.as_str().into(),
            Some(_) => format!("{name} (failed)").into(),
        }];
        for variable in info.layout.variables.iter().map(|variable| variable.name) {
            let of = |table: &crate::summary::PerVariable| table.get(variable).copied();
            row.push(Cell::known(of(&scores.rmse_background), intervals.rmse_background.get(variable)));
            row.push(Cell::known(of(&scores.rmse_analysis), intervals.rmse_analysis.get(variable)));
            row.push(Cell::figure(scores.spread_analysis.as_ref().and_then(of)));
        }
        row.push(Cell::known(scores.bias_rmse, intervals.bias_rmse.as_ref()));
        row.push(Cell::figure(scores.bias_spread));
        row.push(Cell::figure(scores.innovation_chi2));
        row
    };
    Table { header, rows: summary.methods.iter().map(row).collect() }
}

/// The scores of smoothed estimates, if a method has some.
pub fn smoothed(info: &RunInfo, summary: &Summary) -> Option<Table> {
    let mut header = vec!["method".to_string(), "lag [cycles]".into()];
    for variable in &info.layout.variables {
        let column = |what: &str| format!("{} {what} [{}]", variable.name, unit(variable.unit));
        header.extend(["smoothed", "spread"].map(column));
    }
    header.extend(["bias RMSE [own\u{a0}units]", "bias spread [own\u{a0}units]"].map(String::from));
    let row = |(name, scores): (&String, &MethodScores)| {
        let own = scores.smoothed.as_ref()?;
        let mut row: Vec<Cell> = vec![name.as_str().into(), own.lag_cycles.to_string().into()];
        for variable in &info.layout.variables {
            row.push(Cell::figure(own.rmse.get(variable.name).copied()));
            row.push(Cell::figure(own.spread.as_ref().and_then(|spread| spread.get(variable.name).copied())));
        }
        row.extend([own.bias_rmse, own.bias_spread].map(Cell::figure));
        Some(row)
    };
    let rows: Vec<Vec<Cell>> = summary.methods.iter().filter_map(row).collect();
    (!rows.is_empty()).then_some(Table { header, rows })
}

/// When and why methods failed.
pub fn failures(summary: &Summary) -> Option<Table> {
    let row = |(name, it): (&str, &Failure)| -> Vec<Cell> {
        vec![name.into(), it.cycle.to_string().into(), it.reason.as_str().into()]
    };
    let rows: Vec<_> = summary.failures().map(row).collect();
    let header = ["method", "failed in cycle", "because"].map(String::from).into();
    (!rows.is_empty()).then_some(Table { header, rows })
}

/// The most bias parameters that have a row.
pub const MOST_PARAMETERS: usize = 500;

/// The verdict on every bias, up to [`MOST_PARAMETERS`], of every method that estimates them.
pub fn stability(summary: &Summary) -> Option<Table> {
    let methods = summary.methods.iter().filter_map(|(name, scores)| Some((name, scores.stability.as_ref()?)));
    let methods: Vec<_> = methods.filter(|(_, own)| !own.parameters.is_empty()).collect();
    let (_, first) = methods.first()?;
    let mut header = vec!["parameter".to_string(), "observations".into()];
    header.extend(methods.iter().map(|(name, _)| name.to_string()));
    let row = |number: usize| -> Option<Vec<Cell>> {
        let own = first.parameters.get(number)?;
        let mut row: Vec<Cell> = vec![own.name.as_str().into(), own.observations.to_string().into()];
        row.extend(methods.iter().map(|(_, stability)| match stability.parameters.get(number) {
            None => NONE.into(),
            Some(own) => Cell {
                text: own.verdict().into(),
                note: format!("keeps {} % of its prior variance", figure(100.0 * own.variance_ratio)),
                class: if own.stable { "words" } else { "words open" },
            },
        }));
        Some(row)
    };
    Some(Table { header, rows: (0..first.parameters.len().min(MOST_PARAMETERS)).filter_map(row).collect() })
}

/// The last estimate of every bias, up to [`MOST_PARAMETERS`], by every method, against the truth.
pub fn biases(info: &RunInfo, history: &History) -> Option<Table> {
    let last: &Cycle = history.cycles.last().filter(|_| !info.calibration.is_empty())?;
    let mut header = vec!["parameter".to_string(), "unit".into(), "truth".into()];
    header.extend(info.methods.iter().map(|method| method.name.clone()));
    let row = |(number, parameter): (usize, &isobar_obs::Parameter)| {
        let truth = last.true_calibration.get(number).copied();
        let mut row: Vec<Cell> =
            vec![parameter.name.as_str().into(), unit(&parameter.unit).into(), Cell::figure(truth)];
        row.extend(last.methods.iter().map(|own| {
            let Some(own) = own else { return NONE.into() };
            let cell = Cell::figure(own.calibration.get(number).copied());
            let sigma = own.calibration_spread.as_ref().and_then(|spread| spread.get(number));
            Cell { note: sigma.map_or_else(String::new, |sigma| format!("± {}", figure(2.0 * sigma))), ..cell }
        }));
        row
    };
    Some(Table {
        header,
        rows: info.calibration.parameters.iter().take(MOST_PARAMETERS).enumerate().map(row).collect(),
    })
}

/// The last estimate of every parameter beside state and biases, up to [`MOST_PARAMETERS`], by the methods that have some.
pub fn parameters(info: &RunInfo, history: &History) -> Option<Table> {
    let all = &history.parameters;
    let has_some = |&(number, _): &(usize, _)| all.values().any(|own| own[number].is_some());
    let methods: Vec<_> = info.methods.iter().enumerate().filter(has_some).collect();
    let mut header = vec!["parameter".to_string(), "unit".into()];
    header.extend(methods.iter().map(|(_, method)| method.name.clone()));
    let row = |(name, own): (&String, &Vec<Option<ParameterHistory>>)| -> Vec<Cell> {
        let udunits = own.iter().flatten().next().map_or("", |it| it.last.unit.as_str());
        let cells = methods.iter().map(|&(number, _)| {
            let Some(ParameterHistory { last, .. }) = &own[number] else { return NONE.into() };
            let note = match last.sigma {
                Some(sigma) => format!("± {}", figure(2.0 * sigma)),
                None => last.verdict.clone(),
            };
            Cell { text: figure(last.value), note, class: if last.sigma.is_some() { "" } else { "open" } }
        });
        [name.as_str().into(), unit(udunits).into()].into_iter().chain(cells).collect()
    };
    let rows: Vec<Vec<Cell>> = all.iter().take(MOST_PARAMETERS).map(row).collect();
    (!rows.is_empty()).then_some(Table { header, rows })
}

/// How observations linked blocks, in the cycle with the largest component.
pub fn partitions(summary: &Summary) -> Option<Table> {
    let header = [
        "method",
        "blocks",
        "components",
        "of several blocks",
        "blocks of the largest",
        "its variables",
        "blocks unobserved",
        "factors",
        "separators",
        "their unknowns",
        "border unknowns",
    ];
    let row = |(name, scores): (&String, &MethodScores)| {
        let it = scores.partition.as_ref()?;
        let cell = |count: usize| Cell::from(count.to_string());
        let mut row: Vec<Cell> = vec![name.as_str().into()];
        row.extend([it.blocks, it.components, it.merged_components].map(cell));
        row.extend([it.largest_component_blocks, it.largest_component_variables, it.unobserved_blocks].map(cell));
        row.push(crate::table::factors(it).into());
        row.push(cell(it.separators));
        let place = match it.separators {
            0 => "",
            _ if it.nested => "nested",
            _ => "in the border",
        };
        row.push(Cell { note: place.into(), ..cell(it.separator_unknowns) });
        row.push(cell(it.border));
        Some(row)
    };
    let rows: Vec<Vec<Cell>> = summary.methods.iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table { header: header.map(String::from).into(), rows })
}

/// Time and memory.
pub fn costs(summary: &Summary) -> Table {
    let row = |(name, scores): (&String, &MethodScores)| {
        let memory = scores.peak_memory_bytes.map_or(NONE.into(), |bytes| format!("{:.1}", bytes as f64 / 1e6));
        vec![name.as_str().into(), Cell::figure(Some(scores.seconds_per_cycle)), memory.into()]
    };
    let header = ["method", "time [s/cycle]", "memory [MB]"].map(String::from).into();
    Table { header, rows: summary.methods.iter().map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits() {
        let texts = [19.25, 3.846, 0.01234, 0.0, 123.4, -2.5, 1e-9, 123456.0].map(figure);
        assert_eq!(texts, ["19.2", "3.85", "0.0123", "0", "123", "-2.50", "1.000e-9", "123456"]);
    }

    #[test]
    fn a_cell_without_a_figure_says_so() {
        assert_eq!(Cell::figure(None).text, NONE);
        let known = Cell::known(Some(2.0), Some(&Interval { low: 1.5, high: 2.5 }));
        assert_eq!((known.text.as_str(), known.note.as_str()), ("2.00", "1.50 … 2.50"));
    }
}
