//! Scores over settings as tables, one for each method.

use super::{SettingScores, SweepSummary, groups};
use crate::scores::Score;
use crate::tables::{Cell, NONE, Table, figure, with_half_width};
use toml::Value;

/// A value as it is shown: text without its quotes.
pub fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Float(number) => crate::plot::number(*number),
        other => other.to_string(),
    }
}

/// A value as a number, if it is one.
pub fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(whole) => Some(*whole as f64),
        Value::Float(number) => Some(*number),
        _ => None,
    }
}

/// The last part of a dotted key.
pub fn short(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

impl SweepSummary {
    /// The settings of each method with their scores, a table for each method; a star and `better` mark the best.
    ///
    /// `variables` are names and units.
    pub fn tables(&self, variables: &[(&str, &str)]) -> Vec<Table> {
        let columns = Score::all(variables, |kind| kind.swept);
        let mut columns: Vec<(String, String)> = columns.iter().map(|score| (score.key(), score.title())).collect();
        if !columns.iter().any(|(key, _)| *key == self.score) {
            columns.insert(0, (self.score.clone(), self.score.clone()));
        }
        self.methods.iter().map(|(name, settings)| self.table(name, settings, &columns)).collect()
    }

    fn table(&self, method: &str, settings: &[SettingScores], columns: &[(String, String)]) -> Table {
        let keys: Vec<&String> = settings.first().map_or(Vec::new(), |own| own.values.keys().collect());
        let used: Vec<&(String, String)> =
            columns.iter().filter(|(score, _)| settings.iter().any(|own| own.scores.contains_key(score))).collect();
        let has_choice = self.has_choice(method);
        let mut header = vec![method.to_string()];
        header.extend(keys.iter().map(|key| short(key).to_string()));
        header.extend(used.iter().map(|(_, title)| title.clone()));
        let row = |(number, own): (usize, &SettingScores)| {
            let is_best = has_choice && self.best.get(method).is_some_and(|best| best.contains(&number));
            let mut row: Vec<Cell> = vec![own.directory.as_str().into()];
            row.extend(keys.iter().map(|key| Cell::from(own.values.get(*key).map_or(NONE.into(), shown))));
            row.extend(used.iter().map(|(name, _)| {
                let Some(score) = own.scores.get(name) else { return NONE.into() };
                let is_chosen = is_best && *name == self.score;
                let known = with_half_width(figure(score.mean), score.interval.map(|it| it.half_width()));
                let star = if is_chosen { " *" } else { "" };
                let class = if is_chosen { "better" } else { "" };
                Cell { class, ..format!("{known}{star}").into() }
            }));
            row
        };
        Table { header, rows: settings.iter().enumerate().map(row).collect() }
    }

    /// Whether a method has several settings with the same shared values.
    pub(super) fn has_choice(&self, method: &str) -> bool {
        groups(method, &self.methods[method], &[]).iter().any(|(_, group)| group.len() > 1)
    }

    /// The best settings of each method that has a choice, in words.
    pub fn best_in_words(&self) -> Vec<String> {
        let of_one = |name: &str, number: usize| {
            let own = &self.methods[name][number];
            let values: Vec<String> = own.values.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            let at_edge: Vec<&str> =
                own.values.keys().filter(|key| self.is_at_edge(name, number, key)).map(|it| short(it)).collect();
            let edge = match at_edge[..] {
                [] => String::new(),
                _ => format!("; at the edge of its range, and perhaps better beyond: {}", at_edge.join(", ")),
            };
            format!("{name}: {} ({} {}{edge})", values.join(", "), self.score, figure(own.scores[&self.score].mean))
        };
        let with_choice = self.best.iter().filter(|(name, _)| self.has_choice(name));
        with_choice.flat_map(|(name, best)| best.iter().map(move |&number| of_one(name, number))).collect()
    }

    /// Whether a setting of a method has the least or the largest value of one of its own keys, if that has three or more numbers.
    fn is_at_edge(&self, method: &str, setting: usize, key: &str) -> bool {
        let settings = &self.methods[method];
        let number = |own: &SettingScores| number(own.values.get(key)?);
        let mut all: Vec<f64> = settings.iter().filter_map(number).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        let ends = [all.first(), all.last()];
        key.starts_with("methods.")
            && all.len() >= 3
            && number(&settings[setting]).is_some_and(|own| ends.contains(&Some(&own)))
    }
}
