//! `<method>_forecast.nc`: the forecasts of one method ahead of one analysis, the last from which they reach the longest lead
//! time within the run, with the standard deviations that it claims and the probabilities of warnings; and the scores of all
//! its forecasts by lead time, with their 95 % intervals. Lead time 0 is the analysis.

use super::coordinates as cf;
use super::file::{Definition, FILL_VALUE, NetcdfFile, Values, Variable};
use crate::event::{Forecast, RunInfo};
use crate::lead_times::LeadTimes;
use crate::output::SinkError;
use crate::scores::forecast::{FORECAST_SCORES, Known, RMSE, SPREAD, SPREAD_PER_ERROR};
use crate::scores::{ForecastScores, MethodScores, Summary};
use crate::threshold_warning::{PlacedWarning, ThresholdWarning};
use isobar_assim::Estimate;
use isobar_model::Variable as StateVariable;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What the file of one method will hold.
#[derive(Debug)]
pub struct ForecastFile {
    path: PathBuf,
    /// Number of the method in [`RunInfo::methods`].
    method: usize,
    times: LeadTimes,
    /// The cycle from whose analysis the forecasts start.
    start: usize,
    /// By lead time in cycles.
    forecasts: BTreeMap<usize, Estimate>,
}

impl ForecastFile {
    /// The file of a method, without anything in it.
    pub fn new(path: PathBuf, info: &RunInfo, method: usize, times: LeadTimes) -> Self {
        Self { path, method, times, start: info.last_complete_start(times), forecasts: BTreeMap::new() }
    }

    /// Takes a forecast, if it is one that the file holds.
    pub fn add(&mut self, forecast: &Forecast<'_>) {
        if forecast.from_cycle == self.start {
            let lead = forecast.cycle - forecast.from_cycle;
            self.forecasts.insert(lead, forecast.estimate.clone().into_owned());
        }
    }

    /// Writes the file; what is not known is missing.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, info: &RunInfo, summary: &Summary) -> Result<(), SinkError> {
        let method = &info.methods[self.method];
        let of_method = summary.methods.get(&method.name);
        let scores = of_method.and_then(|scores| scores.forecasts.as_ref());
        let has_spread = self.forecasts.values().any(|estimate| estimate.state_spread.is_some());
        let mut file = NetcdfFile::create(&self.path, self.definition(info, scores, has_spread))?;
        for lead in self.times.kept() {
            let mut record: Vec<(String, Vec<f64>)> = vec![
                ("lead_time".into(), vec![info.lead_hours(lead)]),
                ("time".into(), vec![info.time(self.start + lead).seconds() as f64]),
            ];
            record.extend(self.fields(info, lead, has_spread));
            record.extend(self.probabilities(info, lead));
            record.extend(score_values(info, scores, info.lead_hours(lead)));
            record.extend(brier_values(info, of_method, info.lead_hours(lead)));
            let record: Vec<(&str, &[f64])> = record.iter().map(|(name, values)| (name.as_str(), &**values)).collect();
            file.append(&record)?;
        }
        Ok(())
    }

    fn definition(&self, info: &RunInfo, scores: Option<&ForecastScores>, has_spread: bool) -> Definition {
        let method = &info.methods[self.method];
        let mut definition = Definition::new();
        cf::add_global_attributes(&mut definition, info, &format!("forecasts of {}", method.name));
        definition.attribute("method", method.name.as_str());
        definition.attribute("method_description", method.description.as_str());
        if scores.is_some() {
            definition.attribute("comment", "anomaly correlations count anomalies from the first background");
        }
        definition.record_dimension("lead_time");
        let lead_time = Variable::new("lead_time", &[]).with("standard_name", "forecast_period");
        definition.record(lead_time.with("long_name", "time since the analysis").with("units", "hours"));
        let instant = |name: &str, standard_name: &str, long_name: &str| {
            let variable = Variable::new(name, &[]).with("standard_name", standard_name).with("long_name", long_name);
            variable.with("units", "seconds since 1970-01-01 00:00:00").with("calendar", "standard")
        };
        definition.record(instant("time", "time", "valid time"));
        definition.fixed(
            instant("forecast_reference_time", "forecast_reference_time", "valid time of the analysis"),
            Values::Numbers(vec![info.time(self.start).seconds() as f64]),
        );
        cf::add_grid(&mut definition, &info.layout, info.projection.as_ref());
        for variable in &info.layout.variables {
            let field = |suffix: &str, meaning: String| {
                let name = format!("{}_forecast{suffix}", variable.name);
                let field = cf::field(&name, &meaning, variable.unit, variable.location, info.projection.is_some());
                field.with_more("coordinates", "time forecast_reference_time")
            };
            let forecast = field("", format!("forecast {}", variable.long_name));
            definition.record(forecast.with_some("standard_name", variable.standard_name));
            if has_spread {
                let meaning = format!("claimed standard deviation of forecast {}", variable.long_name);
                let standard_name = variable.standard_name.map(|name| format!("{name} standard_error"));
                definition.record(field("_spread", meaning).with_some("standard_name", standard_name));
            }
        }
        self.add_warnings(&mut definition, info);
        add_scores(&mut definition, info, scores);
        definition
    }

    /// For each warning its probability, that of the event at each grid point, and the scores.
    fn add_warnings(&self, definition: &mut Definition, info: &RunInfo) {
        for placed in &info.warnings {
            let warning = &placed.warning;
            let (name, described) = (names_of(warning), warning.describe(&info.layout));
            let about = format!("probability of {described}; in an area the largest of a single grid point");
            let probability = Variable::new(name.probability.as_str(), &[]).with("long_name", about).with("units", "1");
            definition.record(probability.with("_FillValue", FILL_VALUE));
            let variable = &info.layout.variables[warning.variable];
            let meaning =
                format!("probability of {} {} {}", variable.long_name, warning.side.word(), warning.threshold);
            let field = cf::field(&name.field, &meaning, "1", variable.location, info.projection.is_some());
            definition.record(field.with_more("coordinates", "time forecast_reference_time"));
            for (name, meaning) in [(&name.brier, "Brier score"), (&name.occurred, "frequency of the event")] {
                let about = format!("{meaning} over all forecasts, {described}");
                let added = Variable::new(name.as_str(), &[]).with("long_name", about).with("units", "1");
                definition.record(added.with("_FillValue", FILL_VALUE));
            }
        }
    }

    /// The probabilities of the warnings at a lead time.
    fn probabilities(&self, info: &RunInfo, lead: usize) -> Vec<(String, Vec<f64>)> {
        let forecast = self.forecasts.get(&lead);
        let of_warning = |placed: &PlacedWarning| {
            let name = names_of(&placed.warning);
            let probability = forecast.map_or(FILL_VALUE, |forecast| placed.probability(forecast));
            let field =
                forecast.map_or_else(|| vec![FILL_VALUE; info.layout.grid.cells()], |forecast| placed.field(forecast));
            [(name.probability, vec![probability]), (name.field, field)]
        };
        info.warnings.iter().flat_map(of_warning).collect()
    }

    /// The fields at a lead time.
    fn fields(&self, info: &RunInfo, lead: usize, has_spread: bool) -> Vec<(String, Vec<f64>)> {
        let cells = info.layout.grid.cells();
        let forecast = self.forecasts.get(&lead);
        let part = |values: Option<&[f64]>, number: usize| {
            values.map_or_else(|| vec![FILL_VALUE; cells], |values| values[number * cells..][..cells].to_vec())
        };
        let mut fields = Vec::new();
        for (number, variable) in info.layout.variables.iter().enumerate() {
            let state = forecast.map(|estimate| estimate.state.values());
            fields.push((format!("{}_forecast", variable.name), part(state, number)));
            if has_spread {
                let spread = forecast.and_then(|estimate| estimate.state_spread.as_deref());
                fields.push((format!("{}_forecast_spread", variable.name), part(spread, number)));
            }
        }
        fields
    }
}

/// The names of a warning's variables.
struct WarningNames {
    probability: String,
    field: String,
    brier: String,
    occurred: String,
}

fn names_of(warning: &ThresholdWarning) -> WarningNames {
    let name = cf::safe_name(&warning.name, "_");
    WarningNames {
        probability: format!("warning_{name}"),
        field: format!("warning_{name}_field"),
        brier: format!("warning_{name}_brier_score"),
        occurred: format!("warning_{name}_frequency"),
    }
}

/// The scores of the warnings at a lead time.
fn brier_values(info: &RunInfo, of_method: Option<&MethodScores>, hours: f64) -> Vec<(String, Vec<f64>)> {
    let of_warning = |placed: &PlacedWarning| {
        let own = of_method.and_then(|it| it.warnings.iter().find(|it| it.name == placed.warning.name));
        let lead = own.and_then(|own| own.leads.iter().find(|lead| (lead.lead_hours - hours).abs() < 1e-9));
        let scores = lead.map(|lead| &lead.scores).filter(|scores| scores.cases > 0);
        let brier = scores.and_then(|it| it.brier).map(|it| it.score.value);
        let frequency = scores.map(|it| it.occurred as f64 / it.cases as f64);
        let name = names_of(&placed.warning);
        [(name.brier, brier), (name.occurred, frequency)].map(|(name, it)| (name, vec![it.unwrap_or(FILL_VALUE)]))
    };
    info.warnings.iter().flat_map(of_warning).collect()
}

/// The scores that a method has, with their variables.
fn present<'a>(
    info: &'a RunInfo,
    scores: Option<&'a ForecastScores>,
) -> impl Iterator<Item = (&'static str, &'a StateVariable)> {
    let all = FORECAST_SCORES.into_iter().flat_map(|name| info.layout.variables.iter().map(move |it| (name, it)));
    all.filter(move |(name, variable)| {
        scores.is_some_and(|scores| scores.leads.iter().any(|lead| lead.score(name, variable.name).is_some()))
    })
}

/// The names of a score and of the ends of its interval.
fn names(score: &str, variable: &StateVariable) -> Vec<String> {
    let name = format!("{score}_{}", variable.name);
    let ends = ["low", "high"].map(|end| format!("{name}_{end}"));
    std::iter::once(name).chain(ends.into_iter().filter(|_| score != SPREAD_PER_ERROR)).collect()
}

fn add_scores(definition: &mut Definition, info: &RunInfo, scores: Option<&ForecastScores>) {
    let cases = Variable::new("cases", &[]).with("long_name", "number of forecasts in the scores").with("units", "1");
    definition.record(cases.with("_FillValue", FILL_VALUE));
    for (score, variable) in present(info, scores) {
        let unit = if [RMSE, SPREAD, "departure"].contains(&score) { variable.unit } else { "1" };
        let meanings = ["", ", lower end of the 95 % interval", ", upper end of the 95 % interval"];
        for (name, meaning) in names(score, variable).iter().zip(meanings) {
            let long_name = format!("{} of {}{meaning}", score.replace('_', " "), variable.long_name);
            let added = Variable::new(name.as_str(), &[]).with("long_name", long_name).with("units", unit);
            definition.record(added.with("_FillValue", FILL_VALUE));
        }
    }
}

fn score_values(info: &RunInfo, scores: Option<&ForecastScores>, hours: f64) -> Vec<(String, Vec<f64>)> {
    let lead = scores.and_then(|scores| scores.at(hours));
    let mut values = vec![("cases".to_string(), vec![lead.map_or(0.0, |lead| lead.cases as f64)])];
    for (score, variable) in present(info, scores) {
        let known: Option<&Known> = lead.and_then(|lead| lead.score(score, variable.name));
        let interval = known.and_then(|known| known.interval);
        let numbers = [known.map(|it| it.value), interval.map(|it| it.low), interval.map(|it| it.high)];
        let named = names(score, variable).into_iter().zip(numbers);
        values.extend(named.map(|(name, number)| (name, vec![number.unwrap_or(FILL_VALUE)])));
    }
    values
}
