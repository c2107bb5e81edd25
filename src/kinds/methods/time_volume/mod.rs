//! `kind = "time_volume"`: the Fast Kalman Filter over a moving window, with factors and state-transition corrections.

mod corrections;
mod factors;

use super::{
    COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MethodSettings, SMOOTHER_LAG_CYCLES, Setup, Sizes, Surroundings, Work,
    fast_kalman,
};
use crate::kinds::models::Model;
use crate::kinds::{Domain, Kind, form};
use crate::reader::{Absent, Choice, Described, Form, Key, Limits, Read, Section, Whole};
use corrections::ModelCorrections;
use factors::{FactorSettings, MOST};
use isobar_assim::time_volume::{Candidate, Corrections, TimeVolume, TimeVolumeSettings};
use isobar_assim::{Assimilator, Error};
use std::sync::Arc;

const WINDOW_CYCLES: Key<Whole> =
    Key::required("window_cycles", "cycles", Whole(1, 1_000_000), "length of the window, at most that of the run");

const BEFORE_WINDOW: Key<Choice<bool>> = Key::absent(
    "before_window",
    "",
    Choice(&[("forget", false), ("keep", true)]),
    Absent::Means(false),
    "what becomes of the information of cycles before the window",
);

const OBSERVATION_FACTORS: Key<Described> = Key::absent(
    "observation_factors",
    "",
    Described("a list of tables", || Form::list(form(factors::SHAPES))),
    Absent::Explained("none"),
    "factors of the errors of observations",
);

const MODEL_FACTORS: Key<Described> = Key::absent(
    "model_factors",
    "",
    Described("a list of tables", || Form::list(form(factors::SHAPES))),
    Absent::Explained("none"),
    "factors of the errors of the model",
);

const TRANSITION_CORRECTIONS: Key<Described> = Key::absent(
    "transition_corrections",
    "",
    Described("a list of tables", || Form::list(Form::Table(corrections::KEYS))),
    Absent::Explained("none"),
    "parameters of the model that may be wrong",
);

const SELECTION_THRESHOLD: Key<Limits> = Key::absent(
    "selection_threshold",
    "",
    Limits::Between(0.1, 100.0),
    Absent::Means(4.0),
    "how much a correction's column must correlate with the innovations, in standard deviations of chance",
);

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "time_volume",
    "The Fast Kalman Filter with unknowns that a window of cycles shares: factors of errors, corrections of the model",
    &[
        fast_kalman::SHARED_KEYS,
        &[
            &WINDOW_CYCLES,
            &BEFORE_WINDOW,
            &OBSERVATION_FACTORS,
            &MODEL_FACTORS,
            &TRANSITION_CORRECTIONS,
            &SELECTION_THRESHOLD,
            &ERROR_CORRELATION,
            &FIRST_GUESS,
            &COMPARISONS,
            &SMOOTHER_LAG_CYCLES,
        ],
    ],
    |section, surroundings| {
        let cycles = surroundings.cycles;
        let window_cycles = section.get(&WINDOW_CYCLES)?;
        if window_cycles > cycles {
            let message = format!("a window of {window_cycles} cycles is longer than the run of {cycles}");
            let allowed = format!("must be from 1 to {cycles}, that is cycle.count");
            return Err(section.required(WINDOW_CYCLES.name)?.invalid(message, &allowed));
        }
        let (factors, corrections) = (read_factors(section, surroundings)?, read_corrections(section, surroundings)?);
        if factors.is_empty() && corrections.is_empty() {
            let message = format!("[{}] has nothing to estimate over its window", section.title());
            let label = "give `observation_factors`, `model_factors` or `transition_corrections`";
            return Err(section.file.error(section.span.clone(), message, label, None));
        }
        let filter = fast_kalman::read(section, surroundings)?;
        fast_kalman::check_smoother(section, filter.filter.factors > 0)?;
        Ok(Box::new(TimeVolumeOptions {
            filter,
            window_cycles,
            keep_before: section.get(&BEFORE_WINDOW)?,
            factors,
            corrections,
            selection_threshold: section.get(&SELECTION_THRESHOLD)?,
        }))
    },
);

fn read_factors(section: &Section<'_>, surroundings: &Surroundings) -> Read<Vec<FactorSettings>> {
    let mut all: Vec<FactorSettings> = Vec::new();
    for (key, of_model) in [(&OBSERVATION_FACTORS, false), (&MODEL_FACTORS, true)] {
        for field in section.optional(key.name).map_or(Ok(Vec::new()), |field| field.elements(MOST))? {
            let factor = factors::read(&field, of_model, &surroundings.domain)?;
            factors::check_name(&factor, &all, &field)?;
            all.push(factor);
        }
    }
    Ok(all)
}

fn read_corrections(section: &Section<'_>, surroundings: &Surroundings) -> Read<Vec<Candidate>> {
    let mut all: Vec<Candidate> = Vec::new();
    let Some(list) = section.optional(TRANSITION_CORRECTIONS.name) else { return Ok(all) };
    let mut amplitudes = 0;
    for field in list.elements(corrections::MOST_AMPLITUDES)? {
        let candidate = corrections::read(&field, &surroundings.domain)?;
        if all.iter().any(|other| other.name == candidate.name) {
            return Err(field.invalid(format!("`{}` is a candidate already", field.title()), "already in the list"));
        }
        amplitudes += candidate.patterns.len().max(1);
        if amplitudes > corrections::MOST_AMPLITUDES {
            let message = format!("with `{}` the corrections have {amplitudes} amplitudes", field.title());
            let allowed = format!("must be at most {} in all", corrections::MOST_AMPLITUDES);
            return Err(field.invalid(message, &allowed));
        }
        all.push(candidate);
    }
    Ok(all)
}

/// What is estimated over a moving window of cycles.
#[derive(Debug)]
struct TimeVolumeOptions {
    /// The filter within each cycle.
    filter: fast_kalman::Settings,
    window_cycles: usize,
    /// Whether the information of cycles before the window is kept.
    keep_before: bool,
    factors: Vec<FactorSettings>,
    /// The model's parameters that may be wrong.
    corrections: Vec<Candidate>,
    /// How much a correction's column must correlate with the innovations, in standard deviations of chance.
    selection_threshold: f64,
}

impl MethodSettings for TimeVolumeOptions {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let Setup { problem, domain, start, cycle, smoother_lag_cycles, .. } = setup;
        let factors = self.factors.iter().map(|factor| factor.resolve(&problem.calibration));
        let settings = TimeVolumeSettings {
            filter: self.filter.filter,
            cycles: self.window_cycles,
            keep_before: self.keep_before,
            factors: factors.collect::<Result<_, _>>()?,
            start,
            selection_threshold: self.selection_threshold,
        };
        let corrections = (!self.corrections.is_empty()).then(|| {
            let (domain, candidates) = (domain.clone(), self.corrections.clone());
            let background = problem.background.clone();
            Arc::new(ModelCorrections { domain, cycle, background, candidates }) as Arc<dyn Corrections>
        });
        let method = TimeVolume::new(problem, settings, corrections)?;
        Ok(match smoother_lag_cycles {
            Some(lag) => Box::new(method.smoothing(lag)?),
            None => Box::new(method),
        })
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // Unknowns of the window are columns beside the factors.
        let corrections: usize = self.corrections.iter().map(|it| it.patterns.len().max(1)).sum();
        let more = (self.factors.len() * self.window_cycles + corrections) as f64;
        let sizes = Sizes { shared_biases: sizes.shared_biases + more, ..sizes.clone() };
        let work = fast_kalman::work(&self.filter, 1, &sizes);
        // With corrections what it knew at three starts is kept as well, each about a third of this.
        Work { numbers: if corrections > 0 { 2.0 * work.numbers } else { work.numbers }, ..work }
    }

    fn describe(&self) -> String {
        format!(
            "moving time volume of {} cycles, {} factors of observations and model, {} candidates of transition, {}",
            self.window_cycles,
            self.factors.len(),
            self.corrections.len(),
            fast_kalman::describe(&self.filter, 1)
        )
    }

    fn true_corrections(&self, truth: &Model, methods: &Domain) -> Vec<(String, f64)> {
        corrections::true_amplitudes(&self.corrections, truth, methods)
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err("its corrections of the model depend on the data")
    }

    fn carries_bias_covariance(&self) -> bool {
        true
    }

    fn takes_correlated_errors(&self) -> Result<(), &'static str> {
        if self.factors.iter().any(FactorSettings::has_patterns_of_observations) {
            return Err("factors of observations with patterns have their value where each observation is");
        }
        Ok(())
    }

    fn can_freeze_biases(&self) -> Result<(), &'static str> {
        Err("factors of a time volume would go on changing the biases that [stability] freezes")
    }
}
