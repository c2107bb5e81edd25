//! `[methods.NAME]`: the data-assimilation methods that run side by side.

use super::adapt::{self, Adapt, StateError};
use super::ensemble_method;
use super::fast_kalman;
use super::federated;
use super::model::ModelSettings;
use super::time_volume::{self, TimeVolumeOptions};
use crate::kinds::check_name;
use crate::reader::{Field, Kind, Limits, Read, Section};
use crate::scores::expected::TOLERANCE_KEY;
use indexmap::IndexMap;
use isobar_assim::BiasTreatment;
use isobar_assim::ensemble::{EnsembleSettings, LocalSettings};
use isobar_assim::fast_kalman::FastKalmanSettings;
use isobar_assim::federated::FederatedSettings;
use isobar_assim::variational::{FourDVarSettings, HybridSettings, ThreeDVarSettings};
use isobar_model::Grid;

/// The most diagonals of a banded covariance: more than any has.
const MOST_DIAGONALS: usize = 1_000_000_000;

/// A method with its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Method {
    /// How it treats the observations' biases.
    pub bias: BiasTreatment,
    /// What it does.
    pub algorithm: Algorithm,
    /// Which errors it estimates from its innovations, if any.
    pub adapt: Option<Adapt>,
}

/// What a method does.
#[derive(Clone, Debug, PartialEq)]
pub enum Algorithm {
    /// A forecast that never sees an observation.
    Free,
    /// The first background for ever.
    Climatology,
    /// Optimal interpolation with a static covariance.
    OptimalInterpolation {
        /// Factor on the covariance B.
        covariance_scale: f64,
    },
    /// Three-dimensional variational assimilation.
    ThreeDVar(ThreeDVarSettings),
    /// Strong-constraint four-dimensional variational assimilation.
    FourDVar(FourDVarSettings),
    /// Three-dimensional variational assimilation with the covariance of an ensemble beside the static one.
    HybridThreeDVar {
        /// Its settings.
        settings: HybridSettings,
        /// Memory that its ensemble may use.
        memory_limit_bytes: u64,
    },
    /// The full Kalman filter (extended, for a nonlinear model).
    Kalman {
        /// The number of later cycles that revise its estimates, if it has a smoother.
        smoother_lag_cycles: Option<usize>,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The same, one observation at a time.
    SerialKalman {
        /// The number of later cycles that revise its estimates, if it has a smoother.
        smoother_lag_cycles: Option<usize>,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The Kalman filter with a banded covariance.
    BandedKalman {
        /// Diagonals of the covariance on either side of the main one.
        half_bandwidth: usize,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// A Kalman filter for each observing system, and their fusion.
    FederatedKalman {
        /// How it is divided.
        settings: FederatedSettings,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// Lange's Fast Kalman Filter.
    FastKalman {
        /// Its settings.
        settings: FastKalmanSettings,
        /// Cells on a side of those on which the factors are propagated: 1 on the grid of the state.
        factor_grid: usize,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The Fast Kalman Filter of a moving time volume.
    TimeVolume {
        /// The filter within each cycle.
        settings: FastKalmanSettings,
        /// What is estimated over the window.
        options: TimeVolumeOptions,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The ensemble transform Kalman filter.
    EnsembleTransform {
        /// Its ensemble.
        settings: EnsembleSettings,
        /// The number of later cycles that revise its estimates, if it has a smoother.
        smoother_lag_cycles: Option<usize>,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The local ensemble transform Kalman filter.
    LocalEnsembleTransform {
        /// Its ensemble.
        settings: EnsembleSettings,
        /// Its localisation.
        local: LocalSettings,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// The stochastic ensemble Kalman filter.
    StochasticEnsemble {
        /// Its ensemble.
        settings: EnsembleSettings,
        /// Distance at which the covariances' taper ends \[m\]; infinite for none.
        localization_radius_m: f64,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
}

impl Algorithm {
    /// Takes the smoother off.
    pub fn without_smoother(mut self) -> Self {
        if let Algorithm::Kalman { smoother_lag_cycles, .. }
        | Algorithm::SerialKalman { smoother_lag_cycles, .. }
        | Algorithm::EnsembleTransform { smoother_lag_cycles, .. } = &mut self
        {
            *smoother_lag_cycles = None;
        }
        self
    }
}

#[derive(Clone, Copy)]
enum Which {
    Free,
    Climatology,
    OptimalInterpolation,
    ThreeDVar,
    FourDVar,
    HybridThreeDVar,
    Kalman,
    SerialKalman,
    FederatedKalman,
    BandedKalman,
    FastKalman,
    TimeVolume,
    EnsembleTransform,
    LocalEnsembleTransform,
    StochasticEnsemble,
}

const KINDS: &[Kind<Which>] = &[
    ("free", Which::Free, &[]),
    ("climatology", Which::Climatology, &[]),
    ("optimal_interpolation", Which::OptimalInterpolation, &["bias", "covariance_scale", "adapt"]),
    ("3dvar", Which::ThreeDVar, &["bias", "adapt", "covariance_scale", "max_iterations", "tolerance"]),
    (
        "4dvar",
        Which::FourDVar,
        &["bias", "window_cycles", "outer_loops", "covariance_scale", "max_iterations", "tolerance"],
    ),
    ("hybrid_3dvar", Which::HybridThreeDVar, &ensemble_method::HYBRID_KEYS),
    ("kf", Which::Kalman, &["bias", "adapt", SMOOTHER_KEY, "memory_limit_gb"]),
    ("serial_kf", Which::SerialKalman, &["bias", "adapt", SMOOTHER_KEY, "memory_limit_gb"]),
    ("banded_kf", Which::BandedKalman, &["bias", "adapt", "half_bandwidth", "memory_limit_gb"]),
    ("federated_kf", Which::FederatedKalman, &federated::KEYS),
    (
        "fkf",
        Which::FastKalman,
        &[
            "bias",
            "adapt",
            "blocks",
            "bias_coupling",
            "factors",
            "factor_grid",
            "factor_precision",
            "residual",
            "probes",
            "largest_component",
            "separator_factors",
            "memory_limit_gb",
        ],
    ),
    (
        "time_volume",
        Which::TimeVolume,
        &[
            "blocks",
            "factors",
            "residual",
            "probes",
            "largest_component",
            "separator_factors",
            "memory_limit_gb",
            time_volume::KEYS[0],
            time_volume::KEYS[1],
            time_volume::KEYS[2],
            time_volume::KEYS[3],
            time_volume::KEYS[4],
            time_volume::KEYS[5],
        ],
    ),
    ("etkf", Which::EnsembleTransform, &ensemble_method::SMOOTHED_KEYS),
    ("letkf", Which::LocalEnsembleTransform, &ensemble_method::LOCAL_KEYS),
    ("enkf", Which::StochasticEnsemble, &ensemble_method::TAPERED_KEYS),
];

/// The key of the lag of a smoother.
pub(super) const SMOOTHER_KEY: &str = "smoother_lag_cycles";

/// The most methods of a scenario.
const MOST_METHODS: usize = 100;

/// What the rest of the scenario says that a method must fit to.
pub(super) struct Surroundings<'a> {
    pub grid: &'a Grid,
    pub model: &'a ModelSettings,
    /// Cycles of the run.
    pub cycles: usize,
    /// Whether biases may be frozen in a run.
    pub freezes: bool,
    /// The names of what observes.
    pub networks: Vec<&'a str>,
    pub has_model_error: bool,
}

/// Reads `[methods]`, in the order of the file.
pub(super) fn read(root: &Section<'_>, surroundings: &Surroundings<'_>) -> Read<IndexMap<String, Method>> {
    let mut methods: IndexMap<String, Method> = IndexMap::new();
    let field = root.required("methods")?;
    for (name, field) in field.any_section()?.fields() {
        check_name(name, &field, "method")?;
        if methods.len() == MOST_METHODS {
            return Err(field.misplaced(format!("there are more than {MOST_METHODS} methods"), "too many"));
        }
        if name == TOLERANCE_KEY {
            return Err(
                field.misplaced(format!("a method cannot be called {name}"), "[expected] has a key of that name")
            );
        }
        // Their files would be one and the same on a file system that does not distinguish case.
        if let Some(other) = methods.keys().find(|other| other.eq_ignore_ascii_case(name)) {
            let message = format!("the methods `{other}` and `{name}` differ in case only");
            return Err(field.misplaced(message, "choose another name"));
        }
        methods.insert(name.to_string(), method(&field, surroundings)?);
    }
    if methods.is_empty() {
        return Err(field.misplaced("[methods] is empty".into(), "add a table such as [methods.fkf]"));
    }
    Ok(methods)
}

fn method(field: &Field<'_>, surroundings: &Surroundings<'_>) -> Read<Method> {
    let &Surroundings { grid, freezes, ref networks, has_model_error, .. } = surroundings;
    const TREATMENTS: &[(&str, BiasTreatment)] =
        &[("estimate", BiasTreatment::Estimate), ("ignore", BiasTreatment::Ignore), ("known", BiasTreatment::Known)];
    let (which, section) = field.section_of_kind(KINDS)?;
    let default =
        if matches!(which, Which::Free | Which::Climatology) { BiasTreatment::Ignore } else { BiasTreatment::Estimate };
    let bias = section.optional("bias").map_or(Ok(default), |field| field.choice(TREATMENTS))?;
    let memory_limit_bytes =
        || Ok((section.number_or("memory_limit_gb", 2.0, Limits::Between(0.001, 10_000.0))? * 1e9) as u64);
    let smoother_lag_cycles =
        || section.optional(SMOOTHER_KEY).map(|field| smoother_lag_cycles(&field, freezes)).transpose();
    let state_error = match which {
        Which::OptimalInterpolation | Which::ThreeDVar => StateError::Background,
        _ => StateError::Model,
    };
    let adapt = adapt::read(&section, state_error, has_model_error)?;
    let algorithm = match which {
        Which::Free => Algorithm::Free,
        Which::Climatology => Algorithm::Climatology,
        Which::OptimalInterpolation => Algorithm::OptimalInterpolation {
            covariance_scale: section.number_or("covariance_scale", 1.0, Limits::Positive)?,
        },
        Which::ThreeDVar => Algorithm::ThreeDVar(three_d_var(&section)?),
        Which::FourDVar => {
            let ThreeDVarSettings { covariance_scale, tolerance, max_iterations } = three_d_var(&section)?;
            Algorithm::FourDVar(FourDVarSettings {
                window_cycles: section.required("window_cycles")?.whole(1, 1000)?,
                outer_loops: section.whole_or("outer_loops", 2, 1, 100)?,
                covariance_scale,
                tolerance,
                max_iterations,
            })
        }
        Which::HybridThreeDVar => Algorithm::HybridThreeDVar {
            settings: HybridSettings {
                ensemble_weight: section.number("ensemble_weight", Limits::Between(0.0, 1.0))?,
                variational: three_d_var(&section)?,
                ensemble: ensemble_method::read(&section)?,
                local: ensemble_method::local(&section)?,
            },
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::Kalman => {
            Algorithm::Kalman { smoother_lag_cycles: smoother_lag_cycles()?, memory_limit_bytes: memory_limit_bytes()? }
        }
        Which::SerialKalman => Algorithm::SerialKalman {
            smoother_lag_cycles: smoother_lag_cycles()?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::FederatedKalman => Algorithm::FederatedKalman {
            settings: federated::read(&section, networks, freezes && bias == BiasTreatment::Estimate)?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::BandedKalman => Algorithm::BandedKalman {
            half_bandwidth: section.required("half_bandwidth")?.whole(0, MOST_DIAGONALS)?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::FastKalman => {
            let settings = fast_kalman::read(&section, surroundings)?;
            let factor_grid = fast_kalman::factor_grid(&section, grid, settings)?;
            Algorithm::FastKalman { settings, factor_grid, memory_limit_bytes: memory_limit_bytes()? }
        }
        Which::TimeVolume => Algorithm::TimeVolume {
            settings: fast_kalman::read(&section, surroundings)?,
            options: time_volume::read(&section, surroundings)?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::EnsembleTransform => Algorithm::EnsembleTransform {
            settings: ensemble_method::read(&section)?,
            smoother_lag_cycles: smoother_lag_cycles()?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::LocalEnsembleTransform => Algorithm::LocalEnsembleTransform {
            settings: ensemble_method::read(&section)?,
            local: ensemble_method::local(&section)?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
        Which::StochasticEnsemble => Algorithm::StochasticEnsemble {
            settings: ensemble_method::read(&section)?,
            localization_radius_m: ensemble_method::optional_radius_m(&section)?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
    };
    Ok(Method { bias, algorithm, adapt })
}

fn smoother_lag_cycles(field: &Field<'_>, freezes: bool) -> Read<usize> {
    if freezes {
        let message = "a smoother would go on adjusting the biases that [stability] freezes".to_string();
        return Err(field.misplaced(message, "leave out this key or `freeze_after_cycles`"));
    }
    field.whole(1, 1000)
}

fn three_d_var(section: &Section<'_>) -> Read<ThreeDVarSettings> {
    Ok(ThreeDVarSettings {
        covariance_scale: section.number_or("covariance_scale", 1.0, Limits::Positive)?,
        max_iterations: section.whole_or("max_iterations", 100, 1, 100_000)?,
        tolerance: section.number_or("tolerance", 1e-6, Limits::Between(1e-15, 0.5))?,
    })
}
