//! `kind = "kf"`.

use super::adapt::ADAPT;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, MethodSettings, SMOOTHER_LAG_CYCLES, Setup,
    Sizes, Surroundings, Work,
};
use crate::kinds::Kind;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "kf",
    "The dense (extended) Kalman filter on state and biases",
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &ADAPT, &SMOOTHER_LAG_CYCLES, &MEMORY_LIMIT_GB]],
    |_, _| Ok(Box::new(Kalman)),
);

#[derive(Debug)]
struct Kalman;

impl MethodSettings for Kalman {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(setup.smoothed(KalmanFilter::new, KalmanFilter::smoothing)?))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        Work::dense(sizes)
    }

    fn describe(&self) -> String {
        "Kalman filter".into()
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn carries_bias_covariance(&self) -> bool {
        true
    }
}
