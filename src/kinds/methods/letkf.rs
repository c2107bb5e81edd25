//! `kind = "letkf"`.

use super::{MethodSettings, SMOOTHER_LAG_CYCLES, Setup, Sizes, Surroundings, Work, ensemble};
use crate::kinds::Kind;
use isobar_assim::ensemble::{EnsembleSettings, LocalEnsembleTransformKalmanFilter, LocalSettings};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "letkf",
    "The local ensemble transform Kalman filter, with R-localisation",
    &[ensemble::KEYS, ensemble::LOCAL_KEYS, &[&SMOOTHER_LAG_CYCLES]],
    |section, surroundings| {
        let ensemble = ensemble::read_with_smoother(section, surroundings)?;
        Ok(Box::new(Letkf { ensemble, local: ensemble::read_local(section)? }))
    },
);

#[derive(Debug)]
struct Letkf {
    ensemble: EnsembleSettings,
    local: LocalSettings,
}

impl MethodSettings for Letkf {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let filter = |problem| LocalEnsembleTransformKalmanFilter::new(problem, self.ensemble, self.local);
        Ok(Box::new(setup.ensemble(
            filter,
            LocalEnsembleTransformKalmanFilter::smoothing,
            LocalEnsembleTransformKalmanFilter::asynchronous,
        )?))
    }

    fn takes_comparisons(&self) -> Result<(), &'static str> {
        Err("its analyses are of places, and a comparison has none")
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // An analysis in ensemble space about every point for which weights are computed, of the observations around it.
        let members = self.ensemble.members as f64;
        let radius_m = self.local.localization_radius_m;
        let share =
            (std::f64::consts::PI * radius_m * radius_m / (sizes.grid.width_m() * sizes.grid.height_m())).min(1.0);
        let points = sizes.grid.cells() as f64 / (self.local.analysis_spacing_cells as f64).powi(2);
        let near = share * sizes.observations;
        let local = points * (near * members * members + 10.0 * members.powi(3));
        let ensemble = Work::ensemble(sizes, members);
        Work { multiplications: ensemble.multiplications + local, ..ensemble }
    }

    fn describe(&self) -> String {
        let radius_km = self.local.localization_radius_m / 1e3;
        format!("LETKF, localised within {radius_km} km, {}", ensemble::describe(&self.ensemble))
    }

    fn in_bands(&self) -> bool {
        true
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err(ensemble::RANDOM_GAIN)
    }
}
