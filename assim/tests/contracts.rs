//! The contract battery over every method, and over broken ones.

use crate::common::*;
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::climatology::Climatology;
use isobar_assim::ensemble::{
    BackgroundInflation, EnsembleSettings, EnsembleTransformKalmanFilter, Inflation,
    LocalEnsembleTransformKalmanFilter, LocalSettings, ModelErrorTreatment, StochasticEnsembleKalmanFilter,
};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedKalmanFilter, FederatedSettings};
use isobar_assim::free::FreeRun;
use isobar_assim::high_pass::HighPassSettings;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::testing::{AssimilatorContract, Trial, check_assimilator};
use isobar_assim::time_volume::{Target, TimeShape, TimeVolume};
use isobar_assim::variational::{
    FourDVar, FourDVarSettings, HybridSettings, HybridThreeDVar, ThreeDVar, ThreeDVarSettings,
};
use isobar_assim::{
    AdaptedCovariance, Adaptive, AdaptiveSettings, Analysis, Assimilator, Background, BiasTreatment, Calibrated, Error,
    Initialised, Problem, SensorKnowledge, Views,
};
use isobar_model::{Duration, Time};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};
use std::sync::Arc;

fn trial(
    problem: &Problem,
    build: &dyn Fn() -> Box<dyn Assimilator>,
    perturbs_observations: bool,
) -> AssimilatorContract {
    let observed: Vec<ObservationWindow> = (1..=4).map(|cycle| window(problem, 14, false, cycle, 5)).collect();
    check_assimilator(&Trial { build, window: WINDOW, observed: &observed, perturbs_observations })
}

const LOCAL: LocalSettings = LocalSettings { localization_radius_m: 3.0, analysis_spacing_cells: 1 };

fn adaptive(method: Box<dyn Assimilator>, problem: &Problem) -> Adaptive {
    let covariance = Arc::clone(problem.model_error.as_ref().unwrap());
    let settings = AdaptiveSettings {
        observation_error: true,
        state_error: Some(AdaptedCovariance { name: "model_error", covariance, scale: 1.0 }),
        memory_cycles: 10,
    };
    Adaptive::new(method, problem.background.layout().clone(), settings).unwrap()
}

/// Builds a method.
pub type Build<'a> = Box<dyn Fn() -> Box<dyn Assimilator> + 'a>;

/// A method of every kind that is built from a problem.
pub fn all(problem: &Problem) -> Vec<(&'static str, Build<'_>)> {
    let own = || problem.clone();
    let inflation = Inflation {
        background: BackgroundInflation::Factor(1.1),
        relaxation_to_prior_perturbations: 0.1,
        relaxation_to_prior_spread: 0.2,
    };
    let members = EnsembleSettings { inflation, ..ensemble_settings(16) };
    let drawn = EnsembleSettings { model_error: ModelErrorTreatment::Random, ..members };
    let exact = settings(BlockShape::Cell, BiasCoupling::Carry);
    let probed = FastKalmanSettings { residual: Residual::Probe { count: 3 }, factors: 5, ..exact };
    let single = FastKalmanSettings { factor_precision: Precision::Single, ..probed };
    let cut = FastKalmanSettings { largest_component: 6, separator_factors: 60, ..probed };
    let tiles = tile_settings();
    let nested = FastKalmanSettings { largest_component: 6, separator_factors: 0, ..probed };
    let variational = ThreeDVarSettings { covariance_scale: 0.7, tolerance: 1e-12, max_iterations: 300 };
    let four = FourDVarSettings {
        window_cycles: 2,
        covariance_scale: 1.0,
        outer_loops: 1,
        tolerance: 1e-12,
        max_iterations: 300,
    };
    let hybrid =
        HybridSettings { ensemble_weight: 0.5, variational: variational.clone(), ensemble: members, local: LOCAL };
    let one_system = FederatedSettings { systems: vec![("n".into(), 1.0)], reset_every_cycles: Some(1) };
    let system = one_system.clone();
    let named = || {
        let mut problem = problem.clone();
        problem.calibration.parameters.iter_mut().for_each(|it| it.name = format!("n/{}", it.name));
        problem
    };
    vec![
        ("free", Box::new(move || Box::new(FreeRun::new(own())))),
        ("climatology", Box::new(move || Box::new(Climatology::new(own())))),
        ("oi", Box::new(move || Box::new(OptimalInterpolation::new(own(), 0.7).unwrap()))),
        ("3dvar", Box::new(move || Box::new(ThreeDVar::new(own(), variational.clone()).unwrap()))),
        ("hybrid", Box::new(move || Box::new(HybridThreeDVar::new(own(), hybrid.clone()).unwrap()))),
        ("4dvar", Box::new(move || Box::new(FourDVar::new(own(), four.clone()).unwrap()))),
        ("kf", Box::new(move || Box::new(KalmanFilter::new(own()).unwrap()))),
        ("kf with a smoother", Box::new(move || Box::new(KalmanFilter::new(own()).unwrap().smoothing(2).unwrap()))),
        ("serial", Box::new(move || Box::new(KalmanFilter::serial(own()).unwrap()))),
        ("banded", Box::new(move || Box::new(BandedKalmanFilter::new(own(), 11).unwrap()))),
        ("federated", Box::new(move || Box::new(FederatedKalmanFilter::new(named(), one_system.clone()).unwrap()))),
        (
            "federated fkf",
            Box::new(move || {
                Box::new(FederatedFastKalmanFilter::of_fast_filters(named(), system.clone(), probed).unwrap())
            }),
        ),
        ("fkf", Box::new(move || Box::new(FastKalmanFilter::new(own(), exact).unwrap()))),
        ("fkf with probes", Box::new(move || Box::new(FastKalmanFilter::new(own(), probed).unwrap()))),
        (
            "fkf with a smoother",
            Box::new(move || Box::new(FastKalmanFilter::new(own(), probed).unwrap().smoothing(2).unwrap())),
        ),
        ("fkf in single precision", Box::new(move || Box::new(FastKalmanFilter::new(own(), single).unwrap()))),
        ("fkf with separators", Box::new(move || Box::new(FastKalmanFilter::new(own(), cut).unwrap()))),
        (
            "fkf with local factors",
            Box::new(move || Box::new(LocalFastKalmanFilter::with_local_factors(own(), tiles).unwrap())),
        ),
        (
            "fkf with local factors in single precision and a smoother",
            Box::new(move || {
                let tiles = LocalFactorSettings { factor_precision: Precision::Single, ..tiles };
                let filter = LocalFastKalmanFilter::with_local_factors(own(), tiles).unwrap();
                Box::new(filter.smoothing(2).unwrap())
            }),
        ),
        ("fkf, nested", Box::new(move || Box::new(FastKalmanFilter::new(own(), nested).unwrap()))),
        ("etkf", Box::new(move || Box::new(EnsembleTransformKalmanFilter::new(own(), members).unwrap()))),
        (
            "etkf with a smoother",
            Box::new(move || Box::new(EnsembleTransformKalmanFilter::new(own(), drawn).unwrap().smoothing(2).unwrap())),
        ),
        ("letkf", Box::new(move || Box::new(LocalEnsembleTransformKalmanFilter::new(own(), members, LOCAL).unwrap()))),
        ("enkf", Box::new(move || Box::new(StochasticEnsembleKalmanFilter::new(own(), members, 3.0).unwrap()))),
        ("adaptive", Box::new(move || Box::new(adaptive(Box::new(KalmanFilter::new(own()).unwrap()), problem)))),
    ]
}

#[test]
fn every_method_keeps_the_contract() {
    for bias in [BiasTreatment::Estimate, BiasTreatment::Ignore] {
        let problem = Problem { bias, ..problem(true, calibration(2, 1, 0.7), 2) };
        for (name, build) in all(&problem) {
            println!("{name}: {:?}", trial(&problem, &*build, name == "enkf"));
        }
    }
}

#[test]
fn methods_about_a_bias_keep_the_contract() {
    let problem = problem(true, calibration(2, 1, 0.7), 2);
    let volume = || -> Box<dyn Assimilator> {
        let target = Target::Observations(vec![0]);
        let factors = vec![factor("day", target, TimeShape::Sinusoid { period: DAY }, constant(Some(1.0)))];
        Box::new(TimeVolume::new(problem.clone(), volume_settings(3, factors), None).unwrap())
    };
    trial(&problem, &volume, false);
    let kalman = || Box::new(KalmanFilter::new(problem.clone()).unwrap());
    let knowledge = SensorKnowledge { mean: vec![1.0, -2.0, 0.5], recalibrations: Vec::new() };
    let calibrated = || -> Box<dyn Assimilator> {
        Box::new(Calibrated::new(kalman(), &problem.calibration, Time::from_seconds(0), knowledge.clone()))
    };
    trial(&problem, &calibrated, false);
    let batch = HighPassSettings { cycles: 3, box_m: 3.0, covariance_scale: 1.0 };
    let initialised =
        || -> Box<dyn Assimilator> { Box::new(Initialised::new(kalman(), problem.clone(), batch).unwrap()) };
    trial(&problem, &initialised, false);
}

/// What is wrong with a method.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    Nothing,
    /// The second of two methods does something else.
    NotRepeatable,
    /// It drifts without observations.
    MovesByItself,
    /// The first observation counts twice.
    OrderMatters,
    /// A cycle is counted that the memory does not hold.
    Forgets,
    /// A claim that is not that of its covariance.
    ClaimsTooMuch,
    /// Its result is not finite.
    NotFinite,
}

#[derive(Clone)]
struct Broken {
    method: KalmanFilter,
    fault: Fault,
    /// Analyses so far.
    analyses: usize,
    /// Which of the methods that have been built it is.
    number: usize,
}

impl Assimilator for Broken {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        let mut background = self.method.forecast(window)?;
        if self.fault == Fault::NotRepeatable {
            background.estimate.state.values_mut()[7] += 1e-15 * self.number as f64;
        }
        Ok(background)
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let mut observed = observed.clone();
        if self.fault == Fault::OrderMatters && !observed.is_empty() {
            observed.sigma[0] *= 0.7;
        }
        let mut analysis = self.method.analyse(from, &observed)?;
        self.analyses += 1;
        let state = analysis.estimate.state.values_mut();
        match self.fault {
            Fault::MovesByItself => state.iter_mut().for_each(|value| *value += 0.01),
            Fault::Forgets => state[3] += 1e-9 * self.analyses as f64,
            Fault::ClaimsTooMuch => analysis.estimate.state_spread.as_mut().unwrap()[0] *= 0.99,
            Fault::NotFinite => state[3] = f64::NAN,
            _ => {}
        }
        Ok(analysis)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        self.method.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        self.method.recall(from)
    }

    fn can(&self) -> Views<'_> {
        self.method.can()
    }
}

#[test]
fn the_battery_catches_what_is_wrong() {
    let passes = |fault: Fault| {
        std::panic::catch_unwind(|| {
            let problem = problem(true, calibration(2, 1, 0.7), 2);
            let built = std::cell::Cell::new(0);
            let build = || -> Box<dyn Assimilator> {
                built.set(built.get() + 1);
                let method = KalmanFilter::new(problem.clone()).unwrap();
                Box::new(Broken { method, fault, analyses: 0, number: built.get() })
            };
            trial(&problem, &build, false)
        })
        .is_ok()
    };
    assert!(passes(Fault::Nothing));
    assert!(!passes(Fault::NotRepeatable), "other bits the second time");
    assert!(!passes(Fault::MovesByItself), "an empty window that changes the estimate");
    assert!(!passes(Fault::OrderMatters), "the order of the observations");
    assert!(!passes(Fault::Forgets), "a memory that is not whole");
    assert!(!passes(Fault::ClaimsTooMuch), "a spread that is not that of the covariance");
    assert!(!passes(Fault::NotFinite), "a value that is not finite");
}
