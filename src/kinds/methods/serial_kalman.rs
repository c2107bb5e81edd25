//! `kind = "serial_kf"`.

use super::adapt::ADAPT;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, MethodSettings, SMOOTHER_LAG_CYCLES, Setup,
    Sizes, Surroundings, Work,
};
use crate::kinds::Kind;
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "serial_kf",
    "The Kalman filter, one observation at a time: nothing is cubic in their number",
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &ADAPT, &SMOOTHER_LAG_CYCLES, &MEMORY_LIMIT_GB]],
    |_, _| Ok(Box::new(SerialKalman)),
);

#[derive(Debug)]
struct SerialKalman;

impl MethodSettings for SerialKalman {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(setup.smoothed(KalmanFilter::serial, KalmanFilter::smoothing)?))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // A sweep over half of P for each observation, in place of products: it waits for memory.
        let (n, unknowns) = (sizes.observations, sizes.unknowns());
        let numbers = 5.0 * unknowns * unknowns + n;
        let multiplications = 1.5 * unknowns.powi(3) + 4.0 * n * unknowns * unknowns;
        Work { numbers, multiplications, ..Work::dense(sizes) }
    }

    fn describe(&self) -> String {
        "Kalman filter, one observation at a time".into()
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn carries_bias_covariance(&self) -> bool {
        true
    }
}
