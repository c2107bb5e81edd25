//! Recorded observations: made elsewhere, and read from a file.

use super::recorded_bias::{self, RecordedBias, References};
use super::recorded_held::{Held, Seen};
use super::recorded_names::{Nameless, Reports, words};
use super::recorded_winds::Winds;
use super::{Instrument, InstrumentSettings, platforms_of};
use crate::error::{ObservationError, list, require};
use crate::observation::Observation;
use crate::observation_file::{ObservationFile, ObservationPlace, ObservationRecord, ValidTime};
use crate::recorded_use::{BiasUse, RecordedUse};
use crate::site::Site;
use crate::station::no_projection;
use crate::table::Faults;
use crate::withheld::Platform;
use isobar_model::{Duration, Layout, Time};
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Observations of a file, each in the cycle at whose end it is valid. What is valid within a window but not at its end
/// arrives with that window, as a late report, unless it is near enough to the end of one. Of their biases no more is known
/// than what methods estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSettings {
    /// The parsed file.
    pub observations: ObservationFile,
    /// The observed variable, for a file without a column `variable`.
    pub variable: Option<String>,
    /// Standard deviation of the random error in the variable's unit, for a file without a column `sigma`; above 0.
    pub sigma: Option<f64>,
    /// Which observations are used, and at which time.
    pub times: RecordedTimes,
    /// Along which axes the components u and v of winds are; `None`: [`WindAxes::Earth`] where the file gives latitudes and
    /// longitudes, else [`WindAxes::Grid`].
    pub winds: Option<WindAxes>,
    /// Groups that have no bias.
    pub reference_groups: Vec<String>,
    /// Stations that have no bias.
    pub reference_stations: Vec<String>,
    /// The biases.
    pub biases: Vec<RecordedBias>,
}

/// Which recorded observations are used, and at which time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordedTimes {
    /// Those that are valid at most this long before or after the end of a window, as if they were valid then; from 0 to half of
    /// the window.
    End(Duration),
    /// All that are valid within a window, after its start and not after its end, at their own times.
    Window,
}

/// Along which axes the components of a wind are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindAxes {
    /// u to the east, v to the north.
    Earth,
    /// u along the plane's x axis, v along its y axis.
    Grid,
}

impl InstrumentSettings for RecordedSettings {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        let file = self.observations.file();
        if let Some(sigma) = self.sigma {
            require(sigma > 0.0, site.network, "sigma", sigma, "above 0")?;
        }
        if let RecordedTimes::End(tolerance) = self.times {
            let (tolerance, half) = (tolerance.as_f64(), 0.5 * site.window.as_f64());
            let expected = format!("from 0 to {half} s, half of the window");
            require((0.0..=half).contains(&tolerance), site.network, "time_tolerance", tolerance, expected)?;
        }
        let mut winds = Winds::new(self.winds.unwrap_or(WindAxes::Earth) == WindAxes::Earth, site.layout);
        let mut faults = Faults::of(self.observations.numbered());
        let most = self.observations.records().len();
        let (mut records, mut observations) = (Vec::with_capacity(most), Vec::with_capacity(most));
        let (mut nameless, mut reports) = (Nameless::default(), Reports::default());
        for record in self.observations.records() {
            let Some((variable, sigma)) = self.variable_and_sigma(record, site, &mut faults)? else { continue };
            let Some((x_m, y_m, seen)) = self.place(record, variable, site, &mut faults)? else { continue };
            let Valid { cycle, time, is_late, lag } = when(record.valid, self.times, site.window, site.start);
            let platform = match &record.id {
                Some(id) => Arc::clone(id),
                None => {
                    let place = words(record.place, (x_m, y_m));
                    nameless.platform(cycle, variable, place, [record.value, sigma])
                }
            };
            winds.add(record, variable, sigma, observations.len());
            records.push(record);
            let (when, of_value) = ((cycle, time, lag), (record.value, sigma));
            let mut held = Held::new(when, platform, variable, (x_m, y_m), of_value, seen, site.layout);
            held.report_number = reports.number(record.report.as_deref()) as u32;
            held.is_late = is_late;
            observations.push(held);
        }
        faults.check(file).map_err(|error| ObservationError::from(error).of_network(site.network, "file"))?;
        let references =
            References { file: &self.observations, stations: &self.reference_stations, groups: &self.reference_groups };
        let biases = recorded_bias::add(&self.biases, &references, site, &records, &mut observations)?;
        if let Some(projection) = site.projection {
            winds.turn(&mut observations, site.layout, projection);
        }
        if !observations.is_empty() && observations.iter().all(|it| it.cycle == 0) {
            let count = observations.len();
            let problem = format!("none of the {count} observations of {file} is valid after the start of the run");
            return Err(ObservationError::in_setting(site.network, "file", problem));
        }
        drop(records);
        if !observations.is_sorted_by_key(|it| it.cycle) {
            observations.sort_by_key(|it| it.cycle);
        }
        let (network, layout) = (site.network.into(), site.layout.clone());
        Ok(Box::new(Recorded { network, layout, observations, missing: self.observations.missing(), biases }))
    }

    fn is_recorded(&self) -> bool {
        true
    }

    fn is_within_window(&self) -> bool {
        self.times == RecordedTimes::Window
    }
}

impl RecordedSettings {
    /// The observations of a file that says variable and sigma of each, which are used if they are valid at the end of a
    /// window.
    pub fn new(observations: ObservationFile) -> Self {
        Self {
            observations,
            variable: None,
            sigma: None,
            times: RecordedTimes::End(Duration::from_seconds(0)),
            winds: None,
            reference_groups: Vec::new(),
            reference_stations: Vec::new(),
            biases: Vec::new(),
        }
    }

    /// The number of the observed variable, and the standard deviation of the random error; `None`, and a fault, if the file
    /// names a variable that is not there.
    fn variable_and_sigma(
        &self,
        record: &ObservationRecord,
        site: &Site<'_>,
        faults: &mut Faults,
    ) -> Result<Option<(usize, f64)>, ObservationError> {
        let (layout, file) = (site.layout, self.observations.file());
        let missing = |setting| {
            let problem = format!("{file} has no column `{setting}`; add it, or give `{setting}` for the network");
            ObservationError::in_setting(site.network, "file", problem)
        };
        let name = record.variable.as_deref().or(self.variable.as_deref()).ok_or_else(|| missing("variable"))?;
        let sigma = record.sigma.or(self.sigma).ok_or_else(|| missing("sigma"))?;
        let valid = || layout.variables.iter().map(|variable| variable.name);
        match layout.variable(name) {
            Some(variable) => Ok(Some((variable, sigma))),
            None if record.variable.is_some() => {
                let shown: String = name.chars().take(60).collect();
                faults.add(record.line, format!("`variable` is `{shown}`, but must be one of {}", list(valid())));
                Ok(None)
            }
            None => Err(ObservationError::unknown_name(site.network, "variable", name, valid())),
        }
    }

    /// Where an observation is on the plane, and what it sees of the state. `None`, and a fault, if it is not a point of the
    /// grid.
    fn place(
        &self,
        record: &ObservationRecord,
        variable: usize,
        site: &Site<'_>,
        faults: &mut Faults,
    ) -> Result<Option<(f64, f64, Seen)>, ObservationError> {
        let (layout, file) = (site.layout, self.observations.file());
        let (grid, location) = (&layout.grid, layout.variables[variable].location);
        let is_geographic = matches!(record.place, ObservationPlace::Geographic { .. });
        if self.winds == Some(WindAxes::Earth) && !is_geographic {
            let problem = format!("{file} has no latitudes and longitudes, without which east and north are not known");
            return Err(ObservationError::in_setting(site.network, "winds", problem));
        }
        match (record.place, site.projection) {
            (ObservationPlace::Plane { x_m, y_m }, _) => {
                let (x_m, y_m) = grid.first_image(x_m, y_m);
                Ok(Some((x_m, y_m, Seen::Interpolated)))
            }
            (ObservationPlace::Geographic { .. }, None) => Err(no_projection(site.network, "file", file)),
            (ObservationPlace::Geographic { latitude_deg, longitude_deg }, Some(projection)) => {
                // The antipode of the centre has no place on the plane.
                let (x_m, y_m) = projection.forward(latitude_deg, longitude_deg).unwrap_or((f64::MAX, f64::MAX));
                Ok(Some((x_m, y_m, Seen::Interpolated)))
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
                let index = variable * grid.cells() + j * grid.nx + i;
                Ok(Some((grid.x_m(location, i), grid.y_m(location, j), Seen::Point(index))))
            }
        }
    }
}

/// A file of observations, cycle after cycle.
struct Recorded {
    network: Arc<str>,
    layout: Layout,
    /// In the order of their cycles.
    observations: Vec<Held>,
    missing: usize,
    biases: Vec<BiasUse>,
}

impl Recorded {
    /// The observations of a cycle.
    fn of_cycle(&self, cycle: usize) -> &[Held] {
        let until = |cycle: usize| self.observations.partition_point(|it| it.cycle < cycle);
        &self.observations[until(cycle)..until(cycle + 1)]
    }
}

impl Instrument for Recorded {
    fn observe(&mut self, cycle: usize, _pass: usize) -> Vec<Observation> {
        self.of_cycle(cycle).iter().map(|held| held.observation(&self.network, &self.layout)).collect()
    }

    fn most_observations(&self, cycle: usize) -> usize {
        self.of_cycle(cycle).len()
    }

    fn most_in_report(&self) -> usize {
        let mut counts: HashMap<(usize, u32, u32), usize> = HashMap::new();
        for Held { cycle, variable, report_number, .. } in &self.observations {
            *counts.entry((*cycle, *variable, *report_number)).or_default() += 1;
        }
        counts.into_values().max().unwrap_or(0)
    }

    fn platforms(&self) -> Vec<Platform> {
        let in_time = self.observations.iter().filter(|held| held.is_in_time_and_inside());
        platforms_of(in_time.map(|held| (&held.platform, held.biases.entries().into_iter().map(|entry| entry.0))))
    }

    fn weights(&self) -> usize {
        self.observations.iter().map(Held::weights).sum()
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        Vec::new()
    }

    fn recorded_use(&self, cycles: &RangeInclusive<usize>) -> Option<RecordedUse> {
        let mut usage = RecordedUse {
            rows: self.observations.len() + self.missing,
            missing: self.missing,
            biases: self.biases.clone(),
            ..RecordedUse::default()
        };
        // Of a cycle: what may be there twice. Equal names of platforms are one name.
        let mut good = Vec::new();
        for of_cycle in self.observations.chunk_by(|one, other| one.cycle == other.cycle) {
            good.clear();
            for held in of_cycle {
                let count = if !cycles.contains(&held.cycle) {
                    &mut usage.in_no_cycle
                } else if !held.is_inside() {
                    &mut usage.outside
                } else if held.is_late {
                    &mut usage.late
                } else if held.lacks_predictor {
                    &mut usage.no_predictor
                } else {
                    good.push((held.variable, held.lag, Arc::as_ptr(&held.platform).cast::<u8>()));
                    continue;
                };
                *count += 1;
            }
            let all = good.len();
            good.sort_unstable();
            good.dedup();
            usage.usable += good.len();
            usage.duplicate += all - good.len();
        }
        Some(usage)
    }
}

/// When an observation is valid.
struct Valid {
    /// The cycle with which it arrives; 0: before the first.
    cycle: usize,
    time: Time,
    /// Whether it is late there.
    is_late: bool,
    /// How long before the end of the window it is compared with the state.
    lag: Duration,
}

fn when(valid: ValidTime, times: RecordedTimes, window: Duration, start: Time) -> Valid {
    let length = window.seconds();
    let at_end = |cycle: i64, time: Time, is_late: bool| Valid {
        cycle: cycle as usize,
        time,
        is_late,
        lag: Duration::from_seconds(0),
    };
    match valid {
        ValidTime::Cycle(cycle) => at_end(cycle as i64, start + window * cycle, false),
        ValidTime::Time(time) => {
            let seconds = (time - start).seconds();
            // The window that ends next.
            let next = (seconds.max(0) + length - 1) / length;
            let tolerance = match times {
                RecordedTimes::Window => {
                    let lag = Duration::from_seconds(next * length - seconds.max(0));
                    return Valid { lag, ..at_end(next, time, false) };
                }
                RecordedTimes::End(tolerance) => tolerance.seconds(),
            };
            let nearest = (seconds + length / 2).div_euclid(length);
            if nearest >= 1 && (seconds - nearest * length).abs() <= tolerance {
                return at_end(nearest, time, false);
            }
            at_end(next, time, true)
        }
    }
}
