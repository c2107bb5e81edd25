//! Recorded observations: what somebody else made, as a file says it.

use crate::error::{ObservationError, list, require};
use crate::instrument::{Instrument, Observation, Reading};
use crate::observation_file::{ObservationFile, ObservationPlace, ObservationRecord, ValidTime};
use crate::projection::Projection;
use crate::table::Faults;
use crate::window::Report;
use isobar_model::{Duration, Layout, Time};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Observations of a file, each in the cycle at whose end it is valid. What is valid within a window but not at its end
/// arrives with that window, as a late report. Nothing is known of biases.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedConfig {
    /// Name of the network, unique in the observing system, without `/`.
    pub name: String,
    /// The parsed file.
    pub observations: ObservationFile,
    /// The variable of those of which the file does not say it.
    pub variable: Option<String>,
    /// Standard deviation of the random error of those of which the file does not say it.
    pub sigma: Option<f64>,
}

/// A file of observations as it is told, cycle after cycle.
pub(crate) struct Recorded {
    /// With their cycles, in the order of these; 0 before the first.
    observations: Vec<(usize, Observation)>,
}

impl Recorded {
    /// The observations of `config`; cycle n ends `n × window` after `start`.
    pub fn new(
        config: &RecordedConfig,
        layout: &Layout,
        projection: Option<&Projection>,
        window: Duration,
        start: Time,
    ) -> Result<Self, ObservationError> {
        let (name, file) = (&config.name, &config.observations);
        if let Some(sigma) = config.sigma {
            require(sigma > 0.0, name, "sigma", sigma, "above 0")?;
        }
        let network: Arc<str> = name.as_str().into();
        let (mut observations, mut faults) = (Vec::new(), Faults::default());
        for record in file.records() {
            let (cycle, time) = match record.valid {
                ValidTime::Cycle(cycle) => (cycle, start + Duration::from_seconds(window.seconds() * cycle as i64)),
                ValidTime::Time(time) => {
                    let seconds = (time - start).seconds();
                    // The window that ends then, or next.
                    let windows = (seconds.max(0) + window.seconds() - 1) / window.seconds();
                    (windows as usize, time)
                }
            };
            let Some((variable, sigma)) = kind(config, record, layout, &mut faults)? else { continue };
            let place = place(config, record, variable, layout, projection, &mut faults)?;
            let Some((x_m, y_m, state_row)) = place else { continue };
            let platform = record.id.clone().unwrap_or_else(|| words(record.place));
            let report = Report { network: network.clone(), platform: platform.into(), variable, x_m, y_m, scan: None };
            let reading = Reading::Value(record.value, time);
            let (calibration_row, predictors) = (Vec::new(), Vec::new());
            observations.push((cycle, Observation { report, sigma, reading, state_row, calibration_row, predictors }));
        }
        faults.check(file.file())?;
        if observations.iter().all(|observation| observation.0 == 0) {
            return Err(ObservationError::NoneAfterStart {
                instrument: name.clone(),
                file: file.file().to_owned(),
                observations: observations.len(),
            });
        }
        observations.sort_by_key(|observation| observation.0);
        Ok(Self { observations })
    }

    /// The cycle of each observation, in order; 0 before the first.
    pub fn cycles(&self) -> Vec<usize> {
        self.observations.iter().map(|observation| observation.0).collect()
    }
}

impl Instrument for Recorded {
    fn observe(&mut self, cycle: usize, observations: &mut Vec<Observation>) {
        let first = self.observations.partition_point(|observation| observation.0 < cycle);
        let own = self.observations[first..].iter().take_while(|observation| observation.0 == cycle);
        observations.extend(own.map(|observation| observation.1.clone()));
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        Vec::new()
    }
}

/// The number of the observed variable, and the standard deviation of the random error; `None`, and a fault, if the file
/// names a variable that is not there.
fn kind(
    config: &RecordedConfig,
    record: &ObservationRecord,
    layout: &Layout,
    faults: &mut Faults,
) -> Result<Option<(usize, f64)>, ObservationError> {
    let (name, file) = (&config.name, &config.observations);
    let valid = || list(layout.variables.iter().map(|variable| variable.name));
    let missing = |setting| {
        let (instrument, file) = (name.clone(), file.file().to_owned());
        ObservationError::NotSaid { instrument, file, setting }
    };
    let variable = record.variable.as_ref().or(config.variable.as_ref()).ok_or_else(|| missing("variable"))?;
    let sigma = record.sigma.or(config.sigma).ok_or_else(|| missing("sigma"))?;
    match layout.variable(variable) {
        Some(number) => Ok(Some((number, sigma))),
        None if record.variable.is_some() => {
            let shown: String = variable.chars().take(60).collect();
            faults.add(record.line, format!("`variable` is `{shown}`, but must be one of {}", valid()));
            Ok(None)
        }
        None => Err(ObservationError::UnknownName {
            instrument: name.clone(),
            setting: "variable",
            value: variable.clone(),
            valid: valid(),
        }),
    }
}

/// A row of X: values of the state with their weights.
type StateRow = Vec<(usize, f64)>;

/// Where an observation is on the plane, and its row of X; the row is empty outside of the domain. `None`, and a fault, if
/// it is not a point of the grid.
fn place(
    config: &RecordedConfig,
    record: &ObservationRecord,
    variable: usize,
    layout: &Layout,
    projection: Option<&Projection>,
    faults: &mut Faults,
) -> Result<Option<(f64, f64, StateRow)>, ObservationError> {
    let (grid, location, offset) = (&layout.grid, layout.variables[variable].location, variable * layout.grid.cells());
    let at = |x_m: f64, y_m: f64| {
        let entries = grid.stencil(location, x_m, y_m).map_or_else(Vec::new, |stencil| stencil.entries);
        (x_m, y_m, entries.into_iter().map(|(index, weight)| (offset + index, weight)).collect())
    };
    match (record.place, projection) {
        (ObservationPlace::Plane { x_m, y_m }, _) => Ok(Some(at(x_m, y_m))),
        (ObservationPlace::Geographic { .. }, None) => {
            let file = config.observations.file().to_owned();
            Err(ObservationError::NoProjection { instrument: config.name.clone(), file })
        }
        (ObservationPlace::Geographic { latitude_deg, longitude_deg }, Some(projection)) => {
            // The antipode of the centre has no place on the plane.
            let (x_m, y_m) = projection.forward(latitude_deg, longitude_deg).unwrap_or((f64::MAX, f64::MAX));
            Ok(Some(at(x_m, y_m)))
        }
        (ObservationPlace::GridPoint { column, row }, _) => {
            for (name, number, most) in [("column", column, grid.nx), ("row", row, grid.ny)] {
                if number > most {
                    let expected = format!("a whole number from 1 to {most}");
                    faults.add(record.line, format!("`{name}` is `{number}`, but must be {expected}"));
                    return Ok(None);
                }
            }
            let (i, j) = (column - 1, row - 1);
            Ok(Some((grid.x_m(location, i), grid.y_m(location, j), vec![(offset + j * grid.nx + i, 1.0)])))
        }
    }
}

/// A place in words, by which an observation without a name is known.
fn words(place: ObservationPlace) -> String {
    match place {
        ObservationPlace::Plane { x_m, y_m } => format!("x {x_m} m, y {y_m} m"),
        ObservationPlace::Geographic { latitude_deg, longitude_deg } => format!("{latitude_deg} N, {longitude_deg} E"),
        ObservationPlace::GridPoint { column, row } => format!("column {column}, row {row}"),
    }
}
