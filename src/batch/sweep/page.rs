//! The page of a sweep, and its figures.

use super::tables::{number, short, shown};
use super::{SettingScores, SweepSummary, groups};
use crate::output::netcdf::coordinates::safe_name;
use crate::output::report::page::{Drawing, Figure, Folded, Page, PageError, Section, render};
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, Dash};
use crate::scenario::Scenario;
use toml::Value;

/// The ratio of the largest to the least value from which on an axis is logarithmic.
const LOGARITHMIC: f64 = 20.0;

/// The lines of a method's curves, one for each combination of values that all methods share.
const DASHES: [Dash; 3] = [Dash::Solid, Dash::Dashed, Dash::Dotted];

impl SweepSummary {
    /// The page.
    ///
    /// # Errors
    /// As [`render`].
    pub fn html(&self, scenario: &Scenario) -> Result<String, PageError> {
        let tables = self.tables(scenario.model.variables());
        let figures = self.figures(scenario).into_iter().enumerate();
        let figures = figures.filter_map(|(number, own)| Figure::of_curves(&own.plot, number, own.caption)).collect();
        let best = self.best_in_words();
        let mut sections = vec![
            Section {
                title: "Scores".into(),
                text: format!(
                    "Means over the seeds, with half the width of their 95 % intervals from three seeds on. A star: the \
                     setting with the least {} of its method among those with the same values of the keys that all methods \
                     share. {}",
                    self.score,
                    best.join("; ")
                ),
                tables,
                ..Section::default()
            },
            Section {
                title: format!("{} over each key", self.score),
                text: "A curve for each combination of the other values that all methods share; of a method's own, the best."
                    .into(),
                figures,
                ..Section::default()
            },
            Section {
                title: format!("{} over two keys", self.score),
                text: "The mean over the seeds for every pair of values; of the settings that have the same pair, the least. The star \
                       is at the best setting, of each combination of the values that all methods share."
                    .into(),
                figures: self.heat_maps(scenario).into_iter().filter_map(|own| Figure::of_heat(&own.plot, own.caption)).collect(),
                ..Section::default()
            },
        ];
        if !self.failed.is_empty() {
            let lines: Vec<String> = self.failed.iter().map(|(place, error)| format!("{place}: {error}")).collect();
            let title = "What failed; the scores are over the other runs".to_string();
            let folded = vec![Folded { title, verbatim: lines.join("\n"), ..Folded::default() }];
            sections.push(Section { title: "Failures".into(), folded, ..Section::default() });
        }
        sections.push(Section::of_scenario(&scenario.name, &scenario.text));
        sections.retain(|it| !it.is_empty());
        let seeds: Vec<String> = self.seeds.iter().map(u64::to_string).collect();
        let facts = [
            ("phenomenon", scenario.phenomenon.clone()),
            ("source", scenario.source.clone()),
            ("scores", format!("over cycles {} to {}", self.scored_from_cycle, self.cycles)),
            ("seeds", seeds.join(", ")),
            ("runs", self.schedule.to_string()),
            ("version", format!("isobar {}", self.version)),
        ];
        render(&Page {
            title: scenario.title.clone(),
            subtitle: format!("{} over its settings", scenario.name),
            facts: facts.map(|(name, text)| (name.to_string(), text)).into(),
            sections,
            ..Page::default()
        })
    }

    /// The score over each key that has several values.
    pub fn figures(&self, scenario: &Scenario) -> Vec<Drawing<CurvePlot>> {
        let keys = scenario.sweep.iter().flat_map(|sweep| &sweep.vary);
        keys.filter(|(_, values)| values.len() > 1)
            .filter_map(|(key, values)| self.figure(scenario, key, values))
            .collect()
    }

    fn figure(&self, scenario: &Scenario, key: &str, values: &[Value]) -> Option<Drawing<CurvePlot>> {
        let numbers: Option<Vec<f64>> = values.iter().map(number).collect();
        let is_logarithmic = numbers.as_ref().is_some_and(|numbers| {
            let (least, most) = numbers.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
            least > 0.0 && most >= LOGARITHMIC * least
        });
        let place = |value: &Value| match &numbers {
            Some(_) => number(value).map(|number| if is_logarithmic { number.log10() } else { number }),
            // Words have no places: they are counted.
            None => values.iter().position(|own| own == value).map(|position| (position + 1) as f64),
        };
        let mut curves = Vec::new();
        for (name, settings) in self.methods.iter().filter(|(_, own)| own.iter().any(|it| it.values.contains_key(key)))
        {
            let color = of_method_on_paper(scenario.methods.get_index_of(name).unwrap_or(0));
            for ((common, group), dash) in groups(name, settings, &[key]).into_iter().zip(DASHES.into_iter().cycle()) {
                let least = |value: &Value| Some([place(value)?, self.least(&group, key, value)?]);
                let words = common.iter().map(|(key, value)| format!(", {} {}", short(key), shown(value)));
                let title = format!("{name}{}", words.collect::<String>());
                let curve = Curve { dash, ..Curve::new(&title, color, values.iter().filter_map(least).collect()) };
                curves.extend([curve.clone(), curve.unnamed(Dash::Points)]);
            }
        }
        let axis = match (&numbers, is_logarithmic) {
            (Some(_), false) => key.to_string(),
            (Some(_), true) => format!("log₁₀ {key}"),
            (None, _) => {
                let words = values.iter().enumerate().map(|(number, value)| format!("{} {}", number + 1, shown(value)));
                format!("{key}: {}", words.collect::<Vec<_>>().join(", "))
            }
        };
        let has_points = curves.iter().any(|curve| !curve.points.is_empty());
        let title = format!("{} over {key}", self.score);
        let caption = format!("Mean {} over seeds, by {key}.", self.score);
        let mut plot = CurvePlot::new(title, axis, self.score.clone(), curves);
        plot.from_zero = false;
        has_points.then(|| Drawing { stem: format!("sweep_{}", safe_name(key, "_")), caption, plot })
    }

    /// The least score of the settings with this value.
    fn least(&self, group: &[(usize, &SettingScores)], key: &str, value: &Value) -> Option<f64> {
        let own = group.iter().filter(|(_, own)| own.values.get(key) == Some(value));
        own.filter_map(|(_, own)| Some(own.scores.get(&self.score)?.mean)).reduce(f64::min)
    }
}
