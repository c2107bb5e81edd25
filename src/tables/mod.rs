//! Tables of scores and of everything else that is shown in rows: on the terminal, on the page, in the viewer and in files.
//!
//! | module | what it holds |
//! |---|---|
//! | [`scores`] | the scores of a run |
//! | [`diagnostics`], [`stability`] | what the methods' diagnostics and the stability monitor found |
//! | [`forecasts`] | forecasts ahead by lead time |
//! | [`warnings`] | warnings of forecasts ahead, their scores and the last outlook |
//! | [`regression`] | scores beside the accepted ones |
//! | [`terminal`] | how tables look on a terminal |

pub mod diagnostics;
pub mod forecasts;
pub mod regression;
pub mod scores;
pub mod stability;
pub mod terminal;
pub mod warnings;

use crate::scores::statistics::Interval;
use serde::Serialize;

/// The text of a cell without a figure.
pub const NONE: &str = "–";

/// Width of tables where no terminal says another.
pub const WIDTH: usize = 100;

/// The most bias parameters or other parameters that have a row.
pub const MOST_PARAMETERS: usize = 500;

/// A table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    /// Names of the columns; a line break parts them in two.
    pub header: Vec<String>,
    /// The cells, row by row; the first of each row names it.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Cell {
    /// Its text.
    pub text: String,
    /// What it adds in small print.
    pub note: String,
    /// Class of its style: `better`, `worse`, `open`, `words` for what may be broken anywhere on paper, or empty.
    pub class: &'static str,
}

/// A table with its heading and an explanation.
pub struct Titled {
    /// The heading.
    pub title: &'static str,
    /// How to read it.
    pub text: &'static str,
    /// The table.
    pub table: Table,
}

impl Table {
    /// A table with these columns.
    pub fn new<N: ToString>(header: &[N], rows: Vec<Vec<Cell>>) -> Self {
        Self { header: header.iter().map(ToString::to_string).collect(), rows }
    }

    /// The table in markdown.
    pub fn markdown(&self) -> String {
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let escaped = |text: &str| text.replace('|', "\\|").replace('\n', " ");
        let text = |cell: &Cell| match cell.note.as_str() {
            "" => escaped(&cell.text),
            note => format!("{} ({})", escaped(&cell.text), escaped(note)),
        };
        let rows = self.rows.iter().map(|row| line(row.iter().map(text).collect()));
        let header = line(self.header.iter().map(|name| escaped(name)).collect());
        format!("{header}|{}\n{}", "---|".repeat(self.header.len()), rows.collect::<String>())
    }

    /// The table as CSV, without notes.
    pub fn csv(&self) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let mut rows = self.rows.iter().map(|row| row.iter().map(|cell| cell.text.as_str()).collect::<Vec<_>>());
        let written =
            writer.write_record(&self.header).and_then(|()| rows.try_for_each(|row| writer.write_record(row)));
        let bytes = written.ok().and_then(|()| writer.into_inner().ok()).expect("memory takes rows of equal length");
        String::from_utf8(bytes).expect("CSV of UTF-8 is UTF-8")
    }

    /// The table, or `None` if it has no rows.
    pub fn filled(self) -> Option<Self> {
        (!self.rows.is_empty()).then_some(self)
    }
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

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        count.to_string().into()
    }
}

impl Cell {
    /// A figure, or a dash.
    pub fn figure(value: Option<f64>) -> Self {
        value.map_or_else(|| NONE.into(), figure).into()
    }

    /// A number with all its digits, for files; empty if there is none.
    pub fn in_full(value: Option<f64>) -> Self {
        value.map_or_else(String::new, |value| value.to_string()).into()
    }

    /// A number with up to six digits, all of them significant, or a dash.
    pub fn exact(value: Option<f64>) -> Self {
        let shown = |value: f64| match value.abs() {
            0.0 => "0".to_string(),
            size if !(1e-4..1e9).contains(&size) => format!("{value:.5e}"),
            size => {
                let text = format!("{value:.*}", (5 - size.log10().floor() as i32).clamp(0, 9) as usize);
                if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
            }
        };
        value.map_or_else(|| NONE.into(), shown).into()
    }

    /// A figure with its interval.
    pub fn known(value: Option<f64>, interval: Option<&Interval>) -> Self {
        let note = interval.map_or_else(String::new, |it| format!("{} … {}", figure(it.low), figure(it.high)));
        Self { note, ..Self::figure(value) }
    }

    /// A share in percent, or a dash.
    pub fn percent(share: Option<f64>) -> Self {
        share.map_or_else(|| NONE.into(), |share| format!("{:.1} %", 100.0 * share)).into()
    }
}

/// A figure with three significant digits: the rounding of all scores.
pub fn figure(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() => value.to_string(),
        0.0 => "0".into(),
        size if !(1e-3..1e5).contains(&size) => format!("{value:.2e}"),
        size => format!("{value:.*}", (2 - size.log10().floor() as i32).clamp(0, 5) as usize),
    }
}

/// `3.59±0.12`: half the width of an interval with as many decimals as the figure, or with one digit if it is smaller.
pub fn with_half_width(text: String, half_width: Option<f64>) -> String {
    let Some(half_width) = half_width else { return text };
    let decimals = text.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    let rounded = format!("{half_width:.decimals$}");
    if half_width > 0.0 && rounded.parse() == Ok(0.0) {
        format!("{text}±{half_width:.0e}")
    } else {
        format!("{text}±{rounded}")
    }
}

/// Whether a cell is a figure or a dash, and no word.
fn is_figure(text: &str) -> bool {
    let digits = text.trim_start_matches(['+', '-', '−']);
    matches!(text, NONE | "NaN")
        || digits.starts_with(|first: char| first.is_ascii_digit())
        || digits.starts_with("inf")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits() {
        let texts = [19.25, 3.846, 0.01234, 0.0, 123.4, -2.5, 1e-9, 123456.0, f64::NAN].map(figure);
        assert_eq!(texts, ["19.2", "3.85", "0.0123", "0", "123", "-2.50", "1.00e-9", "1.23e5", "NaN"]);
    }

    #[test]
    fn a_cell_without_a_figure_says_so() {
        assert_eq!(Cell::figure(None).text, NONE);
        let known = Cell::known(Some(2.0), Some(&Interval { low: 1.5, high: 2.5 }));
        assert_eq!((known.text.as_str(), known.note.as_str()), ("2.00", "1.50 … 2.50"));
    }

    #[test]
    fn half_widths_have_the_decimals_of_their_figures() {
        let texts = [0.1234, 12.34, 0.00567, 0.004, 0.0].map(|half| with_half_width("3.59".into(), Some(half)));
        assert_eq!(texts, ["3.59±0.12", "3.59±12.34", "3.59±0.01", "3.59±4e-3", "3.59±0.00"]);
        assert_eq!(with_half_width("1234".into(), Some(5.6)), "1234±6");
        assert_eq!(with_half_width("1.00".into(), None), "1.00");
    }

    #[test]
    fn the_same_table_is_shown_on_a_terminal_in_markdown_and_as_csv() {
        let note = Cell { note: "1 … 3".into(), ..Cell::figure(Some(2.0)) };
        let rows = vec![vec!["a|b".into(), note], vec!["long name".into(), Cell::figure(Some(-10.0))]];
        let table = Table::new(&["method", "h [m]\nanalysis"], rows);
        assert_eq!(
            table.terminal(WIDTH),
            "method       h [m]\n          analysis\na|b           2.00\nlong name    -10.0"
        );
        assert!(table.terminal_with_notes(WIDTH).contains("2.00 (1 … 3)"));
        let rows = "| a\\|b | 2.00 (1 … 3) |\n| long name | -10.0 |\n";
        assert_eq!(table.csv(), "method,\"h [m]\nanalysis\"\na|b,2.00\nlong name,-10.0\n");
        assert_eq!(table.markdown(), format!("| method | h [m] analysis |\n|---|---|\n{rows}"));
    }
}
