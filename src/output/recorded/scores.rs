//! `scores.csv`, read back.

use super::{SavedRun, SavedRunError, read};
use crate::output::scores::SCORES_FILE;
use crate::scores::{Against, SCORES, Score, ScoreKind, Values};
use indexmap::IndexMap;
use std::collections::BTreeMap;

/// The scores of every cycle of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scores {
    /// Names and units of the variables.
    pub variables: Vec<(String, String)>,
    /// The methods, in the order of the file.
    pub methods: IndexMap<String, MethodSeries>,
}

/// The scores of a method, by cycle.
pub type MethodSeries = BTreeMap<usize, Values>;

impl SavedRun {
    /// The scores of the run's cycles.
    ///
    /// # Errors
    /// If they cannot be read, with the line.
    pub fn scores(&self) -> Result<Scores, SavedRunError> {
        let path = self.directory.join(SCORES_FILE);
        parse(&read(&path)?).map_err(|reason| SavedRunError::new(&path, reason))
    }
}

impl Scores {
    /// Reads the text of `scores.csv`.
    ///
    /// # Errors
    /// In words, with the line.
    pub fn parse(text: &str) -> Result<Self, String> {
        parse(text)
    }
}

fn parse(text: &str) -> Result<Scores, String> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(|error| error.to_string())?.clone();
    let column = |name: &str| {
        let place = header.iter().position(|it| it == name);
        place.ok_or_else(|| format!("it has no column `{name}`"))
    };
    let (cycle_at, method_at) = (column("cycle")?, column("method")?);
    let found: Vec<(usize, Score<'_>)> =
        header.iter().enumerate().filter_map(|(place, title)| Some((place, Score::of_column(title)?))).collect();
    let mut scores = Scores::default();
    for (_, Score { variable: (name, unit), .. }) in &found {
        if !name.is_empty() && scores.variables.iter().all(|(known, _)| known != name) {
            scores.variables.push((name.to_string(), unit.to_string()));
        }
    }
    let is_compared = |against| move |kind: &&ScoreKind| kind.compared && kind.against == against;
    let without_truth = found.iter().any(|(_, score)| score.kind.against == Against::Used);
    let against = if without_truth { Against::Used } else { Against::Truth };
    for kind in SCORES.iter().filter(is_compared(against)) {
        if !found.iter().any(|(_, score)| score.kind.name == kind.name) {
            return Err(format!("it has no column `{}{}`", kind.name, if kind.per_variable { " …" } else { "" }));
        }
    }
    for record in reader.records() {
        let record = record.map_err(|error| error.to_string())?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |place: usize| record.get(place).unwrap_or_default();
        let number = |place: usize| match field(place) {
            "" => Ok(None),
            text => text.parse::<f64>().map(Some).map_err(|_| format!("line {line}: `{text}` is not a number")),
        };
        let text = field(cycle_at);
        let cycle: usize = text.parse().map_err(|_| format!("line {line}: `{text}` is not the number of a cycle"))?;
        let mut values = Values::new();
        for (place, score) in &found {
            values.extend(number(*place)?.map(|value| (score.key(), value)));
        }
        let method = scores.methods.entry(field(method_at).to_string()).or_default();
        if method.insert(cycle, values).is_some() {
            return Err(format!("line {line}: the method has cycle {cycle} twice"));
        }
    }
    Ok(scores)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "cycle,valid_time,method,rmse_background h [m],rmse_analysis h [m],bias_rmse\n";

    #[test]
    fn scores_are_read_by_the_names_of_their_columns() {
        let scores = parse(&format!("{HEADER}1,t,\"a, b\",3,2.5,\n2,t,\"a, b\",3,1.5,0.5\n")).unwrap();
        assert_eq!(scores.variables, [("h".to_string(), "m".to_string())]);
        let method = &scores.methods["a, b"];
        let values = |values: &[(&str, f64)]| -> Values {
            values.iter().map(|&(key, value)| (key.to_string(), value)).collect()
        };
        assert_eq!(method[&1], values(&[("rmse_background.h", 3.0), ("rmse_analysis.h", 2.5)]));
        assert_eq!(method[&2]["bias_rmse"], 0.5);
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let fault = |rows: &str| parse(&format!("{HEADER}{rows}")).unwrap_err();
        assert!(fault("1,t,a,3,x,\n").contains("line 2: `x` is not a number"));
        assert!(fault("1,t,a,3,2,\n-1,t,a,3,2,\n").contains("line 3: `-1`"));
        assert!(fault("1,t,a,3,2,\n1,t,a,3,2,\n").contains("twice"));
        assert!(fault("1,t\n").contains("fields"));
        assert!(parse("cycle,method,rmse_analysis h [m]\n").unwrap_err().contains("bias_rmse"));
        assert!(parse("cycle,method,bias_rmse\n").unwrap_err().contains("rmse_analysis"));
    }
}
