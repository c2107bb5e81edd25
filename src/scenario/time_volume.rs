//! `kind = "time_volume"`: the Fast Kalman Filter over a moving window, with factors and state-transition corrections.

use super::method::Surroundings;
use super::model::{Dynamics, ModelSettings, Wind};
use crate::reader::fields;
use crate::reader::{Field, Kind, Limits, Read, Section};
use crate::text::{clean, listed};
use isobar_assim::time_volume::{AmplitudeEvolution, TimeShape};
use isobar_model::{Boundary, Duration, Grid};

/// What is estimated over a moving window of cycles.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeVolumeOptions {
    /// Cycles of the window.
    pub window_cycles: usize,
    /// Whether what older cycles have said is kept.
    pub keep_before: bool,
    /// Factors of the errors of observations and of the model.
    pub factors: Vec<FactorSettings>,
    /// The model's parameters that may be wrong.
    pub corrections: Vec<CorrectionSettings>,
    /// How much a correction's column must correlate with the innovations, in standard deviations of chance.
    pub selection_threshold: f64,
}

/// A factor.
#[derive(Clone, Debug, PartialEq)]
pub struct FactorSettings {
    /// Its name.
    pub name: String,
    /// What it acts on.
    pub target: FactorTarget,
    /// How it depends on time.
    pub shape: TimeShape,
    /// How it depends on place: fields `[y, x]`; none for the same everywhere.
    pub patterns: Vec<Vec<f64>>,
    /// How its amplitudes behave.
    pub evolution: AmplitudeEvolution,
}

/// What a factor acts on.
#[derive(Clone, Debug, PartialEq)]
pub enum FactorTarget {
    /// The biases with these names, or whose names begin with them up to a `/`.
    Biases(Vec<String>),
    /// The forecast of the variable of this number.
    Variable(usize),
}

/// A parameter of the model that may be wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionSettings {
    /// Which.
    pub candidate: Correction,
    /// Standard deviation of a prior, in the parameter's unit.
    pub sigma: Option<f64>,
}

/// The parameters of models that can be corrected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correction {
    /// The eastward speed with which the model advects.
    AdvectionX,
    /// The northward speed.
    AdvectionY,
    /// The depth about which the equations are linearised.
    MeanDepth,
    /// Gravity, and with it the speed of gravity waves.
    Gravity,
    /// The linear drag.
    Drag,
    /// The Coriolis parameter.
    Coriolis,
}

/// The keys that a time volume has beside those of the filter.
pub(super) const KEYS: [&str; 6] = [
    "window_cycles",
    "before_window",
    "observation_factors",
    "model_factors",
    "transition_corrections",
    "selection_threshold",
];

/// The most factors of a method, and the most amplitudes of a factor.
const MOST: usize = 100;

pub(super) fn read(section: &Section<'_>, surroundings: &Surroundings<'_>) -> Read<TimeVolumeOptions> {
    let &Surroundings { grid, model, cycles, freezes, .. } = surroundings;
    if freezes {
        let message = "factors of a time volume would go on changing the biases that [stability] freezes".to_string();
        let label = "choose another kind of method, or leave out `freeze_after_cycles`";
        return Err(section.required("kind")?.misplaced(message, label));
    }
    let window = section.required("window_cycles")?;
    let window_cycles = window.whole(1, 1_000_000)?;
    if window_cycles > cycles {
        let message = format!("a window of {window_cycles} cycles is longer than the run of {cycles}");
        return Err(window.invalid(message, &format!("must be from 1 to {cycles}, that is cycle.count")));
    }
    let before = section.optional("before_window");
    let keep_before = before.map_or(Ok(false), |field| field.choice(&[("forget", false), ("keep", true)]))?;
    let mut factors: Vec<FactorSettings> = Vec::new();
    for key in ["observation_factors", "model_factors"] {
        for field in section.optional(key).map_or(Ok(Vec::new()), |field| field.elements(MOST))? {
            let factor = factor(&field, key == "model_factors", grid, model)?;
            if factors.iter().any(|other| other.name == factor.name) {
                let message = format!("there are two factors `{}`", clean(&factor.name));
                return Err(field.invalid(message, "each needs a name of its own"));
            }
            factors.push(factor);
        }
    }
    let mut corrections: Vec<CorrectionSettings> = Vec::new();
    for field in section.optional("transition_corrections").map_or(Ok(Vec::new()), |field| field.elements(6))? {
        let correction = correction(&field, grid, model)?;
        if corrections.iter().any(|other| other.candidate == correction.candidate) {
            return Err(field.invalid(format!("`{}` is a candidate already", field.title()), "already in the list"));
        }
        corrections.push(correction);
    }
    if factors.is_empty() && corrections.is_empty() {
        let message = format!("[{}] has nothing to estimate over its window", section.title());
        let label = "give `observation_factors`, `model_factors` or `transition_corrections`";
        return Err(section.file.error(section.span.clone(), message, label, None));
    }
    let selection_threshold = section.number_or("selection_threshold", 4.0, Limits::Between(0.1, 100.0))?;
    Ok(TimeVolumeOptions { window_cycles, keep_before, factors, corrections, selection_threshold })
}

#[derive(Clone, Copy)]
enum Shape {
    Constant,
    Sinusoid,
    Square,
    Hats,
}

macro_rules! factor_keys {
    ($($more:literal),*) => {
        &["name", "biases", "variable", "patterns_file", "sigma", "drift_per_sqrt_day", "correlation_hours", $($more),*]
    };
}

const SHAPES: &[Kind<Shape>] = &[
    ("constant", Shape::Constant, factor_keys!()),
    ("sinusoid", Shape::Sinusoid, factor_keys!("period_hours")),
    ("square_wave", Shape::Square, factor_keys!("period_hours")),
    ("hats", Shape::Hats, factor_keys!("period_hours", "count")),
];

fn factor(field: &Field<'_>, of_model: bool, grid: &Grid, model: &ModelSettings) -> Read<FactorSettings> {
    let (kind, section) = field.section_of_kind(SHAPES)?;
    let name = section.required("name")?.text()?;
    let (own, other) = if of_model { ("variable", "biases") } else { ("biases", "variable") };
    if let Some(misplaced) = section.optional(other) {
        let message = format!("`{}` does not belong to this factor", misplaced.title());
        return Err(misplaced.misplaced(message, &format!("it acts on `{own}`")));
    }
    let target = section.required(own)?;
    let target = match of_model {
        true => {
            let variables: Vec<(&str, usize)> =
                model.variables().iter().enumerate().map(|(number, variable)| (variable.0, number)).collect();
            FactorTarget::Variable(target.choice(&variables)?)
        }
        false => {
            let names = target.texts(MOST)?;
            if names.is_empty() {
                return Err(target.invalid(format!("`{}` is empty", target.title()), "must name a bias at least"));
            }
            FactorTarget::Biases(names)
        }
    };
    let period = || -> Read<Duration> {
        let hours = section.number("period_hours", Limits::Between(0.01, 1e6))?;
        Ok(Duration::from_seconds((hours * 3600.0).round() as i64))
    };
    let shape = match kind {
        Shape::Constant => TimeShape::Constant,
        Shape::Sinusoid => TimeShape::Sinusoid { period: period()? },
        Shape::Square => TimeShape::SquareWave { period: period()? },
        Shape::Hats => TimeShape::Hats { period: period()?, count: section.required("count")?.whole(2, MOST)? },
    };
    let patterns = section.optional("patterns_file").map(|field| fields::read(&field, grid, MOST)).transpose()?;
    let patterns = patterns.map_or(Vec::new(), |fields| fields.columns);
    Ok(FactorSettings { name, target, shape, patterns, evolution: evolution(&section)? })
}

fn evolution(section: &Section<'_>) -> Read<AmplitudeEvolution> {
    let sigma = section.optional("sigma").map(|field| field.number(Limits::Positive)).transpose()?;
    let needs_sigma = |field: &Field<'_>| {
        sigma.ok_or_else(|| {
            let message = format!("amplitudes with `{}` need a prior", field.title());
            field.misplaced(message, "give `sigma`, their standard deviation at the start, as well")
        })
    };
    match (section.optional("drift_per_sqrt_day"), section.optional("correlation_hours")) {
        (None, None) => Ok(AmplitudeEvolution::Constant { sigma_prior: sigma }),
        (Some(drift), None) => Ok(AmplitudeEvolution::RandomWalk {
            sigma_prior: needs_sigma(&drift)?,
            sigma_per_sqrt_day: drift.number(Limits::NonNegative)?,
        }),
        (None, Some(hours)) => {
            let seconds = 3600.0 * hours.number(Limits::Between(0.01, 1e6))?;
            let correlation_time = Duration::from_seconds(seconds.round() as i64);
            Ok(AmplitudeEvolution::FirstOrder { sigma: needs_sigma(&hours)?, correlation_time })
        }
        (Some(_), Some(hours)) => {
            let message = format!("`{}` stands beside `drift_per_sqrt_day`", hours.title());
            Err(hours.misplaced(message, "amplitudes are a random walk or an AR(1) process, not both"))
        }
    }
}

fn correction(field: &Field<'_>, grid: &Grid, model: &ModelSettings) -> Read<CorrectionSettings> {
    let section = field.section(&["candidate", "sigma"])?;
    let all = [
        ("advection_x_m_per_s", Correction::AdvectionX),
        ("advection_y_m_per_s", Correction::AdvectionY),
        ("mean_depth_m", Correction::MeanDepth),
        ("gravity_m_per_s2", Correction::Gravity),
        ("drag_per_s", Correction::Drag),
        ("coriolis_per_s", Correction::Coriolis),
    ];
    let walls = grid.boundary == Boundary::Channel;
    let is_there = |correction: Correction| match (&model.dynamics, correction) {
        (Dynamics::LinearShallowWater { .. }, Correction::AdvectionY) => !walls,
        (Dynamics::LinearShallowWater { .. }, _) => true,
        (Dynamics::ShallowWater(_), _) => {
            matches!(correction, Correction::Gravity | Correction::Drag | Correction::Coriolis)
        }
        (Dynamics::Advection { wind: Wind::Uniform { .. }, .. }, Correction::AdvectionX) => true,
        (Dynamics::Advection { wind: Wind::Uniform { .. }, .. }, Correction::AdvectionY) => !walls,
        _ => false,
    };
    let candidate_field = section.required("candidate")?;
    let candidate = candidate_field.choice(&all)?;
    if !is_there(candidate) {
        let possible = all.iter().filter(|it| is_there(it.1)).map(|it| it.0);
        let message = format!("`{}` is no parameter of this model on this domain", candidate_field.title());
        return Err(candidate_field.invalid(message, &format!("possible here: {}", listed(possible))));
    }
    let sigma = section.optional("sigma").map(|field| field.number(Limits::Positive)).transpose()?;
    Ok(CorrectionSettings { candidate, sigma })
}
