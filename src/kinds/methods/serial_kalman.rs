//! `kind = "serial_kf"`.

use super::adapt::ADAPT;
use super::{BIAS, MEMORY_LIMIT_GB, MethodSettings, SMOOTHER_LAG_CYCLES, Setup, Surroundings};
use crate::kinds::Kind;
use crate::reader::{AnyKey, Read, Section};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, Error};

pub(super) struct SerialKalmanKind;

impl Kind<dyn MethodSettings, Surroundings> for SerialKalmanKind {
    fn name(&self) -> &'static str {
        "serial_kf"
    }

    fn about(&self) -> &'static str {
        "The Kalman filter, one observation at a time: nothing is cubic in their number"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        vec![&BIAS, &ADAPT, &SMOOTHER_LAG_CYCLES, &MEMORY_LIMIT_GB]
    }

    fn read(&self, _: &Section<'_>, _: &Surroundings) -> Read<Box<dyn MethodSettings>> {
        Ok(Box::new(SerialKalman))
    }
}

#[derive(Debug)]
struct SerialKalman;

impl MethodSettings for SerialKalman {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(setup.smoothed(KalmanFilter::serial, KalmanFilter::smoothing)?))
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
