//! `kind = "etkf"`.

use super::{MethodSettings, SMOOTHER_LAG_CYCLES, Setup, Sizes, Surroundings, Work, ensemble};
use crate::kinds::Kind;
use isobar_assim::ensemble::{EnsembleSettings, EnsembleTransformKalmanFilter};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "etkf",
    "The ensemble transform Kalman filter",
    &[ensemble::KEYS, &[&SMOOTHER_LAG_CYCLES]],
    |section, surroundings| Ok(Box::new(Etkf(ensemble::read_with_smoother(section, surroundings)?))),
);

#[derive(Debug)]
struct Etkf(EnsembleSettings);

impl MethodSettings for Etkf {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let filter = |problem| EnsembleTransformKalmanFilter::new(problem, self.0);
        Ok(Box::new(setup.ensemble(
            filter,
            EnsembleTransformKalmanFilter::smoothing,
            EnsembleTransformKalmanFilter::asynchronous,
        )?))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        Work::ensemble(sizes, self.0.members as f64)
    }

    fn describe(&self) -> String {
        format!("ETKF, {}", ensemble::describe(&self.0))
    }

    fn in_bands(&self) -> bool {
        true
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err(ensemble::RANDOM_GAIN)
    }
}
