//! What is to be known better: a combination of the unknowns at the time of the next analysis.

use super::error::AdviceError;
use crate::event::RunInfo;
use crate::plot;
use crate::scenario::Scenario;
use crate::text::{clean, nearest};
use crate::threshold_warning::Area;
use isobar_assim::{Estimate, Unknown};
use isobar_model::State;
use isobar_model::forecast::{backward_ad, trajectory};
use isobar_obs::Station;

/// What is to be known better.
#[derive(Clone, Debug, PartialEq)]
pub enum Functional {
    /// The bias parameter of this name.
    Bias(String),
    /// The mean of a variable over the grid points of an area.
    Mean {
        /// The variable.
        variable: String,
        /// Where.
        at: Area,
    },
}

/// The functional as a combination of unknowns.
pub(super) struct Asked {
    pub words: String,
    pub unit: String,
    pub combination: Vec<(Unknown, f64)>,
}

impl Asked {
    /// The functional `lead_hours` after the next analysis, before which the method has forecast `estimate`.
    pub fn new(
        functional: &Functional,
        lead_hours: f64,
        scenario: &Scenario,
        info: &RunInfo,
        stations: &[Station],
        estimate: &Estimate,
    ) -> Result<Self, AdviceError> {
        let cycles = (lead_hours / info.window.hours()).round();
        if !(0.0..=1e5).contains(&cycles) || (lead_hours - cycles * info.window.hours()).abs() > 1e-9 {
            return Err(AdviceError::Request(format!(
                "a lead time of {} h is not a whole number of cycles of {} h",
                lead_hours,
                info.window.hours()
            )));
        }
        let cycles = cycles as usize;
        let later = if cycles > 0 { format!(", {} h later", plot::number(lead_hours)) } else { String::new() };
        match functional {
            Functional::Bias(name) => {
                let Some(number) = info.calibration.position(name) else { return Err(unknown_bias(name, info)) };
                let parameter = &info.calibration.parameters[number];
                let kept = parameter.drift.kept(info.window * cycles);
                Ok(Self {
                    words: format!("the bias {name}{later}"),
                    unit: parameter.unit.clone(),
                    combination: vec![(Unknown::Parameter(number), kept)],
                })
            }
            Functional::Mean { variable, at } => {
                let Some(number) = info.layout.variable(variable) else {
                    let names = info.layout.variables.iter().map(|it| it.name).collect::<Vec<_>>().join(", ");
                    let variable = clean(variable);
                    return Err(AdviceError::Request(format!("there is no variable {variable}, but {names}")));
                };
                let points = at.points(number, &info.layout, stations).map_err(AdviceError::Request)?;
                let mut weights = vec![0.0; info.layout.len()];
                points.iter().for_each(|&point| weights[point] = 1.0 / points.len() as f64);
                back(&mut weights, scenario, estimate, cycles)?;
                let entries = weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0);
                let what = if points.len() == 1 { "" } else { "the mean of " };
                Ok(Self {
                    words: format!("{what}{variable} {}{later}", at.describe()),
                    unit: info.layout.variables[number].unit.to_string(),
                    combination: entries.map(|(index, &weight)| (Unknown::Value(index), weight)).collect(),
                })
            }
        }
    }
}

/// v ← Aᵀ v over some cycles along the forecast from an estimate. The states at the beginnings of cycles are kept, those of the
/// steps of one cycle at a time.
fn back(v: &mut [f64], scenario: &Scenario, from: &Estimate, cycles: usize) -> Result<(), AdviceError> {
    if cycles == 0 {
        return Ok(());
    }
    let window = scenario.cycle.window;
    let model = scenario.model.build(&scenario.grid.grid, window);
    let model = model.map_err(|error| AdviceError::Request(error.to_string()))?;
    let steps = window.steps_of(model.time_step()).expect("the scenario's window fits its steps");
    let mut starts: Vec<State> = vec![from.state.clone()];
    for _ in 1..cycles {
        let mut next = starts[starts.len() - 1].clone();
        isobar_model::forecast::forecast(&*model, &mut next, steps)?;
        starts.push(next);
    }
    for start in starts.iter().rev() {
        backward_ad(&*model, &trajectory(&*model, start, steps)?, v);
    }
    Ok(())
}

fn unknown_bias(name: &str, info: &RunInfo) -> AdviceError {
    let names = || info.calibration.parameters.iter().map(|parameter| parameter.name.as_str());
    let hint = match (nearest(name, names()), names().next()) {
        (Some(near), _) => format!("; did you mean {near}?"),
        (None, Some(first)) => format!("; there are {}, such as {first}", info.calibration.len()),
        (None, None) => "; no observations have biases that methods could estimate".into(),
    };
    AdviceError::Request(format!("there is no bias {}{hint}", clean(name)))
}
