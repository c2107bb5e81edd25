//! `scores.csv`, read back.

use super::{SavedRun, SavedRunError, read};
use crate::sink::scores::{PER_VARIABLE, SCORES_FILE};
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
pub type MethodSeries = BTreeMap<usize, CycleScores>;

/// The scores of a method in a cycle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CycleScores {
    /// Root-mean-square analysis error, by the number of the variable.
    pub rmse_analysis: Vec<Option<f64>>,
    /// Root-mean-square error of the bias parameters.
    pub bias_rmse: Option<f64>,
}

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
    let (cycle_at, method_at, bias_at) = (column("cycle")?, column("method")?, column("bias_rmse")?);
    let mut scores = Scores::default();
    let mut analysis_at = Vec::new();
    for (place, name) in header.iter().enumerate() {
        let variable = name.strip_prefix(PER_VARIABLE[1]).and_then(|rest| rest.strip_prefix(' '));
        if let Some((name, unit)) = variable.and_then(|it| it.strip_suffix(']')).and_then(|it| it.rsplit_once(" [")) {
            scores.variables.push((name.to_string(), unit.to_string()));
            analysis_at.push(place);
        }
    }
    if scores.variables.is_empty() {
        return Err(format!("it has no column `{} …`", PER_VARIABLE[1]));
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
        let own = CycleScores {
            rmse_analysis: analysis_at.iter().map(|&place| number(place)).collect::<Result<_, _>>()?,
            bias_rmse: number(bias_at)?,
        };
        let method = scores.methods.entry(field(method_at).to_string()).or_default();
        if method.insert(cycle, own).is_some() {
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
        assert_eq!(method[&1], CycleScores { rmse_analysis: vec![Some(2.5)], bias_rmse: None });
        assert_eq!(method[&2].bias_rmse, Some(0.5));
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let fault = |rows: &str| parse(&format!("{HEADER}{rows}")).unwrap_err();
        assert!(fault("1,t,a,3,x,\n").contains("line 2: `x` is not a number"));
        assert!(fault("1,t,a,3,2,\n-1,t,a,3,2,\n").contains("line 3: `-1`"));
        assert!(fault("1,t,a,3,2,\n1,t,a,3,2,\n").contains("twice"));
        assert!(fault("1,t\n").contains("fields"));
        assert!(parse("cycle,method\n").unwrap_err().contains("bias_rmse"));
        assert!(parse("cycle,method,bias_rmse\n").unwrap_err().contains("rmse_analysis"));
    }
}
