//! Scores beside the accepted ones, as a table.

use super::{Cell, NONE, Table};
use crate::scores::Regression;

impl Regression {
    /// The scores that moved, as a table for a terminal of this width; a sentence if they all stayed.
    pub fn describe(&self, width: usize) -> String {
        let mut rows = Vec::new();
        for score in self.scores.iter().filter(|score| score.from != score.to) {
            let verdict = match (score.from, score.to) {
                (None, _) => "not accepted yet",
                (_, None) => "missing",
                _ if score.within_tolerance => "within",
                _ => "OUTSIDE",
            };
            // More digits than other tables show: those that are accepted.
            let number = |value: Option<f64>| value.map_or(NONE.into(), |value| format!("{value:.5}"));
            let percent = score.change_percent.map_or(NONE.into(), |percent| format!("{percent:+.3}"));
            let cells = [number(score.from), number(score.to), percent, verdict.to_string()];
            let names = [&score.method, &score.score].map(|name| name.as_str().into());
            rows.push(names.into_iter().chain(cells.map(Cell::from)).collect());
        }
        let (all, outside) = (self.scores.len(), self.outside());
        let tolerance = 100.0 * self.relative_tolerance;
        let moved = Table::new(&["method", "score", "from", "to", "change [%]", "tolerance"], rows);
        match moved.filled() {
            None if all == 0 => "no scores".to_string(),
            None => format!("{all} scores, none moved"),
            Some(moved) => {
                format!(
                    "{}\n{outside} of {all} scores outside of the tolerance of {tolerance} %",
                    moved.terminal(width)
                )
            }
        }
    }
}
