//! The list of all methods that are measured.

use crate::common::{PROBES, with_factors};
use crate::experiment::SYSTEMS;
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::climatology::Climatology;
use isobar_assim::ensemble::{
    EnsembleSettings, EnsembleTransformKalmanFilter, LocalEnsembleTransformKalmanFilter, LocalSettings,
    StochasticEnsembleKalmanFilter,
};
use isobar_assim::fast_kalman::{BlockShape, FastKalmanFilter, Precision, Residual};
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedKalmanFilter, FederatedSettings};
use isobar_assim::free::FreeRun;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LeftOver, LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::time_volume::{AmplitudeEvolution, Factor, Target, TimeShape, TimeVolume, TimeVolumeSettings};
use isobar_assim::variational::{
    FourDVar, FourDVarSettings, HybridSettings, HybridThreeDVar, ThreeDVar, ThreeDVarSettings,
};
use isobar_assim::{Assimilator, Error, Problem};
use isobar_model::Time;

type Built = Result<Box<dyn Assimilator>, Error>;

/// A method that is measured.
pub struct Method {
    /// Its kind in a scenario, with whatever distinguishes it from others of that kind.
    pub name: &'static str,
    /// What its size counts, if it has one.
    pub size_of: Option<SizeOf>,
    /// Builds it for a problem; the second argument is its size.
    pub build: fn(Problem, usize) -> Built,
}

/// What the size of a method counts.
#[derive(Clone, Copy, PartialEq)]
pub enum SizeOf {
    Members,
    /// Common factors of the domain beside those of the biases.
    Factors,
    /// Factors of each tile.
    FactorsOfTile,
}

impl SizeOf {
    pub fn name(self) -> &'static str {
        match self {
            SizeOf::Members => "members",
            SizeOf::Factors => "factors",
            SizeOf::FactorsOfTile => "factors per tile",
        }
    }

    /// The size at which a method is measured, unless another is asked for.
    pub fn usual(self) -> usize {
        match self {
            SizeOf::Members => 40,
            SizeOf::Factors => 80,
            SizeOf::FactorsOfTile => 8,
        }
    }
}

const LENGTH_M: f64 = 8e5;
const LOCAL: LocalSettings = LocalSettings { localization_radius_m: 3e6, analysis_spacing_cells: 2 };

/// Columns that a method with this number of common factors propagates.
pub fn propagated(factors: usize) -> usize {
    factors + 2 + PROBES
}

/// Two systems that share the information equally and start anew in every cycle.
fn two_systems() -> FederatedSettings {
    let systems = SYSTEMS.map(|system| (system.to_string(), 0.5)).to_vec();
    FederatedSettings { systems, reset_every_cycles: Some(1) }
}

pub const METHODS: [Method; 17] = [
    Method { name: "free", size_of: None, build: |problem, _| Ok(Box::new(FreeRun::new(problem))) },
    Method { name: "climatology", size_of: None, build: |problem, _| Ok(Box::new(Climatology::new(problem))) },
    Method {
        name: "optimal_interpolation",
        size_of: None,
        build: |problem, _| Ok(Box::new(OptimalInterpolation::new(problem, 1.0)?)),
    },
    Method { name: "3dvar", size_of: None, build: |problem, _| Ok(Box::new(ThreeDVar::new(problem, variational())?)) },
    Method {
        name: "4dvar",
        size_of: None,
        build: |problem, _| {
            let ThreeDVarSettings { covariance_scale, tolerance, max_iterations } = variational();
            let window_cycles = 3;
            let settings =
                FourDVarSettings { window_cycles, covariance_scale, outer_loops: 1, tolerance, max_iterations };
            Ok(Box::new(FourDVar::new(problem, settings)?))
        },
    },
    Method {
        name: "hybrid_3dvar",
        size_of: Some(SizeOf::Members),
        build: |problem, members| {
            let ensemble = EnsembleSettings::new(members, 1.05);
            let settings = HybridSettings { ensemble_weight: 0.9, variational: variational(), ensemble, local: LOCAL };
            Ok(Box::new(HybridThreeDVar::new(problem, settings)?))
        },
    },
    Method {
        name: "etkf",
        size_of: Some(SizeOf::Members),
        build: |problem, members| {
            Ok(Box::new(EnsembleTransformKalmanFilter::new(problem, EnsembleSettings::new(members, 1.05))?))
        },
    },
    Method {
        name: "letkf",
        size_of: Some(SizeOf::Members),
        build: |problem, members| {
            let settings = EnsembleSettings::new(members, 1.05);
            Ok(Box::new(LocalEnsembleTransformKalmanFilter::new(problem, settings, LOCAL)?))
        },
    },
    Method {
        name: "enkf",
        size_of: Some(SizeOf::Members),
        build: |problem, members| {
            let settings = EnsembleSettings::new(members, 1.05);
            Ok(Box::new(StochasticEnsembleKalmanFilter::new(problem, settings, LOCAL.localization_radius_m)?))
        },
    },
    Method { name: "kf", size_of: None, build: |problem, _| Ok(Box::new(KalmanFilter::new(problem)?)) },
    Method { name: "serial_kf", size_of: None, build: |problem, _| Ok(Box::new(KalmanFilter::serial(problem)?)) },
    Method {
        name: "banded_kf",
        size_of: None,
        build: |problem, _| {
            let half_bandwidth = 8 * problem.background.layout().grid.nx;
            Ok(Box::new(BandedKalmanFilter::new(problem, half_bandwidth)?))
        },
    },
    Method {
        name: "federated_kf",
        size_of: None,
        build: |problem, _| Ok(Box::new(FederatedKalmanFilter::new(problem, two_systems())?)),
    },
    Method {
        name: "federated_fkf",
        size_of: Some(SizeOf::Factors),
        build: |problem, factors| {
            let filter = FederatedFastKalmanFilter::of_fast_filters(problem, two_systems(), with_factors(factors))?;
            Ok(Box::new(filter))
        },
    },
    Method {
        name: "fkf",
        size_of: Some(SizeOf::Factors),
        build: |problem, factors| Ok(Box::new(FastKalmanFilter::new(problem, with_factors(factors))?)),
    },
    Method {
        name: "fkf, local factors",
        size_of: Some(SizeOf::FactorsOfTile),
        build: |problem, per_tile| {
            let settings = LocalFactorSettings {
                blocks: BlockShape::Cell,
                per_tile,
                model_error_per_tile: 2 * per_tile,
                tile_m: 2.0 * LENGTH_M,
                support_tiles: 3,
                mixed: 0,
                left_over: LeftOver::Factors,
                factor_precision: Precision::Double,
                largest_component: usize::MAX,
                residual: Residual::Probe { count: PROBES },
            };
            Ok(Box::new(LocalFastKalmanFilter::with_local_factors(problem, settings)?))
        },
    },
    Method {
        name: "time_volume",
        size_of: Some(SizeOf::Factors),
        build: |problem, factors| {
            let constant = Factor {
                name: "sondes".into(),
                target: Target::Observations(vec![0]),
                shape: TimeShape::Constant,
                patterns: Vec::new(),
                evolution: AmplitudeEvolution::Constant { sigma_prior: None },
            };
            let settings = TimeVolumeSettings {
                filter: with_factors(factors),
                cycles: 4,
                keep_before: false,
                factors: vec![constant],
                start: Time::from_seconds(0),
                selection_threshold: 4.0,
            };
            Ok(Box::new(TimeVolume::new(problem, settings, None)?))
        },
    },
];

fn variational() -> ThreeDVarSettings {
    ThreeDVarSettings { covariance_scale: 0.4, tolerance: 1e-4, max_iterations: 100 }
}
