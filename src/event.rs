//! What happens during a run, as the sinks hear it.

use crate::correlations::Correlations;
use crate::summary::{Failure, MethodScores, SmoothedScores, Summary};
use isobar_assim::{Analysis, Estimate, EstimatedParameter, Structure};
use isobar_model::{Duration, Layout, State, Time};
use isobar_obs::{Calibration, ObservationWindow, Projection};
use std::sync::Arc;

/// What is known before the first cycle.
#[derive(Clone, Debug)]
pub struct RunInfo {
    /// Name of the scenario: its file's stem.
    pub scenario: String,
    /// The scenario's title.
    pub title: String,
    /// The scenario file, to the letter.
    pub scenario_text: String,
    /// The seed of all random streams.
    pub seed: u64,
    /// Grid and variables.
    pub layout: Arc<Layout>,
    /// Where on the Earth the plane lies, if anywhere.
    pub projection: Option<Projection>,
    /// Valid time of the initial state; the analysis of cycle t is valid at `start + t × window`.
    pub start: Time,
    /// Length of a cycle.
    pub window: Duration,
    /// Number of cycles.
    pub cycles: usize,
    /// The calibration parameters.
    pub calibration: Calibration,
    /// The methods, in the order in which they run.
    pub methods: Vec<MethodInfo>,
    /// The observing platforms with a fixed place.
    pub stations: Vec<StationInfo>,
}

/// A method of the run.
#[derive(Clone, Debug)]
pub struct MethodInfo {
    /// Its name in the scenario.
    pub name: String,
    /// Its settings, in words.
    pub description: String,
    /// The number of later cycles whose observations revise its estimates, if it has a smoother.
    pub smoother_lag_cycles: Option<usize>,
}

/// A station.
#[derive(Clone, Debug)]
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

/// Something that happened.
pub enum Event<'a> {
    /// The run begins.
    Started(&'a RunInfo),
    /// The truth of a cycle is known. It is also sent for cycle 0, the initial state.
    Truth {
        /// Number of the cycle.
        cycle: usize,
        /// Valid time.
        time: Time,
        /// The true state.
        state: &'a State,
        /// The true calibration parameters.
        calibration: &'a [f64],
    },
    /// The observations of a cycle.
    Observed {
        /// As methods that estimate or ignore biases receive them.
        window: &'a ObservationWindow,
        /// Their values without the true biases.
        values_bias_removed: &'a [f64],
    },
    /// A method has analysed the observations of a cycle.
    Analysed(Analysed<'a>),
    /// A method has estimated parameters beside state and calibration in a cycle.
    Estimated(Estimated<'a>),
    /// A method has revised the estimate of an earlier cycle, for the last time.
    Smoothed(Smoothed<'a>),
    /// A method has failed in a cycle, and has no results in it and after it.
    Failed {
        /// Number of the method in [`RunInfo::methods`].
        method: usize,
        /// When, and why.
        failure: &'a Failure,
    },
    /// All events of the cycles up to this one have been told again, and the run goes on from here.
    Resumed(usize),
    /// Truth, observations and methods of a cycle are all told.
    CycleEnded(usize),
    /// An output is not what was asked for, and the run goes on.
    Warning(&'a str),
    /// The run is complete.
    Finished(&'a Summary),
}

/// What a method has estimated in one cycle beside state and calibration.
pub struct Estimated<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The parameters.
    pub parameters: &'a [EstimatedParameter],
}

/// What a method says of an earlier cycle, given the observations of later ones.
pub struct Smoothed<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle that it is of, from 1.
    pub cycle: usize,
    /// Number of later cycles whose observations are taken in.
    pub later_cycles: usize,
    /// The estimate.
    pub estimate: &'a Estimate,
    /// The scores of this cycle alone; empty if its truth is not known any more.
    pub scores: &'a SmoothedScores,
}

/// A method's results in one cycle.
pub struct Analysed<'a> {
    /// Number of the method in [`RunInfo::methods`].
    pub method: usize,
    /// Number of the cycle, from 1.
    pub cycle: usize,
    /// Valid time.
    pub time: Time,
    /// The estimate before the observations.
    pub background: &'a Estimate,
    /// The analysis.
    pub analysis: &'a Analysis,
    /// The scores of this cycle alone.
    pub scores: &'a MethodScores,
    /// Blocks and common factors after the analysis, for a method that has them and if a sink shows them.
    pub structure: Option<&'a Structure>,
    /// What goes together with the error in the middle of the domain, for a method with a covariance in the last cycle and
    /// if a sink shows it.
    pub correlations: Option<&'a Correlations>,
}
