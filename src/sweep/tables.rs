//! Scores over settings as tables, one for each method.

use super::{SettingScores, SweepSummary};
use crate::sink::report::tables::{Cell, NONE, Table, figure};
use toml::Value;

/// A value as it is shown: text without its quotes.
pub fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Float(number) => crate::plot::number(*number),
        other => other.to_string(),
    }
}

impl SweepSummary {
    /// The settings of each method with their scores; a star and `better` mark the best.
    ///
    /// `variables` are names and units.
    pub fn tables(&self, variables: &[(&str, &str)]) -> Vec<(&str, Table)> {
        let errors = variables.iter().map(|(name, unit)| (format!("rmse_analysis.{name}"), format!("{name} [{unit}]")));
        let crps = variables.iter().map(|(name, unit)| (format!("crps.{name}"), format!("CRPS of {name} [{unit}]")));
        let others = [("bias_rmse", "biases [own units]"), ("innovation_chi2", "χ²/n [1]")];
        let others = others.map(|(score, title)| (score.to_string(), title.to_string()));
        let mut columns: Vec<(String, String)> = errors.chain(crps).chain(others).collect();
        if !columns.iter().any(|(score, _)| *score == self.score) {
            columns.insert(0, (self.score.clone(), self.score.clone()));
        }
        self.methods.iter().map(|(name, settings)| (name.as_str(), self.table(name, settings, &columns))).collect()
    }

    fn table(&self, method: &str, settings: &[SettingScores], columns: &[(String, String)]) -> Table {
        let keys: Vec<&String> = settings.first().map_or(Vec::new(), |own| own.values.keys().collect());
        let used: Vec<&(String, String)> =
            columns.iter().filter(|(score, _)| settings.iter().any(|own| own.scores.contains_key(score))).collect();
        let short = |key: &String| key.rsplit('.').next().unwrap_or(key).to_string();
        let mut header = vec![method.to_string()];
        header.extend(keys.iter().map(|key| short(key)));
        header.extend(used.iter().map(|(_, title)| title.clone()));
        let row = |(number, own): (usize, &SettingScores)| {
            let is_best = self.best.get(method) == Some(&number) && settings.len() > 1;
            let mut row: Vec<Cell> = vec![own.directory.as_str().into()];
            row.extend(keys.iter().map(|key| Cell::from(own.values.get(*key).map_or(NONE.into(), shown))));
            row.extend(used.iter().map(|(name, _)| {
                let Some(score) = own.scores.get(name) else { return NONE.into() };
                let is_chosen = is_best && *name == self.score;
                let half_width =
                    score.interval.map_or_else(String::new, |it| format!(" ± {}", figure(it.half_width())));
                let star = if is_chosen { " *" } else { "" };
                let class = if is_chosen { "better" } else { "" };
                Cell { class, ..format!("{}{half_width}{star}", figure(score.mean)).into() }
            }));
            row
        };
        Table { header, rows: settings.iter().enumerate().map(row).collect() }
    }

    /// For each method that has several settings, its best one in words.
    pub fn best_in_words(&self) -> Vec<String> {
        let of_method = |(name, &number): (&String, &usize)| {
            let settings = &self.methods[name];
            let own = &settings[number];
            let values: Vec<String> = own.values.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            let score = figure(own.scores[&self.score].mean);
            (settings.len() > 1).then(|| format!("{name}: {} ({} {score})", values.join(", "), self.score))
        };
        self.best.iter().filter_map(of_method).collect()
    }
}
