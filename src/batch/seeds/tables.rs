//! Scores over seeds as tables, for the terminal and the page.

use super::{SeedsScore, SeedsSummary};
use crate::scores::{Better, Part, Score, ScoreKind};
use crate::tables::{Cell, NONE, Table, figure, with_half_width};

impl SeedsSummary {
    /// The means with half the width of their intervals: analysis and spread of each variable; then all other scores, those
    /// of smoothed estimates in a table of the methods that have them.
    ///
    /// `variables` are names and units.
    pub fn means(&self, variables: &[(&str, &str)]) -> Vec<Table> {
        let all: Vec<&str> = self.methods.keys().map(String::as_str).collect();
        self.tables("method", &all, variables, |score, _| {
            let half_width = score.interval.map(|interval| interval.half_width());
            with_half_width(figure(score.mean), half_width).into()
        })
    }

    /// The differences from the method `against` in % of its scores, in the same parts. A star marks significance.
    pub fn differences(&self, variables: &[(&str, &str)]) -> Vec<Table> {
        let others: Vec<&str> = self.methods.keys().map(String::as_str).filter(|name| *name != self.against).collect();
        self.tables(&format!("% of {}", self.against), &others, variables, |score, kind| {
            let Some((difference, (percent, half_width))) =
                score.difference.and_then(|difference| Some((difference, difference.percent()?)))
            else {
                return NONE.into();
            };
            // What a run costs depends on what else the machine does.
            let is_significant = difference.significant == Some(true) && kind.part != Part::Cost;
            let star = if is_significant { " *" } else { "" };
            let class = match kind.better {
                Better::Less if is_significant && percent < 0.0 => "better",
                Better::Less if is_significant => "worse",
                _ => "open",
            };
            let text = format!("{}{star}", with_half_width(format!("{percent:+.1}"), half_width));
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
        cell: impl Fn(&SeedsScore, &ScoreKind) -> Cell,
    ) -> Vec<Table> {
        let parts: [&[Part]; 4] =
            [&[Part::Analysis], &[Part::Background, Part::Biases, Part::Cost], &[Part::Forecast], &[Part::Smoothed]];
        let table = |parts: &[Part]| {
            let mut columns = Score::all(variables, |kind| kind.tabulated && parts.contains(&kind.part));
            columns.retain(|score| self.methods.values().any(|scores| scores.contains_key(&score.key())));
            let row = |method: &&str| -> Option<Vec<Cell>> {
                let scores = columns.iter().map(|column| (self.score(method, &column.key()), column.kind));
                let cells = scores.clone().map(|(score, kind)| score.map_or(NONE.into(), |it| cell(it, kind)));
                // Most methods have no smoother, and most scenarios no warnings.
                let may_be_left_out = matches!(parts, [Part::Smoothed | Part::Forecast]);
                let is_left_out = may_be_left_out && scores.clone().all(|(score, _)| score.is_none());
                (!is_left_out).then(|| std::iter::once((*method).into()).chain(cells).collect())
            };
            let header = std::iter::once(title.to_string()).chain(columns.iter().map(Score::title));
            Table { header: header.collect(), rows: methods.iter().filter_map(row).collect() }.filled()
        };
        parts.into_iter().filter_map(table).collect()
    }
}
