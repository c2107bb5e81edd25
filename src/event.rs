//! What happens during a run, as the sinks hear it and the journal holds it.

use crate::correlations::Correlations;
use crate::lead_times::LeadTimes;
use crate::outcome::UnusedDepartures;
use crate::readings::Readings;
use crate::scores::{Against, Failure, Line, Outlook, SCORES, ScoreKind, Summary, Values, WarningCase};
use crate::threshold_warning::PlacedWarning;
use crate::verdict::Verdict;
use isobar_assim::{Analysis, Estimate, EstimatedParameter, Structure};
use isobar_model::{Duration, Layout, State, Time, Variable};
use isobar_obs::{Calibration, ObservationWindow, Projection, SensorComparison};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What is known before the first cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunInfo {
    /// Name of the scenario: its file's stem.
    pub scenario: String,
    /// The scenario's title.
    pub title: String,
    /// The scenario file, to the letter.
    pub scenario_text: String,
    /// The threads of the run.
    pub threads: usize,
    /// The seed of all random streams.
    pub seed: u64,
    /// Grid and variables.
    pub layout: Arc<Layout>,
    /// Where on the Earth the plane lies, if anywhere.
    pub projection: Option<Projection>,
    /// Valid time of the state before cycle 1; the analysis of cycle t is valid at `start + t × window`.
    pub start: Time,
    /// Length of a cycle.
    pub window: Duration,
    /// Number of the last cycle of the earlier runs from which this one goes on; 0 without an earlier run.
    pub done: usize,
    /// Number of the last cycle.
    pub cycles: usize,
    /// The first cycle that counts for the scores.
    pub score_from_cycle: usize,
    /// The lead times of forecasts ahead, if there are such forecasts.
    pub lead_times: Option<LeadTimes>,
    /// The warnings of forecasts ahead.
    pub warnings: Vec<PlacedWarning>,
    /// The calibration parameters.
    pub calibration: Calibration,
    /// The methods, in the order in which they run.
    pub methods: Vec<MethodInfo>,
    /// Whether there is a truth, with which methods are compared.
    pub has_truth: bool,
    /// The file that the truth is read from, if it is, as the scenario names it.
    pub truth_file: Option<String>,
    /// Whether what is known of its sensors is kept in a database.
    pub keeps_sensors: bool,
    /// The networks.
    pub networks: Vec<NetworkInfo>,
    /// What there is to know of their stations and files.
    pub notes: Vec<String>,
    /// The observing platforms with a fixed place.
    pub stations: Vec<StationInfo>,
}

impl RunInfo {
    /// Valid time of the analysis of a cycle.
    pub fn time(&self, cycle: usize) -> Time {
        self.start + self.window * cycle
    }

    /// Valid time of the state with which the run begins.
    pub fn begin(&self) -> Time {
        self.time(self.done)
    }

    /// Number of the cycles that are this run's, and not those of earlier ones.
    pub fn count(&self) -> usize {
        self.cycles - self.done
    }

    /// The first cycle of this run that counts for the scores.
    pub fn scored_from(&self) -> usize {
        self.score_from_cycle.max(self.done + 1)
    }

    /// The cycle of the last analysis from which a forecast ahead reaches the longest lead time within the run; that of the first
    /// start if none does.
    pub fn last_complete_start(&self, times: LeadTimes) -> usize {
        times.last_complete_start(times.first_start(self.score_from_cycle, self.done), self.cycles)
    }

    /// A number of cycles in hours.
    pub fn lead_hours(&self, cycles: usize) -> f64 {
        (self.window * cycles).hours()
    }

    /// Names and UDUNITS units of the variables.
    pub fn variables(&self) -> Vec<(&'static str, &'static str)> {
        self.layout.variables.iter().map(|variable| (variable.name, variable.unit)).collect()
    }

    /// Whether cycles of the run can have a score of this kind.
    pub fn can_have(&self, kind: &ScoreKind) -> bool {
        kind.against.exists(self.has_truth, self.networks.iter().any(|network| network.has_passive))
    }

    /// The kinds of scores that are drawn over time, of variables or of methods as a whole: departures of observations only
    /// where there is no truth.
    pub fn drawn(&self, per_variable: bool) -> impl Iterator<Item = (&'static ScoreKind, Line)> {
        let is_left_out = |kind: &ScoreKind| matches!(kind.against, Against::Used | Against::Passive) && self.has_truth;
        let kinds = SCORES.iter().filter(move |kind| kind.per_variable == per_variable && !is_left_out(kind));
        kinds.filter_map(|kind| Some((kind, kind.line?)))
    }

    /// The stations with a bias of each variable: the number of the station, and that of the calibration parameter, which is the
    /// station's or its group's.
    pub fn station_biases(&self) -> Vec<Vec<(usize, usize)>> {
        let parameters = self.calibration.parameters.iter().enumerate();
        let numbers: BTreeMap<&str, usize> = parameters.map(|(number, it)| (it.name.as_str(), number)).collect();
        let of_variable = |variable: &Variable| {
            let bias = |station: &StationInfo| {
                let names =
                    [&station.group, &station.name].map(|of| format!("{}/{}/{of}", station.network, variable.name));
                names.iter().filter_map(|name| numbers.get(name.as_str()).copied()).min()
            };
            let stations = self.stations.iter().enumerate();
            stations.filter_map(|(number, station)| Some((number, bias(station)?))).collect()
        };
        self.layout.variables.iter().map(of_variable).collect()
    }

    /// Whether nothing is known of the true biases of a network, since it was recorded elsewhere.
    pub fn is_recorded(&self, network: &str) -> bool {
        self.networks.iter().any(|own| own.is_recorded && *own.name == *network)
    }
}

/// A network of the run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NetworkInfo {
    /// Its name.
    pub name: Arc<str>,
    /// Whether its observations were made elsewhere.
    pub is_recorded: bool,
    /// Whether methods do not see all of its observations.
    pub has_passive: bool,
}

/// A method of the run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MethodInfo {
    /// Its name in the scenario.
    pub name: String,
    /// Its settings, in words.
    pub description: String,
    /// The number of later cycles whose observations revise its estimates, if it has a smoother.
    pub smoother_lag_cycles: Option<usize>,
    /// Whether it estimates biases.
    pub estimates_biases: bool,
}

/// A station.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StationInfo {
    /// Its network.
    pub network: Arc<str>,
    /// Its name.
    pub name: Arc<str>,
    /// Its group (country, sonde type).
    pub group: Arc<str>,
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
}

/// Something that happened. Those events that the journal holds are serialised; they own their contents when read back.
#[expect(clippy::large_enum_variant, reason = "there is one of them at a time")]
#[derive(Serialize, Deserialize)]
pub enum Event<'a> {
    /// The truth of a cycle is known. It is also sent for the state with which the run begins, as a rule that of cycle 0; never
    /// in a world without a truth.
    Truth {
        /// Number of the cycle.
        cycle: usize,
        /// Valid time.
        time: Time,
        /// The true state.
        state: Cow<'a, State>,
        /// The true calibration parameters; nothing for those of recorded observations.
        calibration: Cow<'a, [Option<f64>]>,
    },
    /// The observations of a cycle.
    Observed {
        /// As methods that estimate or ignore biases receive them.
        window: Cow<'a, ObservationWindow>,
        /// Their values without the true biases: of those that are used, then of the others. Nothing is known of the biases of
        /// recorded and of rejected observations.
        values_bias_removed: Cow<'a, [f64]>,
    },
    /// A method has analysed the observations of a cycle.
    Analysed(Analysed<'a>),
    /// A method has estimated parameters beside state and calibration in a cycle.
    Estimated(Estimated<'a>),
    /// The verdict on biases of a method is the first, or another than in the cycle before.
    Judged(Judged<'a>),
    /// A method has revised the estimate of an earlier cycle, for the last time.
    Smoothed(Smoothed<'a>),
    /// A method has made its forecasts ahead of an analysis, with the probabilities of the warnings.
    Outlook {
        /// Number of the method in [`RunInfo::methods`].
        method: usize,
        /// The probabilities.
        outlook: Cow<'a, Outlook>,
    },
    /// The valid time of a method's forecast ahead has come.
    Forecast(Forecast<'a>),
    /// A method has failed in a cycle, and has no results in it and after it.
    Failed {
        /// Number of the method in [`RunInfo::methods`].
        method: usize,
        /// When, and why.
        failure: Cow<'a, Failure>,
    },
    /// All events of a cycle have been sent.
    CycleEnded(usize),
    /// The run begins.
    #[serde(skip)]
    Started(&'a RunInfo),
    /// All events of the cycles up to this one have been sent again, and the run continues from here.
    #[serde(skip)]
    Resumed(usize),
    /// An output is not what was asked for, and the run continues.
    #[serde(skip)]
    Warning(&'a str),
    /// The run is complete.
    #[serde(skip)]
    Finished(&'a Summary),
}

impl Event<'_> {
    /// Whether the event is one of this run; one that was read from a file may not be.
    pub fn fits(&self, info: &RunInfo) -> bool {
        let is_method = |method: usize| method < info.methods.len();
        match self {
            Event::Truth { state, calibration, .. } => {
                *state.layout() == info.layout && calibration.len() == info.calibration.len()
            }
            Event::Observed { window, values_bias_removed } => {
                let is_known =
                    |it: &SensorComparison| it.row().all(|(parameter, _)| parameter < info.calibration.len());
                window.fits(&info.layout)
                    && window.comparisons.iter().all(is_known)
                    && values_bias_removed.len() == window.len() + window.aside.unused.len()
            }
            Event::Analysed(analysed) => is_method(analysed.method) && analysed.fits(info),
            Event::Estimated(estimated) => is_method(estimated.method),
            Event::Judged(Judged { method, verdicts, .. }) => {
                is_method(*method) && verdicts.iter().all(|it| it.parameter < info.calibration.len())
            }
            Event::Smoothed(smoothed) => is_method(smoothed.method) && fits(&smoothed.estimate, info),
            Event::Outlook { method, outlook } => {
                let is_probability = |it: &f64| (0.0..=1.0).contains(it);
                is_method(*method)
                    && outlook
                        .leads
                        .iter()
                        .all(|(_, all)| all.len() == info.warnings.len() && all.iter().all(is_probability))
            }
            Event::Forecast(forecast) => {
                is_method(forecast.method)
                    && forecast.warnings.len() == info.warnings.len()
                    && (1..=forecast.cycle).contains(&forecast.from_cycle)
                    && fits(&forecast.estimate, info)
            }
            Event::Failed { method, .. } => is_method(*method),
            Event::CycleEnded(_) | Event::Started(_) | Event::Resumed(_) | Event::Warning(_) | Event::Finished(_) => {
                true
            }
        }
    }
}

/// What a method has estimated in one cycle beside state and calibration.
#[derive(Serialize, Deserialize)]
pub struct Estimated<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The parameters.
    pub parameters: Cow<'a, [EstimatedParameter]>,
}

/// Which biases of a method the observations determine, where that has changed.
#[derive(Serialize, Deserialize)]
pub struct Judged<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The verdicts after the analysis of the cycle.
    pub verdicts: Cow<'a, [Verdict]>,
}

/// A method's estimate of an earlier cycle, given the observations of later ones.
#[derive(Serialize, Deserialize)]
pub struct Smoothed<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle that it is of, from 1.
    pub cycle: usize,
    /// Number of later cycles whose observations are taken in.
    pub later_cycles: usize,
    /// The estimate.
    pub estimate: Cow<'a, Estimate>,
    /// The scores of this cycle alone; without its truth the claims.
    pub scores: Cow<'a, Values>,
}

/// A method's forecast ahead of an analysis, or that analysis, when its valid time has come.
#[derive(Serialize, Deserialize)]
pub struct Forecast<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// The cycle from whose analysis it started.
    pub from_cycle: usize,
    /// The cycle at whose end it is valid.
    pub cycle: usize,
    /// The forecast.
    pub estimate: Cow<'a, Estimate>,
    /// Its scores, by the names of those of forecasts and of the variables.
    pub scores: Cow<'a, Values>,
    /// Its warnings, in the order of [`RunInfo::warnings`].
    pub warnings: Cow<'a, [WarningCase]>,
}

/// A method's results in one cycle.
#[derive(Serialize, Deserialize)]
pub struct Analysed<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The estimate before the observations.
    pub background: Cow<'a, Estimate>,
    /// The analysis.
    pub analysis: Cow<'a, Analysis>,
    /// How the observations that the method did not see depart from its estimates.
    pub unused: Cow<'a, UnusedDepartures>,
    /// The observations without the biases that the method has found, if it estimates biases.
    pub readings: Option<Cow<'a, Readings>>,
    /// The scores of this cycle alone.
    pub scores: Cow<'a, Values>,
    /// Blocks and common factors after the analysis, for a method that has them and if a sink shows them.
    pub structure: Option<Cow<'a, Structure>>,
    /// What goes together with the error in the middle of the domain, for a method with a covariance in the last cycle and
    /// if a sink shows it.
    pub correlations: Option<Cow<'a, Correlations>>,
}

impl Analysed<'_> {
    /// Whether all parts have the sizes of the run.
    fn fits(&self, info: &RunInfo) -> bool {
        let (cells, values, parameters) = (info.layout.grid.cells(), info.layout.len(), info.calibration.len());
        let structure_fits = |it: &Structure| {
            it.part_of_cell.len() == cells
                && it.part_of_cell.iter().all(|&part| part < it.observed.len())
                && it
                    .factors
                    .iter()
                    .all(|factor| *factor.increment.layout() == info.layout && factor.calibration.len() == parameters)
        };
        let correlations_fit =
            |it: &Correlations| it.of < values && it.state.len() == values && it.calibration.len() == parameters;
        fits(&self.background, info)
            && fits(&self.analysis.estimate, info)
            && self.structure.as_deref().is_none_or(structure_fits)
            && self.correlations.as_deref().is_none_or(correlations_fit)
    }
}

/// Whether an estimate is of this run's variables and parameters.
pub(crate) fn fits(estimate: &Estimate, info: &RunInfo) -> bool {
    let Estimate { state, calibration_spread, state_spread, .. } = estimate;
    let is_of = |spread: &Option<Vec<f64>>, length: usize| spread.as_ref().is_none_or(|spread| spread.len() == length);
    *state.layout() == info.layout
        && is_of(state_spread, info.layout.len())
        && is_of(calibration_spread, estimate.calibration.len())
}
