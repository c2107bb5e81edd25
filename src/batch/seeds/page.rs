//! The page of an experiment over seeds.

use super::SeedsSummary;
use crate::output::report::page::{Figure, Folded, Page, PageError, Section, render};
use crate::plot::colors::of_method_on_paper;
use crate::plot::intervals::{Known, Row};
use crate::plot::{Curve, CurvePlot, Dash, IntervalPlot};
use crate::scenario::Scenario;
use crate::scores::Score;
use crate::tables::figure;

impl SeedsSummary {
    /// The page.
    ///
    /// # Errors
    /// As [`render`].
    pub fn html(&self, scenario: &Scenario) -> Result<String, PageError> {
        let variables = scenario.model.variables();
        let against = &self.against;
        let about_smoothed = if self.has_smoothed() {
            " Smoothed: the estimates of the same cycles once later observations have revised them."
        } else {
            ""
        };
        let mut sections = vec![
            Section {
                title: "Scores".into(),
                text: format!(
                    "Means over {} seeds with half the width of their 95 % intervals (Student's t over the seeds): \
                     {} over cycles {} to {}, and what the methods claim their errors to be.{about_smoothed}",
                    self.seeds.len(),
                    if scenario.truth.is_some() { "root-mean-square errors" } else { "departures of the observations" },
                    self.scored_from_cycle,
                    self.cycles
                ),
                tables: self.means(variables),
                figures: self.intervals(variables, false),
                ..Section::default()
            },
            Section {
                title: format!("Differences from {against}"),
                text: format!(
                    "Mean over seeds of the score minus that of {against} with the same seed, in % of the latter, with \
                     half the width of its 95 % interval. A star: significant at the level of 5 %; coloured where less \
                     is better. Of twenty comparisons without any real difference one looks significant."
                ),
                tables: self.differences(variables),
                figures: self.intervals(variables, true),
                ..Section::default()
            },
            Section {
                title: "Seed by seed".into(),
                folded: vec![Folded {
                    title: "The scores of every seed".into(),
                    figures: self.figures(variables),
                    ..Folded::default()
                }],
                ..Section::default()
            },
        ];
        if !self.failed.is_empty() {
            let lines: Vec<String> = self.failed.iter().map(ToString::to_string).collect();
            let title = "What failed; the scores are over the other seeds".to_string();
            let folded = vec![Folded { title, text: lines.join("\n"), ..Folded::default() }];
            sections.push(Section { title: "Failures".into(), folded, ..Section::default() });
        }
        sections.push(Section::of_scenario(&scenario.name, &scenario.text));
        render(&Page {
            title: scenario.title.clone(),
            subtitle: format!("{} over {} seeds", scenario.name, self.seeds.len()),
            facts: self.facts(scenario),
            sections,
            ..Page::default()
        })
    }

    fn facts(&self, scenario: &Scenario) -> Vec<(String, String)> {
        let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
        [
            ("phenomenon", scenario.phenomenon.clone()),
            ("source", scenario.source.clone()),
            ("cycles", self.cycles.to_string()),
            ("seeds", seeds.join(", ")),
            ("runs", self.schedule.to_string()),
            ("version", format!("isobar {}", self.version)),
        ]
        .map(|(name, text)| (name.to_string(), text))
        .into()
    }

    /// The means of all methods below each other with their intervals, the best above; or the differences from the method
    /// with which they are compared.
    fn intervals(&self, variables: &[(&str, &str)], of_differences: bool) -> Vec<Figure> {
        let draw = |score: Score<'_>| {
            let (key, title) = (score.key(), score.subject());
            let row = |(place, method): (usize, &String)| {
                let own = self.score(method, &key)?;
                let (value, interval) = if of_differences {
                    let (percent, half) = own.difference?.percent()?;
                    (percent, half.map(|half| [percent - half, percent + half]))
                } else {
                    (own.mean, own.interval.map(|it| [it.low, it.high]))
                };
                let title = format!("{method}: {}", figure(value));
                let known = Known { series: place, value, interval, claimed: None, title };
                Some((own.mean, Row { label: method.clone(), values: vec![known] }))
            };
            let mut rows: Vec<(f64, Row)> = self.methods.keys().enumerate().filter_map(row).collect();
            rows.sort_by(|a, b| a.0.total_cmp(&b.0));
            let heading = format!("{} of {title}", score.kind.measured());
            let (label, caption) = if of_differences {
                let label = format!("% of {}", self.against);
                (
                    label,
                    format!("{heading}: difference from {} with the same seed, and its 95 % interval.", self.against),
                )
            } else {
                (title, format!("{heading}: mean over the seeds, and its 95 % interval."))
            };
            let plot = IntervalPlot {
                title: heading,
                label,
                series: (0..self.methods.len()).map(|place| (None, of_method_on_paper(place))).collect(),
                rows: rows.into_iter().map(|(_, row)| row).collect(),
                reference: of_differences.then_some(0.0),
                from_zero: !of_differences,
                width: 440.0,
            };
            Figure::of_intervals(&plot, caption)
        };
        Score::all(variables, |kind| kind.compared).into_iter().filter_map(draw).collect()
    }

    /// The error of each variable, and that of the biases, by seed.
    fn figures(&self, variables: &[(&str, &str)]) -> Vec<Figure> {
        let draw = |(number, score): (usize, Score<'_>)| {
            let (key, title) = (score.key(), score.subject());
            let curve = |(place, method): (usize, &String)| {
                let values = &self.score(method, &key)?.values;
                let pairs = self.seeds.iter().zip(values);
                let points = pairs.filter_map(|(&seed, value)| Some([seed as f64, (*value)?])).collect();
                Some(Curve { dash: Dash::Points, ..Curve::new(method, of_method_on_paper(place), points) })
            };
            let curves: Vec<Curve> = self.methods.keys().enumerate().filter_map(curve).collect();
            let heading = format!("{} of {title}", score.kind.measured());
            let caption = format!("{heading}, by seed.");
            Figure::of_curves(&CurvePlot::new(heading, "seed".into(), title, curves), number, caption)
        };
        Score::all(variables, |kind| kind.compared).into_iter().enumerate().filter_map(draw).collect()
    }
}
