//! `kind = "enkf"`.

use super::{MethodSettings, SMOOTHER_LAG_CYCLES, Setup, Sizes, Surroundings, Work, ensemble};
use crate::kinds::Kind;
use isobar_assim::ensemble::{EnsembleSettings, StochasticEnsembleKalmanFilter};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "enkf",
    "The stochastic ensemble Kalman filter, with tapered covariances",
    &[ensemble::KEYS, &[&ensemble::OPTIONAL_RADIUS_KM, &SMOOTHER_LAG_CYCLES]],
    |section, surroundings| {
        let radius_km = section.find(&ensemble::OPTIONAL_RADIUS_KM)?;
        let localization_radius_m = radius_km.map_or(f64::INFINITY, |km| km * 1e3);
        Ok(Box::new(Enkf { ensemble: ensemble::read_with_smoother(section, surroundings)?, localization_radius_m }))
    },
);

#[derive(Debug)]
struct Enkf {
    ensemble: EnsembleSettings,
    /// Distance at which the covariances' taper ends \[m\]; infinite without localisation.
    localization_radius_m: f64,
}

impl MethodSettings for Enkf {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let filter = |problem| StochasticEnsembleKalmanFilter::new(problem, self.ensemble, self.localization_radius_m);
        Ok(Box::new(setup.ensemble(
            filter,
            StochasticEnsembleKalmanFilter::smoothing,
            StochasticEnsembleKalmanFilter::asynchronous,
        )?))
    }

    fn takes_comparisons(&self) -> Result<(), &'static str> {
        Err("what observations say is cut off with distance, and a comparison has no place")
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // P Hᵀ and H P Hᵀ + R of the members' perturbations, tapered, and the solution.
        let (n, members) = (sizes.observations, self.ensemble.members as f64);
        let ensemble = Work::ensemble(sizes, members);
        let multiplications = n * members * (n + 2.0 * sizes.unknowns()) + n.powi(3) / 3.0;
        Work { numbers: ensemble.numbers + 2.0 * n * n, multiplications, ..ensemble }
    }

    fn describe(&self) -> String {
        let localization = if self.localization_radius_m.is_finite() {
            format!("localised within {} km", self.localization_radius_m / 1e3)
        } else {
            "not localised".to_string()
        };
        format!("stochastic EnKF, {localization}, {}", ensemble::describe(&self.ensemble))
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err(ensemble::RANDOM_GAIN)
    }
}
