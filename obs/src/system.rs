//! The observing system of an experiment: all of its networks, and their true biases as time goes by.

use crate::aside::{Aside, Unused, UnusedObservation};
use crate::bias::BiasProcess;
use crate::biases::Biases;
use crate::calibration::{Calibration, Parameter};
use crate::error::ObservationError;
use crate::error_correlation::{self, ErrorCorrelation};
use crate::error_regression::ErrorRegression;
use crate::faults::Faults;
use crate::general_operator::GeneralOperator;
use crate::instrument::Instrument;
use crate::network::{Network, Schedule, spread};
use crate::observation::{Arrival, Observation, Reading};
use crate::projection::Projection;
use crate::quality::{self, QualityControl, Reference};
use crate::recorded_use::RecordedUse;
use crate::site::Site;
use crate::station::{LeftOutStation, Station};
use crate::value_check::ValueCheck;
use crate::window::ObservationWindow;
use crate::window_states::WindowStates;
use crate::withheld::Withheld;
use crate::within_window::WithinWindow;
use isobar_model::{Duration, Grid, Layout, State, Time};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::sync::Arc;

/// The memory of an observing system from cycle to cycle, for a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedSystem {
    cycle: usize,
    biases: Vec<(f64, u128)>,
    streams: Vec<u128>,
}

impl SavedSystem {
    /// The cycle after which it was saved.
    pub fn cycle(&self) -> usize {
        self.cycle
    }
}

/// The most observations that all networks together may report in a cycle.
const MOST_OBSERVATIONS: usize = 1_000_000;

/// The most weights of all their rows of X: 320 MB for each copy.
const MOST_WEIGHTS: usize = 20_000_000;

/// All networks of an experiment, which observe the truth cycle after cycle:
///
/// ```text
/// y = X x + G c + ε,   ε ~ N(0, R)
/// ```
///
/// R is diagonal except within the reports of networks with an [`ErrorCorrelation`].
///
/// X interpolates the state x to the stations or averages it over footprints; G says which parameters c (biases)
/// each observation has; beside them there are the predictors p(x) of [air-mass biases](crate::AirMassBias). Every
/// network, and every parameter, has its own random stream (`observations/europe`, `missing/europe`,
/// `stations/europe`, `bias/europe/h/Germany`), so that adding one changes none of the others.
///
/// ```
/// use isobar_model::{Boundary, Duration, Grid, Layout, Location, State, Time, Variable};
/// use isobar_obs::{Network, ObservingSystem, RadiosondeSettings, StationSource};
/// use std::sync::Arc;
///
/// let grid = Grid { nx: 8, ny: 6, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Channel };
/// let h = Variable { name: "h", long_name: "height", standard_name: None, unit: "m", location: Location::Center };
/// let layout = Arc::new(Layout { grid, variables: vec![h] });
/// let stations = StationSource::Regular { columns: 4, rows: 3, groups: vec![] };
/// let mut sondes = RadiosondeSettings::new(stations);
/// sondes.variables.retain(|observed| observed.name == "h");
/// let (start, window) = (Time::from_seconds(0), Duration::from_seconds(6 * 3600));
/// let mut system = ObservingSystem::new(&layout, None, &[Network::new("europe", sondes)], 1, window, start)?;
/// let observed = system.observe(&State::zeros(&layout));
/// assert_eq!((observed.cycle, observed.len()), (1, 12));
/// # Ok::<(), isobar_obs::ObservationError>(())
/// ```
pub struct ObservingSystem {
    layout: Arc<Layout>,
    window: Duration,
    start: Time,
    cycle: usize,
    members: Vec<Member>,
    biases: Biases,
    stations: Vec<Station>,
    left_out: Vec<LeftOutStation>,
    /// Of the present cycle: observations that are used, then the others.
    values_bias_removed: Vec<f64>,
}

/// An observation with the reason why it is not used, if it is not, and the check of its value.
type Judged = (Arrival, Option<Unused>, Option<ValueCheck>);

/// A network in operation.
struct Member {
    name: String,
    schedule: Schedule,
    missing_rate: f64,
    missing: ChaCha8Rng,
    faults: Faults,
    faulty: ChaCha8Rng,
    error_correlation: Option<ErrorCorrelation>,
    is_passive: bool,
    withheld: Withheld,
    times_per_window: usize,
    instrument: Box<dyn Instrument>,
}

impl Member {
    /// What arrives of the network's observations in a cycle.
    fn observe(&mut self, cycle: usize, window: Duration, grid: &Grid) -> Vec<Observation> {
        let Some(pass) = self.schedule.pass(cycle) else { return Vec::new() };
        // The instrument draws all of its random errors, so that the rate changes no other report.
        let mut observations = self.instrument.observe(cycle, pass);
        spread(&mut observations, self.times_per_window, window);
        if let Some(correlation) = &self.error_correlation {
            correlation.correlate(&mut observations, grid);
        }
        let (mut platform, mut is_missing): (Option<Arc<str>>, bool) = (None, false);
        observations.retain(|observation| {
            if platform.as_ref() != Some(&observation.report.platform) {
                platform = Some(Arc::clone(&observation.report.platform));
                is_missing = self.missing.random::<f64>() < self.missing_rate;
            }
            !is_missing
        });
        observations
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        let mut streams = vec![&mut self.missing, &mut self.faulty];
        streams.extend(self.instrument.streams());
        streams
    }
}

impl ObservingSystem {
    /// The `networks` over the domain of `layout`, before the first cycle. Cycle n is valid `n × window` after `start`.
    /// Station files with latitudes and longitudes need a `projection`.
    ///
    /// # Errors
    /// Settings that are not what they must be, or do not fit each other, the domain or their files; more observations, or
    /// wider ones, than fit in memory.
    pub fn new(
        layout: &Arc<Layout>,
        projection: Option<&Projection>,
        networks: &[Network],
        seed: u64,
        window: Duration,
        start: Time,
    ) -> Result<Self, ObservationError> {
        if window.seconds() < 1 {
            let problem = format!("the assimilation window is {} s, but must be at least 1 s", window.seconds());
            return Err(ObservationError::in_system(problem));
        }
        let mut biases = Biases::new(seed, start);
        let mut members: Vec<Member> = Vec::with_capacity(networks.len());
        let (mut observations, mut weights) = (0, 0);
        for network in networks {
            network.validate()?;
            network.validate_times(window)?;
            let name = &network.name;
            if members.iter().any(|member| member.name == *name) {
                return Err(ObservationError::duplicate_name(name, "name", name));
            }
            let parameters = biases.calibration().len();
            let mut site = Site { network: name, layout, projection, seed, window, start, biases: &mut biases };
            let instrument = network.instrument.build(&mut site)?;
            let withheld = if network.withhold > 0.0 {
                Withheld::choose(network.withhold, &instrument.platforms(), name, &mut site.stream("withheld"))?
            } else {
                Withheld::default()
            };
            members.push(Member {
                name: name.clone(),
                schedule: network.schedule,
                missing_rate: network.missing_rate,
                missing: site.stream("missing"),
                faults: network.faults,
                faulty: site.stream("faults"),
                error_correlation: network.error_correlation,
                is_passive: !network.assimilate,
                withheld,
                times_per_window: network.times_per_window,
                instrument,
            });
            let member = &members[members.len() - 1];
            if let Some(correlation) = &network.error_correlation {
                correlation.check_size(name, member.instrument.most_in_report())?;
            }
            // Of recorded observations the weights of all cycles count, since those of one are few.
            observations += member.instrument.most_observations(1);
            weights += member.instrument.weights();
            check_size(name, observations, weights)?;
            if !network.assimilate && biases.calibration().len() > parameters {
                let problem = "assimilate is false, but the network has unknown biases, which only an assimilated network can \
                               determine; leave out the biases or declare them known";
                return Err(ObservationError::in_setting(name, "assimilate", problem));
            }
        }
        let stations = members.iter().flat_map(|member| member.instrument.stations()).cloned().collect();
        let left_out = members.iter().flat_map(|member| member.instrument.left_out()).cloned().collect();
        let (layout, values_bias_removed) = (Arc::clone(layout), Vec::new());
        Ok(Self { layout, window, start, cycle: 0, members, biases, stations, left_out, values_bias_removed })
    }

    /// The parameters that methods must estimate, in the order of every `c`.
    pub fn calibration(&self) -> &Calibration {
        self.biases.calibration()
    }

    /// The true values of [`Self::calibration`] in the present cycle, in their units; `None` for the biases of recorded
    /// observations, of which nothing is known.
    pub fn true_calibration(&self) -> &[Option<f64>] {
        self.biases.values()
    }

    /// The values of the present cycle's observations without any bias, as instruments with a known calibration would
    /// report them: of those that are used, then of the others. Nothing is known of the biases of recorded observations,
    /// whose values are as they were recorded.
    pub fn values_bias_removed(&self) -> &[f64] {
        &self.values_bias_removed
    }

    /// How the true values of [`Self::calibration`] come to be, of those that are known.
    pub fn bias_processes(&self) -> impl Iterator<Item = &BiasProcess> {
        self.biases.processes()
    }

    /// The parameters that are known, and therefore not part of the calibration, with their true values in the present cycle.
    pub fn known_biases(&self) -> impl Iterator<Item = (&Parameter, f64)> {
        self.biases.known()
    }

    /// The most observations that all networks may report in one of these cycles.
    pub fn most_observations(&self, cycles: RangeInclusive<usize>) -> usize {
        let of_member = |member: &Member, cycle: usize| {
            member.schedule.pass(cycle).map_or(0, |_| member.instrument.most_observations(cycle))
        };
        let in_cycle = |cycle: usize| self.members.iter().map(|member| of_member(member, cycle)).sum();
        cycles.map(in_cycle).max().unwrap_or(0)
    }

    /// About how many weights the rows of X have that all networks hold, or make in a cycle.
    pub fn weights(&self) -> usize {
        self.members.iter().map(|member| member.instrument.weights()).sum()
    }

    /// The stations in the domain, network after network.
    pub fn stations(&self) -> &[Station] {
        &self.stations
    }

    /// The stations that lie outside of the domain, or too near to its edges.
    pub fn left_out(&self) -> &[LeftOutStation] {
        &self.left_out
    }

    /// What becomes of recorded observations in these cycles, for each network that has such.
    pub fn recorded_use(&self, cycles: RangeInclusive<usize>) -> impl Iterator<Item = (&str, RecordedUse)> {
        self.members.iter().filter_map(move |member| Some((&*member.name, member.instrument.recorded_use(&cycles)?)))
    }

    /// The withheld stations of each network that has any.
    pub fn withheld(&self) -> impl Iterator<Item = (&str, &Withheld)> {
        let of_members = self.members.iter().map(|member| (&*member.name, &member.withheld));
        of_members.filter(|(_, withheld)| !withheld.names.is_empty())
    }

    /// The present cycle: that of the last observations, 0 before the first.
    pub fn cycle(&self) -> usize {
        self.cycle
    }

    /// The valid time of the present cycle; the start before the first.
    pub fn time(&self) -> Time {
        self.start + Duration::from_seconds(self.window.seconds() * self.cycle as i64)
    }

    /// Everything that the next cycles depend on beside the settings and the seed.
    pub fn save(&mut self) -> SavedSystem {
        let (cycle, biases) = (self.cycle, self.biases.save());
        SavedSystem { cycle, biases, streams: self.streams().iter().map(|stream| stream.get_word_pos()).collect() }
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        self.members.iter_mut().flat_map(Member::streams).collect()
    }

    /// Goes back to what [`Self::save`] gave, of a system of the same settings and seed.
    ///
    /// # Errors
    /// If it is of another system; this one then must not be used any more.
    pub fn restore(&mut self, saved: &SavedSystem) -> Result<(), ObservationError> {
        self.cycle = saved.cycle;
        let time = self.time();
        let fits = self.biases.restore(time, &saved.biases);
        let mut streams = self.streams();
        if streams.len() != saved.streams.len() || !fits {
            return Err(ObservationError::in_system("the saved observing system is not that of this experiment"));
        }
        streams.iter_mut().zip(&saved.streams).for_each(|(stream, &place)| stream.set_word_pos(place));
        Ok(())
    }

    /// As [`Self::observe_checked`], where the values are not checked against any other.
    ///
    /// # Panics
    /// As there.
    pub fn observe(&mut self, truth: &State) -> ObservationWindow {
        self.observe_checked(Some(truth.into()), None)
    }

    /// Goes on to the next cycle, lets the true biases evolve, and observes `truth`, the true state at its valid time
    /// [`Self::time`]; a world of recorded observations alone needs none. A network that observes within the window needs the true
    /// states at its times. The values have the biases of
    /// [`Self::calibration`], but not the known ones. Quality control compares the values with the reference, if there is one.
    ///
    /// # Panics
    /// If `truth` has another layout than the observing system, or there is none to observe for an instrument that does.
    pub fn observe_checked(
        &mut self,
        truth: Option<WindowStates<'_>>,
        reference: Option<(&QualityControl, Reference<'_>)>,
    ) -> ObservationWindow {
        let fits = truth.is_none_or(|truth| **truth.end().layout() == *self.layout);
        assert!(fits, "the truth must have the observing system's layout");
        self.cycle += 1;
        self.biases.advance(self.window);
        let time = self.time();
        let mut arrivals: Vec<Arrival> = Vec::new();
        for (network, member) in self.members.iter_mut().enumerate() {
            let observations = member.observe(self.cycle, self.window, &self.layout.grid);
            let arrive = |observation: Observation| {
                let (value, value_bias_removed, time) = match observation.reading {
                    Reading::Error(error) => {
                        let truth = truth.expect("an instrument that observes the truth needs one");
                        let value_bias_removed =
                            truth.value(observation.lag, |truth| observation.state.value(truth)) + error;
                        let bias = observation.true_bias(truth.end(), self.biases.values());
                        let time = time + Duration::from_seconds(-observation.lag.seconds());
                        (value_bias_removed + bias, value_bias_removed, time)
                    }
                    Reading::Recorded { value, time, .. } => (value, value, time),
                };
                let is_passive = member.is_passive || member.withheld.names.contains(&observation.report.platform);
                Arrival { observation, value, value_bias_removed, time, is_passive, network }
            };
            let observed = observations.into_iter().map(arrive).collect();
            arrivals.extend(member.faults.spoil(observed, self.window, &self.layout.grid, &mut member.faulty));
        }
        let mut rejections = quality::check_reports(&arrivals, time, &self.layout.grid);
        let checks = match reference {
            Some((control, reference)) => {
                control.check_values(&arrivals, reference, self.biases.calibration(), &mut rejections)
            }
            None => vec![None; arrivals.len()],
        };
        let judged = arrivals.into_iter().zip(rejections).zip(checks).map(|((arrival, rejection), check)| {
            let why_unused = rejection.map(Unused::Rejected).or(arrival.is_passive.then_some(Unused::Passive));
            (arrival, why_unused, check)
        });
        self.window(time, judged.collect())
    }

    /// Parts what methods see from what they do not.
    fn window(&mut self, time: Time, judged: Vec<Judged>) -> ObservationWindow {
        let (mut reports, mut times, mut values, mut sigma) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut checks, mut unused, mut unused_bias_removed) = (Vec::new(), Vec::new(), Vec::new());
        let (mut rows_of_used, mut rows_of_unused) = (GeneralOperator::default(), GeneralOperator::default());
        let (mut lags_of_used, mut lags_of_unused) = (Vec::new(), Vec::new());
        self.values_bias_removed.clear();
        let error_regression = self.error_regression(&judged);
        for (Arrival { observation, value, value_bias_removed, time, .. }, why_unused, check) in judged {
            if let Some(why) = why_unused {
                lags_of_unused.push(observation.lag);
                let Observation { report, sigma, .. } = rows_of_unused.take(observation);
                unused.push(UnusedObservation { report, time, value, sigma, why, check });
                unused_bias_removed.push(value_bias_removed);
                continue;
            }
            lags_of_used.push(observation.lag);
            let Observation { report, sigma: its_sigma, .. } = rows_of_used.take(observation);
            values.push(value);
            self.values_bias_removed.push(value_bias_removed);
            sigma.push(its_sigma);
            reports.push(report);
            times.push(time);
            checks.push(check);
        }
        self.values_bias_removed.extend(unused_bias_removed);
        let aside =
            Aside { checks, unused, operator: WithinWindow::around(rows_of_unused.simplified(), lags_of_unused) };
        let operator = WithinWindow::around(rows_of_used.simplified(), lags_of_used);
        let (cycle, comparisons) = (self.cycle, Vec::new());
        ObservationWindow { time, cycle, reports, times, values, sigma, error_regression, aside, comparisons, operator }
    }

    /// How the errors of the observations that are used depend on each other, as methods assume.
    fn error_regression(&self, judged: &[Judged]) -> ErrorRegression {
        let assumed = |member: &Member| member.error_correlation.map(|it| (it.kind, it.assumed_length_m));
        let of_networks: Vec<_> = self.members.iter().map(assumed).collect();
        let used = judged.iter().filter(|(_, why_unused, _)| why_unused.is_none());
        let used = used.map(|(arrival, ..)| (&arrival.observation, arrival.network));
        error_correlation::regression(&of_networks, used, &self.layout.grid)
    }
}

/// Refuses observing systems whose observations would not fit in memory; `name` is the network that is one too many.
fn check_size(name: &str, observations: usize, weights: usize) -> Result<(), ObservationError> {
    let fault = |problem: String| Err(ObservationError::in_setting(name, "kind", problem));
    if observations > MOST_OBSERVATIONS {
        return fault(format!(
            "with this network there would be {observations} observations in a cycle, of at most {MOST_OBSERVATIONS}: use \
             fewer stations or footprints, or fewer networks"
        ));
    }
    if weights > MOST_WEIGHTS {
        return fault(format!(
            "with this network the observations of a cycle would read {weights} values of the state, of at most \
             {MOST_WEIGHTS}: use fewer or smaller footprints, or fewer observations"
        ));
    }
    Ok(())
}
