//! The score of a sweep over two keys at once.

use super::tables::{short, shown};
use super::{SettingScores, SweepSummary, groups};
use crate::output::netcdf::coordinates::safe_name;
use crate::output::report::page::Drawing;
use crate::plot::{HeatCell, HeatMap};
use crate::scenario::Scenario;
use crate::tables::figure;
use toml::Value;

/// The most figures.
const MOST_FIGURES: usize = 24;

impl SweepSummary {
    /// For each method the score over each pair of keys that have several values: the first across, the second up.
    pub(super) fn heat_maps(&self, scenario: &Scenario) -> Vec<Drawing<HeatMap>> {
        let Some(sweep) = &scenario.sweep else { return Vec::new() };
        let several: Vec<(&String, &Vec<Value>)> = sweep.vary.iter().filter(|(_, values)| values.len() > 1).collect();
        let mut drawings = Vec::new();
        for (method, settings) in &self.methods {
            let has = |key: &str| settings.iter().any(|own| own.values.contains_key(key));
            let keys: Vec<_> = several.iter().filter(|(key, _)| has(key)).collect();
            for (number, across) in keys.iter().enumerate() {
                for up in &keys[number + 1..] {
                    for (common, group) in groups(method, settings, &[across.0, up.0]) {
                        let words = common.iter().map(|(key, value)| format!(", {} {}", short(key), shown(value)));
                        let of = format!("{method}{}", words.collect::<String>());
                        drawings.push(self.heat_map(method, &of, [across, up], &group));
                    }
                }
            }
        }
        drawings.truncate(MOST_FIGURES);
        for (number, drawing) in drawings.iter_mut().enumerate() {
            drawing.stem = format!("sweep_pair_{:02}_{}", number + 1, drawing.stem);
        }
        drawings
    }

    fn heat_map(
        &self,
        method: &str,
        of: &str,
        [across, up]: [&(&String, &Vec<Value>); 2],
        group: &[(usize, &SettingScores)],
    ) -> Drawing<HeatMap> {
        let best = self.best.get(method).filter(|_| self.has_choice(method));
        let cell = |row: &Value, column: &Value| {
            let is_there =
                |own: &SettingScores| own.values.get(across.0) == Some(column) && own.values.get(up.0) == Some(row);
            let own = || group.iter().filter(|(_, own)| is_there(own));
            let scores = own().filter_map(|(_, own)| Some(own.scores.get(&self.score)?.mean));
            let value = scores.reduce(f64::min);
            let is_best = own().any(|(number, _)| best.is_some_and(|best| best.contains(number)));
            HeatCell { value, text: value.map_or_else(String::new, figure), is_best }
        };
        let cells = up.1.iter().flat_map(|row| across.1.iter().map(move |column| (row, column)));
        let axis = |(key, values): &(&String, &Vec<Value>)| (key.to_string(), values.iter().map(shown).collect());
        Drawing {
            stem: safe_name(method, "_-"),
            caption: format!("Mean {} of {of} over seeds, by {} and {}.", self.score, across.0, up.0),
            plot: HeatMap {
                title: format!("{of}: {}", self.score),
                columns: axis(across),
                rows: axis(up),
                cells: cells.map(|(row, column)| cell(row, column)).collect(),
            },
        }
    }
}
