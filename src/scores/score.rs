//! A score of a variable, or of a method as a whole: its key, its titles, its unit.

use super::kinds::{SCORES, ScoreKind, Unit, kind};
use crate::plot;

/// A score of a variable, or of a method as a whole.
#[derive(Clone, Copy, Debug)]
pub struct Score<'a> {
    /// Its kind.
    pub kind: &'static ScoreKind,
    /// Name and UDUNITS unit of the variable; empty for a score of the method as a whole.
    pub variable: (&'a str, &'a str),
}

impl<'a> Score<'a> {
    /// The scores of the kinds that are wanted: variable by variable, then those of the method as a whole.
    ///
    /// `variables` are names and units.
    pub fn all(variables: &[(&'a str, &'a str)], wanted: impl Fn(&ScoreKind) -> bool) -> Vec<Self> {
        let kinds = |per_variable| SCORES.iter().filter(move |kind| kind.per_variable == per_variable);
        let of_variables = variables.iter().flat_map(|&variable| kinds(true).map(move |kind| Self { kind, variable }));
        let others = kinds(false).map(|kind| Self { kind, variable: ("", "") });
        of_variables.chain(others).filter(|score| wanted(score.kind)).collect()
    }

    /// The key of its value in [`super::Values`].
    pub fn key(&self) -> String {
        self.kind.key(self.variable.0)
    }

    /// Its title above a column of a table, in two lines: `h [m]` and `analysis`, or `bias RMSE` and `[native units]`.
    pub fn title(&self) -> String {
        let (name, udunits) = self.variable;
        match self.kind.unit {
            Unit::Variable => format!("{name} [{}]\n{}", plot::unit(udunits), self.kind.title),
            Unit::Parameters => format!("{}\n[native\u{a0}units]", self.kind.title),
            Unit::One => format!("{}\n[1]", self.kind.title),
            Unit::SecondsPerCycle => format!("{}\n[s/cycle]", self.kind.title),
            Unit::Bytes => format!("{}\n[MB]", self.kind.title),
        }
    }

    /// Its unit in UDUNITS spelling; of scores of biases, which are averaged over several units, words.
    pub fn unit(&self) -> &'a str {
        match self.kind.unit {
            Unit::Variable => self.variable.1,
            Unit::Parameters => "that of each bias",
            Unit::One => "1",
            Unit::SecondsPerCycle => "s",
            Unit::Bytes => "byte",
        }
    }

    /// Its title in files: `rmse_analysis h [m]` with the unit in UDUNITS spelling, or `bias_rmse`.
    pub fn column(&self) -> String {
        let (name, udunits) = self.variable;
        if self.kind.per_variable { format!("{} {name} [{udunits}]", self.kind.name) } else { self.kind.name.into() }
    }

    /// The score in the column of a file with this title; `None` if there is no such score.
    pub fn of_column(title: &'a str) -> Option<Self> {
        let (name, variable) = title.split_once(' ').unwrap_or((title, ""));
        let variable = variable.strip_suffix(']').and_then(|it| it.rsplit_once(" [")).unwrap_or_default();
        kind(name).filter(|kind| kind.per_variable != variable.0.is_empty()).map(|kind| Self { kind, variable })
    }

    /// What it is of, with its unit, on one line: `h [m]`, `biases [native units]`.
    pub fn subject(&self) -> String {
        let (name, udunits) = self.variable;
        match self.kind.unit {
            Unit::Variable => format!("{name} [{}]", plot::unit(udunits)),
            Unit::Parameters => "biases [native\u{a0}units]".into(),
            _ => self.title().replace('\n', " "),
        }
    }

    /// A value in the unit that tables show.
    pub fn in_tables(&self, value: f64) -> f64 {
        if self.kind.unit == Unit::Bytes { value / 1e6 } else { value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::Against;

    #[test]
    fn scores_come_variable_by_variable_with_their_units() {
        let all = Score::all(&[("h", "m"), ("u", "m s-1")], |kind| kind.compared);
        let all: Vec<Score<'_>> = all.into_iter().filter(|score| score.kind.against == Against::Truth).collect();
        assert_eq!(all.iter().map(Score::key).collect::<Vec<_>>(), ["rmse_analysis.h", "rmse_analysis.u", "bias_rmse"]);
        let titles: Vec<String> = all.iter().map(Score::title).collect();
        for score in all {
            assert_eq!(Score::of_column(&score.column()).map(|found| found.key()), Some(score.key()));
        }
        assert!(["rmse_analysis", "bias_rmse h [m]", "cycle"].iter().all(|title| Score::of_column(title).is_none()));
        assert_eq!(titles, ["h [m]\nanalysis", "u [m\u{a0}s⁻¹]\nanalysis", "bias RMSE\n[native\u{a0}units]"]);
    }
}
