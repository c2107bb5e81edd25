//! Scores over seeds as tables, for the terminal and the page.

use super::{SeedsScore, SeedsSummary, TIME};
use crate::sink::report::tables::{Cell, NONE, Table, figure};

/// A column: the dotted name of its score, its title, and whether less is better.
struct Column {
    score: String,
    title: String,
    is_error: bool,
}

impl Column {
    fn new(score: &str, title: &str, is_error: bool) -> Self {
        Self { score: score.into(), title: title.into(), is_error }
    }
}

impl SeedsSummary {
    /// The means with half the width of their intervals: analysis and spread of each variable; then all other scores, those
    /// of smoothed estimates in a table of the methods that have them.
    ///
    /// `variables` are names and units.
    pub fn means(&self, variables: &[(&str, &str)]) -> Vec<Table> {
        let all: Vec<&str> = self.methods.keys().map(String::as_str).collect();
        self.tables("method", &all, variables, |score, _| {
            let half_width = score.interval.map(|interval| interval.half_width());
            known(figure(score.mean), half_width).into()
        })
    }

    /// The differences from the method `against` in % of its scores, in the same parts. A star marks significance.
    pub fn differences(&self, variables: &[(&str, &str)]) -> Vec<Table> {
        let others: Vec<&str> = self.methods.keys().map(String::as_str).filter(|name| *name != self.against).collect();
        self.tables(&format!("% of {}", self.against), &others, variables, |score, is_error| {
            let Some((difference, (percent, half_width))) =
                score.difference.and_then(|difference| Some((difference, difference.percent()?)))
            else {
                return NONE.into();
            };
            let star = if difference.significant == Some(true) { " *" } else { "" };
            let class = match difference.significant {
                Some(true) if is_error && percent < 0.0 => "better",
                Some(true) if is_error => "worse",
                _ => "open",
            };
            let text = format!("{}{star}", known(format!("{percent:+.1}"), half_width));
            Cell { text, note: String::new(), class }
        })
    }

    /// Whether a method has a smoother.
    pub(super) fn has_smoothed(&self) -> bool {
        let is_smoothed = |score: &String| score.starts_with("rmse_smoothed.");
        self.methods.values().any(|scores| scores.keys().any(is_smoothed))
    }

    fn tables(
        &self,
        title: &str,
        methods: &[&str],
        variables: &[(&str, &str)],
        cell: impl Fn(&SeedsScore, bool) -> Cell,
    ) -> Vec<Table> {
        let table = |columns: &[Column]| self.table(title, columns, methods, &cell);
        let mut smoothed = table(&smoothed(variables));
        smoothed.rows.retain(|row| row.iter().skip(1).any(|cell| cell.text != NONE));
        let smoothed = Some(smoothed).filter(|table| !table.rows.is_empty());
        [table(&analysis(variables)), table(&others(variables))].into_iter().chain(smoothed).collect()
    }

    fn table(
        &self,
        title: &str,
        columns: &[Column],
        methods: &[&str],
        cell: impl Fn(&SeedsScore, bool) -> Cell,
    ) -> Table {
        let header = std::iter::once(title.to_string()).chain(columns.iter().map(|column| column.title.clone()));
        let row = |method: &str| {
            let cells = columns.iter().map(|column| {
                self.score(method, &column.score).map_or(NONE.into(), |score| cell(score, column.is_error))
            });
            std::iter::once(method.into()).chain(cells).collect()
        };
        Table { header: header.collect(), rows: methods.iter().map(|method| row(method)).collect() }
    }
}

fn analysis(variables: &[(&str, &str)]) -> Vec<Column> {
    errors_and_spreads("analysis", variables)
}

fn smoothed(variables: &[(&str, &str)]) -> Vec<Column> {
    let mut columns = errors_and_spreads("smoothed", variables);
    columns.extend([
        Column::new("bias_rmse_smoothed", "bias RMSE\n[own units]", true),
        Column::new("bias_spread_smoothed", "bias spread\n[own units]", false),
    ]);
    columns
}

/// The error of each variable at a stage, and what the method claims of it.
fn errors_and_spreads(stage: &str, variables: &[(&str, &str)]) -> Vec<Column> {
    let of_variable = |&(name, unit): &(&str, &str)| {
        let title = |what: &str| format!("{name} [{unit}]\n{what}");
        [
            Column::new(&format!("rmse_{stage}.{name}"), &title(stage), true),
            Column::new(&format!("spread_{stage}.{name}"), &title("spread"), false),
        ]
    };
    variables.iter().flat_map(of_variable).collect()
}

fn others(variables: &[(&str, &str)]) -> Vec<Column> {
    let background = variables.iter().map(|(name, unit)| {
        Column::new(&format!("rmse_background.{name}"), &format!("{name} [{unit}]\nbackground"), true)
    });
    let single = [
        ("bias_rmse", "bias RMSE\n[own units]", true),
        ("bias_spread", "bias spread\n[own units]", false),
        ("innovation_chi2", "χ²/n\n[1]", false),
        (TIME, "time\n[s/cycle]", true),
    ];
    background.chain(single.map(|(score, title, is_error)| Column::new(score, title, is_error))).collect()
}

/// `3.59±0.12`: half the width of an interval with as many decimals as the figure, or with one digit if it is smaller.
fn known(text: String, half_width: Option<f64>) -> String {
    let Some(half_width) = half_width else { return text };
    let decimals = text.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    let rounded = format!("{half_width:.decimals$}");
    match half_width > 0.0 && rounded.parse() == Ok(0.0) {
        true => format!("{text}±{half_width:.0e}"),
        false => format!("{text}±{rounded}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_widths_have_the_decimals_of_their_figures() {
        let texts = [0.1234, 12.34, 0.00567, 0.004, 0.0].map(|half| known("3.59".into(), Some(half)));
        assert_eq!(texts, ["3.59±0.12", "3.59±12.34", "3.59±0.01", "3.59±4e-3", "3.59±0.00"]);
        assert_eq!(known("1234".into(), Some(5.6)), "1234±6");
        assert_eq!(known("1.00".into(), None), "1.00");
    }
}
