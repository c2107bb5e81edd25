//! The events of a run as the journal holds them.

use crate::correlations::Correlations;
use crate::event::{Analysed, Estimated, Event, RunInfo, Smoothed};
use crate::sink::SinkError;
use crate::summary::{Failure, MethodScores, SmoothedScores};
use isobar_assim::{Analysis, CommonFactor, Estimate, EstimatedParameter, Structure};
use isobar_model::{Increment, State, Time};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, RejectedObservation, Report, SparseRows};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::sync::Arc;

type Numbers<'a> = Cow<'a, [f64]>;

/// An event.
#[expect(clippy::large_enum_variant, reason = "there is one of them at a time")]
#[derive(Serialize, Deserialize)]
pub(super) enum Entry<'a> {
    Truth {
        cycle: usize,
        seconds: i64,
        state: Numbers<'a>,
        calibration: Numbers<'a>,
    },
    Observed {
        cycle: usize,
        seconds: i64,
        reports: Cow<'a, [Report]>,
        values: Numbers<'a>,
        values_bias_removed: Numbers<'a>,
        sigma: Numbers<'a>,
        rejected: Cow<'a, [RejectedObservation]>,
    },
    Analysed {
        method: usize,
        cycle: usize,
        seconds: i64,
        background: EstimateEntry<'a>,
        analysis: EstimateEntry<'a>,
        background_departures: Numbers<'a>,
        analysis_departures: Numbers<'a>,
        innovation_chi2: Option<f64>,
        scores: Cow<'a, MethodScores>,
        structure: Option<StructureEntry<'a>>,
        correlations: Option<Cow<'a, Correlations>>,
    },
    Failed {
        method: usize,
        failure: Cow<'a, Failure>,
    },
    CycleEnded(usize),
    Estimated {
        method: usize,
        cycle: usize,
        seconds: i64,
        parameters: Cow<'a, [EstimatedParameter]>,
    },
    Smoothed {
        method: usize,
        cycle: usize,
        later_cycles: usize,
        estimate: EstimateEntry<'a>,
        scores: Cow<'a, SmoothedScores>,
    },
}

#[derive(Serialize, Deserialize)]
pub(super) struct EstimateEntry<'a> {
    state: Numbers<'a>,
    calibration: Numbers<'a>,
    state_spread: Option<Numbers<'a>>,
    calibration_spread: Option<Numbers<'a>>,
}

impl<'a> From<&'a Estimate> for EstimateEntry<'a> {
    fn from(it: &'a Estimate) -> Self {
        Self {
            state: it.state.values().into(),
            calibration: it.calibration.as_slice().into(),
            state_spread: it.state_spread.as_deref().map(Cow::from),
            calibration_spread: it.calibration_spread.as_deref().map(Cow::from),
        }
    }
}

impl EstimateEntry<'_> {
    fn estimate(self, info: &RunInfo) -> Result<Estimate, String> {
        Ok(Estimate {
            state: state(info, &self.state)?,
            calibration: self.calibration.into_owned(),
            state_spread: self.state_spread.map(Cow::into_owned),
            calibration_spread: self.calibration_spread.map(Cow::into_owned),
        })
    }
}

#[derive(Serialize, Deserialize)]
pub(super) struct StructureEntry<'a> {
    part_of_cell: Cow<'a, [usize]>,
    observed: Cow<'a, [bool]>,
    /// Increment, calibration and share of each factor.
    factors: Vec<(Numbers<'a>, Numbers<'a>, f64)>,
}

impl<'a> From<&'a Structure> for StructureEntry<'a> {
    fn from(it: &'a Structure) -> Self {
        let factor = |it: &'a CommonFactor| (it.increment.values().into(), it.calibration.as_slice().into(), it.share);
        Self {
            part_of_cell: it.part_of_cell.as_slice().into(),
            observed: it.observed.as_slice().into(),
            factors: it.factors.iter().map(factor).collect(),
        }
    }
}

impl StructureEntry<'_> {
    fn structure(self, info: &RunInfo) -> Result<Structure, String> {
        let cells = info.layout.grid.cells();
        let is_part = |&part: &usize| part < self.observed.len();
        if self.part_of_cell.len() != cells || !self.part_of_cell.iter().all(is_part) {
            return Err("a structure is not one of this run".into());
        }
        let factor = |(values, calibration, share): (Numbers<'_>, Numbers<'_>, f64)| {
            if values.len() != info.layout.len() || calibration.len() != info.calibration.len() {
                return Err("a factor is not one of this run".to_string());
            }
            let increment = Increment::from_values(&info.layout, values.into_owned());
            Ok(CommonFactor { increment, calibration: calibration.into_owned(), share })
        };
        Ok(Structure {
            part_of_cell: self.part_of_cell.into_owned(),
            observed: self.observed.into_owned(),
            factors: self.factors.into_iter().map(factor).collect::<Result<_, _>>()?,
        })
    }
}

fn state(info: &RunInfo, values: &[f64]) -> Result<State, String> {
    let mut state = State::zeros(&info.layout);
    if values.len() != state.values().len() {
        return Err("a state is not one of this run".into());
    }
    state.values_mut().copy_from_slice(values);
    Ok(state)
}

impl<'a> Entry<'a> {
    /// The event, unless the run's plan implies it.
    pub fn of(event: &'a Event<'a>) -> Option<Self> {
        Some(match event {
            Event::Truth { cycle, time, state, calibration } => Entry::Truth {
                cycle: *cycle,
                seconds: time.seconds(),
                state: state.values().into(),
                calibration: (*calibration).into(),
            },
            Event::Observed(window) => Entry::Observed {
                cycle: window.cycle,
                seconds: window.time.seconds(),
                reports: window.reports.as_slice().into(),
                values: window.values.as_slice().into(),
                values_bias_removed: window.values_bias_removed.as_slice().into(),
                sigma: window.sigma.as_slice().into(),
                rejected: window.rejected.as_slice().into(),
            },
            Event::Analysed(it) => Entry::Analysed {
                method: it.method,
                cycle: it.cycle,
                seconds: it.time.seconds(),
                background: it.background.into(),
                analysis: (&it.analysis.estimate).into(),
                background_departures: it.analysis.background_departures.as_slice().into(),
                analysis_departures: it.analysis.analysis_departures.as_slice().into(),
                innovation_chi2: it.analysis.innovation_chi2,
                scores: Cow::Borrowed(it.scores),
                structure: it.structure.map(StructureEntry::from),
                correlations: it.correlations.map(Cow::Borrowed),
            },
            Event::Failed { method, failure } => Entry::Failed { method: *method, failure: Cow::Borrowed(failure) },
            Event::CycleEnded(cycle) => Entry::CycleEnded(*cycle),
            Event::Estimated(it) => Entry::Estimated {
                method: it.method,
                cycle: it.cycle,
                seconds: it.time.seconds(),
                parameters: it.parameters.into(),
            },
            Event::Smoothed(it) => Entry::Smoothed {
                method: it.method,
                cycle: it.cycle,
                later_cycles: it.later_cycles,
                estimate: it.estimate.into(),
                scores: Cow::Borrowed(it.scores),
            },
            Event::Started(_) | Event::Resumed(_) | Event::Warning(_) | Event::Finished(_) => {
                return None;
            }
        })
    }
}

impl Entry<'_> {
    /// Tells the event again.
    ///
    /// # Errors
    /// In words, if it is not one of this run, or those of `tell`.
    pub fn tell(self, info: &RunInfo, tell: &mut dyn FnMut(Event<'_>) -> Result<(), SinkError>) -> Result<(), String> {
        let is_method = |method: usize| if method < info.methods.len() { Ok(()) } else { Err("a method is unknown") };
        let told = match self {
            Entry::Truth { cycle, seconds, state: values, calibration } => {
                let (time, state) = (Time::from_seconds(seconds), state(info, &values)?);
                if calibration.len() != info.calibration.len() {
                    return Err("a calibration is not one of this run".into());
                }
                tell(Event::Truth { cycle, time, state: &state, calibration: &calibration })
            }
            Entry::Observed { cycle, seconds, reports, values, values_bias_removed, sigma, rejected } => {
                tell(Event::Observed(&ObservationWindow {
                    time: Time::from_seconds(seconds),
                    cycle,
                    reports: reports.into_owned(),
                    values: values.into_owned(),
                    values_bias_removed: values_bias_removed.into_owned(),
                    sigma: sigma.into_owned(),
                    rejected: rejected.into_owned(),
                    // No sink asks what an estimate would have given.
                    operator: Arc::new(LinearOperator {
                        jacobian: Jacobian { state: SparseRows::new(), calibration: SparseRows::new() },
                    }),
                }))
            }
            Entry::Analysed {
                method,
                cycle,
                seconds,
                background,
                analysis,
                background_departures,
                analysis_departures,
                innovation_chi2,
                scores,
                structure,
                correlations,
            } => {
                is_method(method)?;
                let structure = structure.map(|it| it.structure(info)).transpose()?;
                let (values, parameters) = (info.layout.len(), info.calibration.len());
                let fits = |it: &Correlations| {
                    it.of < values && it.state.len() == values && it.calibration.len() == parameters
                };
                if !correlations.as_deref().is_none_or(fits) {
                    return Err("correlations are not those of this run".into());
                }
                tell(Event::Analysed(Analysed {
                    method,
                    cycle,
                    time: Time::from_seconds(seconds),
                    background: &background.estimate(info)?,
                    analysis: &Analysis {
                        estimate: analysis.estimate(info)?,
                        background_departures: background_departures.into_owned(),
                        analysis_departures: analysis_departures.into_owned(),
                        innovation_chi2,
                        // It is part of the scores.
                        partition: None,
                        warnings: Vec::new(),
                    },
                    scores: &scores,
                    structure: structure.as_ref(),
                    correlations: correlations.as_deref(),
                }))
            }
            Entry::Failed { method, failure } => {
                is_method(method)?;
                tell(Event::Failed { method, failure: &failure })
            }
            Entry::CycleEnded(cycle) => tell(Event::CycleEnded(cycle)),
            Entry::Estimated { method, cycle, seconds, parameters } => {
                is_method(method)?;
                let time = Time::from_seconds(seconds);
                tell(Event::Estimated(Estimated { method, cycle, time, parameters: &parameters }))
            }
            Entry::Smoothed { method, cycle, later_cycles, estimate, scores } => {
                is_method(method)?;
                let estimate = &estimate.estimate(info)?;
                tell(Event::Smoothed(Smoothed { method, cycle, later_cycles, estimate, scores: &scores }))
            }
        };
        told.map_err(|error| error.to_string())
    }
}
