//! Recorded observations: made elsewhere, and read from a file.

use super::{Instrument, InstrumentSettings, UnusedObservations};
use crate::error::{ObservationError, list, require};
use crate::observation::{Observation, Reading};
use crate::observation_file::{ObservationFile, ObservationPlace, ObservationRecord, ValidTime};
use crate::report::Report;
use crate::site::Site;
use crate::station::no_projection;
use isobar_model::Duration;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Observations of a file, each in the cycle at whose end it is valid. What is valid within a window but not at its end
/// arrives with that window, as a late report. Nothing is known of biases.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSettings {
    /// The parsed file.
    pub observations: ObservationFile,
    /// The observed variable, for a file without a column `variable`.
    pub variable: Option<String>,
    /// Standard deviation of the random error in the variable's unit, for a file without a column `sigma`; above 0.
    pub sigma: Option<f64>,
}

impl InstrumentSettings for RecordedSettings {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        if let Some(sigma) = self.sigma {
            require(sigma > 0.0, site.network, "sigma", sigma, "above 0")?;
        }
        let network: Arc<str> = site.network.into();
        let all = self.observations.records().iter().map(|record| self.observation(record, site, &network));
        let mut observations = all.collect::<Result<Vec<_>, ObservationError>>()?;
        if observations.iter().all(|(cycle, _)| *cycle == 0) {
            let (count, file) = (observations.len(), self.observations.file());
            let problem = format!("none of the {count} observations of {file} is valid after the start of the run");
            return Err(ObservationError::in_setting(site.network, "file", problem));
        }
        observations.sort_by_key(|(cycle, _)| *cycle);
        Ok(Box::new(Recorded { observations }))
    }
}

impl RecordedSettings {
    /// An observation, and the cycle in which it arrives; 0 before the first.
    fn observation(
        &self,
        record: &ObservationRecord,
        site: &Site<'_>,
        network: &Arc<str>,
    ) -> Result<(usize, Observation), ObservationError> {
        let window_s = site.window.seconds();
        let (cycle, time) = match record.valid {
            ValidTime::Cycle(cycle) => (cycle, site.start + Duration::from_seconds(window_s * cycle as i64)),
            ValidTime::Time(time) => {
                // The window that ends then, or next.
                let windows = ((time - site.start).seconds().max(0) + window_s - 1) / window_s;
                (windows as usize, time)
            }
        };
        let (variable, sigma) = self.variable_and_sigma(record, site)?;
        let (x_m, y_m, state_row) = self.place(record, variable, site)?;
        let platform = record.id.clone().unwrap_or_else(|| describe(record.place));
        let report = Report { network: Arc::clone(network), platform: platform.into(), variable, x_m, y_m, scan: None };
        let reading = Reading::Value(record.value, time);
        let (calibration_row, predictors) = (Vec::new(), Vec::new());
        Ok((cycle, Observation { report, sigma, reading, state_row, calibration_row, predictors }))
    }

    /// The number of the observed variable, and the standard deviation of the random error.
    fn variable_and_sigma(
        &self,
        record: &ObservationRecord,
        site: &Site<'_>,
    ) -> Result<(usize, f64), ObservationError> {
        let (layout, file) = (site.layout, self.observations.file());
        let missing = |setting| {
            let problem = format!("{file} has no column `{setting}`; add it, or give `{setting}` for the network");
            ObservationError::in_setting(site.network, "file", problem)
        };
        let name = record.variable.as_ref().or(self.variable.as_ref()).ok_or_else(|| missing("variable"))?;
        let variable = layout.variable(name).ok_or_else(|| {
            let valid = layout.variables.iter().map(|variable| variable.name);
            if record.variable.is_some() {
                let expected = format!("one of {}", list(valid));
                ObservationError::invalid_field(file, record.line, "variable", name, &expected)
                    .of_network(site.network, "file")
            } else {
                ObservationError::unknown_name(site.network, "variable", name, valid)
            }
        })?;
        Ok((variable, record.sigma.or(self.sigma).ok_or_else(|| missing("sigma"))?))
    }

    /// Where an observation is on the plane, and its row of X; the row is empty outside of the domain.
    fn place(
        &self,
        record: &ObservationRecord,
        variable: usize,
        site: &Site<'_>,
    ) -> Result<(f64, f64, StateRow), ObservationError> {
        let grid = &site.layout.grid;
        let (location, offset) = (site.layout.variables[variable].location, variable * grid.cells());
        let at = |x_m: f64, y_m: f64| {
            let entries = grid.stencil(location, x_m, y_m).map_or_else(Vec::new, |stencil| stencil.entries);
            (x_m, y_m, entries.into_iter().map(|(index, weight)| (offset + index, weight)).collect())
        };
        let file = self.observations.file();
        match (record.place, site.projection) {
            (ObservationPlace::Plane { x_m, y_m }, _) => Ok(at(x_m, y_m)),
            (ObservationPlace::Geographic { .. }, None) => Err(no_projection(site.network, "file", file)),
            (ObservationPlace::Geographic { latitude_deg, longitude_deg }, Some(projection)) => {
                // The antipode of the centre has no place on the plane.
                let (x_m, y_m) = projection.forward(latitude_deg, longitude_deg).unwrap_or((f64::MAX, f64::MAX));
                Ok(at(x_m, y_m))
            }
            (ObservationPlace::GridPoint { column, row }, _) => {
                for (name, number, most) in [("column", column, grid.nx), ("row", row, grid.ny)] {
                    if number > most {
                        let expected = format!("a whole number from 1 to {most}");
                        let (line, value) = (record.line, number.to_string());
                        let error = ObservationError::invalid_field(file, line, name, &value, &expected);
                        return Err(error.of_network(site.network, "file"));
                    }
                }
                let (i, j) = (column - 1, row - 1);
                Ok((grid.x_m(location, i), grid.y_m(location, j), vec![(offset + j * grid.nx + i, 1.0)]))
            }
        }
    }
}

/// A row of X: values of the state with their weights.
type StateRow = Vec<(usize, f64)>;

/// A place in words, the platform of an observation without a name.
fn describe(place: ObservationPlace) -> String {
    match place {
        ObservationPlace::Plane { x_m, y_m } => format!("x {x_m} m, y {y_m} m"),
        ObservationPlace::Geographic { latitude_deg, longitude_deg } => format!("{latitude_deg} N, {longitude_deg} E"),
        ObservationPlace::GridPoint { column, row } => format!("column {column}, row {row}"),
    }
}

/// A file of observations, cycle after cycle.
struct Recorded {
    /// With their cycles, in the order of these; 0 before the first.
    observations: Vec<(usize, Observation)>,
}

impl Instrument for Recorded {
    fn observe(&mut self, cycle: usize, _pass: usize) -> Vec<Observation> {
        let first = self.observations.partition_point(|(other, _)| *other < cycle);
        let valid = self.observations[first..].iter().take_while(|(other, _)| *other == cycle);
        valid.map(|(_, observation)| observation.clone()).collect()
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        Vec::new()
    }

    fn unused(&self, cycles: usize) -> Option<UnusedObservations> {
        let unused = self.observations.iter().filter(|(cycle, _)| !(1..=cycles).contains(cycle)).count();
        Some(UnusedObservations { unused, all: self.observations.len() })
    }
}
