//! The observing system of an experiment: all of its instruments, and their true biases as time goes by.

use crate::air_mass::AirMassOperator;
use crate::bias::BiasProcess;
use crate::biases::Biases;
use crate::calibration::{Calibration, Parameter};
use crate::error::ObservationError;
use crate::faults::Faults;
use crate::instrument::radiosonde::Radiosondes;
use crate::instrument::recorded::{Recorded, RecordedUse};
use crate::instrument::satellite::Satellite;
use crate::instrument::{Instrument, InstrumentConfig, Observation, Reading};
use crate::jacobian::Jacobian;
use crate::network::{LeftOutStation, Station};
use crate::operator::{LinearOperator, ObservationOperator};
use crate::projection::Projection;
use crate::quality::{self, Arrival, QualityControl, RejectedObservation, Rejection};
use crate::window::ObservationWindow;
use isobar_model::random::stream;
use isobar_model::{Duration, Layout, State, Time};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The memory of an observing system from cycle to cycle, for a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedSystem {
    cycle: usize,
    biases: Vec<(f64, u128)>,
    streams: Vec<u128>,
}

impl SavedSystem {
    /// The cycle of which it is.
    pub fn cycle(&self) -> usize {
        self.cycle
    }
}

/// All instruments of an experiment, which observe the truth cycle after cycle:
///
/// ```text
/// y = X x + G c + ε,   ε ~ N(0, R),   R diagonal
/// ```
///
/// X interpolates the state x to the stations or averages it over footprints; G says which parameters c (biases)
/// each observation has, and has beside them the predictors p(x) of an [air-mass bias](crate::AirMassBias). Every
/// instrument, and every parameter, has its own random stream (`observations/europe`, `missing/europe`,
/// `stations/europe`, `bias/europe/h/Germany`), so that adding one changes none of the others.
///
/// ```
/// use isobar_model::{Boundary, Duration, Grid, Layout, Location, State, Time, Variable};
/// use isobar_obs::{InstrumentConfig, ObservingSystem, RadiosondeConfig, StationSource};
/// use std::sync::Arc;
///
/// let grid = Grid { nx: 8, ny: 6, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Channel };
/// let h = Variable { name: "h", long_name: "height", standard_name: None, unit: "m", location: Location::Center };
/// let layout = Arc::new(Layout { grid, variables: vec![h] });
/// let stations = StationSource::Regular { columns: 4, rows: 3, groups: vec![] };
/// let mut network = RadiosondeConfig::new("europe", stations);
/// network.variables.retain(|observed| observed.name == "h");
/// let (start, window) = (Time::from_seconds(0), Duration::from_seconds(6 * 3600));
/// let configs = [InstrumentConfig::Radiosonde(network)];
/// let mut system = ObservingSystem::new(&layout, None, &configs, 1, window, start)?;
/// let observed = system.observe(&State::zeros(&layout));
/// assert_eq!((observed.cycle, observed.len()), (1, 12));
/// # Ok::<(), isobar_obs::ObservationError>(())
/// ```
pub struct ObservingSystem {
    layout: Arc<Layout>,
    window: Duration,
    start: Time,
    cycle: usize,
    instruments: Vec<Box<dyn Instrument>>,
    /// The faults of each instrument, and their random stream.
    faults: Vec<(Faults, ChaCha8Rng)>,
    biases: Biases,
    stations: Vec<Station>,
    left_out: Vec<LeftOutStation>,
    /// Networks of recorded observations, with their numbers in `instruments`.
    recorded: Vec<(Arc<str>, usize)>,
    /// Of the present cycle.
    values_bias_removed: Vec<f64>,
}

impl ObservingSystem {
    /// The instruments of `configs` over the domain of `layout`, before the first cycle. Cycle n is valid `n × window`
    /// after `start`. Station files with latitudes and longitudes need a `projection`.
    ///
    /// # Errors
    /// Whatever in the configuration cannot be: see [`ObservationError`].
    pub fn new(
        layout: &Arc<Layout>,
        projection: Option<&Projection>,
        configs: &[InstrumentConfig],
        seed: u64,
        window: Duration,
        start: Time,
    ) -> Result<Self, ObservationError> {
        if window.seconds() < 1 {
            return Err(ObservationError::InvalidWindow { seconds: window.seconds() });
        }
        let mut system = Self {
            layout: Arc::clone(layout),
            window,
            start,
            cycle: 0,
            instruments: Vec::with_capacity(configs.len()),
            faults: Vec::with_capacity(configs.len()),
            biases: Biases::new(seed, start),
            stations: Vec::new(),
            left_out: Vec::new(),
            recorded: Vec::new(),
            values_bias_removed: Vec::new(),
        };
        for (index, config) in configs.iter().enumerate() {
            let name = config.name();
            if name.trim().is_empty() || name.contains('/') {
                return Err(ObservationError::InvalidInstrumentName { value: name.to_owned() });
            }
            if configs[..index].iter().any(|other| other.name() == name) {
                let (instrument, value) = (name.to_owned(), name.to_owned());
                return Err(ObservationError::DuplicateName { instrument, setting: "name", value });
            }
            let instrument: Box<dyn Instrument> = match config {
                InstrumentConfig::Radiosonde(config) => {
                    let (radiosondes, network) =
                        Radiosondes::new(config, layout, projection, seed, &mut system.biases)?;
                    system.stations.extend(network.stations);
                    system.left_out.extend(network.left_out);
                    Box::new(radiosondes)
                }
                InstrumentConfig::Satellite(config) => {
                    Box::new(Satellite::new(config, layout, seed, &mut system.biases)?)
                }
                InstrumentConfig::Recorded(config) => {
                    let recorded = Recorded::new(config, layout, projection, window, start)?;
                    system.recorded.push((name.into(), index));
                    Box::new(recorded)
                }
            };
            config.faults().validate(name)?;
            system.faults.push((config.faults(), stream(seed, &format!("faults/{name}"))));
            system.instruments.push(instrument);
        }
        Ok(system)
    }

    /// The parameters that methods must estimate, in the order of every `c`.
    pub fn calibration(&self) -> &Calibration {
        self.biases.calibration()
    }

    /// The true values of [`Self::calibration`] in the present cycle, in their units.
    pub fn true_calibration(&self) -> &[f64] {
        self.biases.values()
    }

    /// The values of the present cycle's observations without any bias, as instruments with a known calibration would
    /// report them.
    pub fn values_bias_removed(&self) -> &[f64] {
        &self.values_bias_removed
    }

    /// How the true values of [`Self::calibration`] come to be.
    pub fn bias_processes(&self) -> impl Iterator<Item = &BiasProcess> {
        self.biases.processes()
    }

    /// The parameters that are known, and so not part of the calibration, with their true values in the present cycle.
    pub fn known_biases(&self) -> impl Iterator<Item = (&Parameter, f64)> {
        self.biases.known()
    }

    /// The stations in the domain, network after network.
    pub fn stations(&self) -> &[Station] {
        &self.stations
    }

    /// The stations that lie outside of the domain, or too near to its edges.
    pub fn left_out(&self) -> &[LeftOutStation] {
        &self.left_out
    }

    /// What becomes of the observations of each file in so many cycles, with the name of the network.
    pub fn recorded_use<'a>(&'a self, cycles: usize) -> impl Iterator<Item = (&'a str, RecordedUse)> {
        let of_file = move |(name, number): &'a (Arc<str>, usize)| {
            Some((&**name, self.instruments[*number].recorded_use(cycles)?))
        };
        self.recorded.iter().filter_map(of_file)
    }

    /// The present cycle: that of the last observations, 0 before the first.
    pub fn cycle(&self) -> usize {
        self.cycle
    }

    /// The valid time of the present cycle; the start before the first.
    pub fn time(&self) -> Time {
        self.start + Duration::from_seconds(self.window.seconds() * self.cycle as i64)
    }

    /// All that the next cycles depend on and that the configuration does not say.
    pub fn save(&mut self) -> SavedSystem {
        let (cycle, biases) = (self.cycle, self.biases.save());
        SavedSystem { cycle, biases, streams: self.streams().iter().map(|stream| stream.get_word_pos()).collect() }
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        let of_faults = self.faults.iter_mut().map(|faults| &mut faults.1);
        self.instruments.iter_mut().flat_map(|it| it.streams()).chain(of_faults).collect()
    }

    /// Takes back what [`Self::save`] gave, of a system of the same configuration and seed.
    ///
    /// # Errors
    /// [`ObservationError::UnfitSavedSystem`] if it is of another system, which then must not be used any more.
    pub fn restore(&mut self, saved: &SavedSystem) -> Result<(), ObservationError> {
        self.cycle = saved.cycle;
        let time = self.time();
        let fits = self.biases.restore(time, &saved.biases);
        let mut streams = self.streams();
        if streams.len() != saved.streams.len() || !fits {
            return Err(ObservationError::UnfitSavedSystem);
        }
        streams.iter_mut().zip(&saved.streams).for_each(|(stream, &place)| stream.set_word_pos(place));
        Ok(())
    }

    /// As [`Self::observe_checked`], where the values are not checked against any other.
    ///
    /// # Panics
    /// As there.
    pub fn observe(&mut self, truth: &State) -> ObservationWindow {
        self.observe_checked(truth, None)
    }

    /// Goes on to the next cycle, lets the true biases evolve, and observes `truth`, the true state at its valid time
    /// [`Self::time`]. The values have the biases of [`Self::calibration`], but not the known ones. Quality control
    /// compares the values with the reference, if there is one.
    ///
    /// # Panics
    /// If `truth` has another layout than the observing system.
    pub fn observe_checked(
        &mut self,
        truth: &State,
        reference: Option<(&QualityControl, &State)>,
    ) -> ObservationWindow {
        assert_eq!(**truth.layout(), *self.layout, "the truth must have the observing system's layout");
        self.cycle += 1;
        self.biases.advance(self.window);
        let time = self.time();
        let mut arrivals: Vec<Arrival> = Vec::new();
        for (instrument, (faults, random)) in self.instruments.iter_mut().zip(&mut self.faults) {
            let mut observations: Vec<Observation> = Vec::new();
            instrument.observe(self.cycle, time, &mut observations);
            let arrive = |observation: Observation| {
                let value_bias_removed = match observation.reading {
                    Reading::Error(error) => dot(&observation.state_row, truth.values()) + error,
                    Reading::Recorded { value, .. } => value,
                };
                let value = value_bias_removed + observation.bias(truth, self.biases.values());
                Arrival { observation, value, value_bias_removed }
            };
            let own = observations.into_iter().map(arrive).collect();
            arrivals.extend(faults.spoil(own, self.window, &self.layout.grid, random));
        }
        let mut rejections = quality::check_reports(&arrivals, time, &self.layout.grid);
        if let Some((control, reference)) = reference {
            control.check_values(&arrivals, reference, self.biases.calibration(), &mut rejections);
        }
        self.window(time, arrivals, &rejections)
    }

    fn window(&mut self, time: Time, arrivals: Vec<Arrival>, rejections: &[Option<Rejection>]) -> ObservationWindow {
        let (mut reports, mut values, mut sigma) = (Vec::new(), Vec::new(), Vec::new());
        let (mut rejected, mut predictors) = (Vec::new(), Vec::new());
        let mut jacobian = Jacobian::default();
        self.values_bias_removed.clear();
        for (arrival, rejection) in arrivals.into_iter().zip(rejections) {
            let Arrival { observation, value, value_bias_removed, .. } = arrival;
            let Observation { report, sigma: own, state_row, calibration_row, predictors: of_state, .. } = observation;
            if let Some(rejection) = *rejection {
                rejected.push(RejectedObservation { report, value, sigma: own, rejection });
                continue;
            }
            jacobian.state.push_row(state_row);
            jacobian.calibration.push_row(calibration_row);
            predictors.push(of_state);
            values.push(value);
            self.values_bias_removed.push(value_bias_removed);
            sigma.push(own);
            reports.push(report);
        }
        let linear = LinearOperator { jacobian };
        let operator: Arc<dyn ObservationOperator> = if predictors.iter().all(Vec::is_empty) {
            Arc::new(linear)
        } else {
            Arc::new(AirMassOperator::new(linear, predictors))
        };
        ObservationWindow { time, cycle: self.cycle, reports, values, sigma, rejected, operator }
    }
}

/// A sparse row times a vector.
fn dot(row: &[(usize, f64)], x: &[f64]) -> f64 {
    row.iter().map(|&(column, value)| value * x[column]).sum()
}
