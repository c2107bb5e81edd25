//! `kind = "banded_kf"`.

use super::adapt::ADAPT;
use super::{BIAS, ERROR_CORRELATION, MEMORY_LIMIT_GB, MethodSettings, Setup, Surroundings};
use crate::kinds::Kind;
use crate::reader::{Key, Whole};
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::{Assimilator, Error};

/// More diagonals than any covariance has.
const MOST_DIAGONALS: usize = 1_000_000_000;

const HALF_BANDWIDTH: Key<Whole> = Key::required(
    "half_bandwidth",
    "",
    Whole(0, MOST_DIAGONALS),
    "diagonals of the covariance on either side of the main one",
);

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "banded_kf",
    "The Kalman filter with a banded covariance",
    &[&[&BIAS, &ERROR_CORRELATION, &ADAPT, &HALF_BANDWIDTH, &MEMORY_LIMIT_GB]],
    |section, _| Ok(Box::new(BandedKalman { half_bandwidth: section.get(&HALF_BANDWIDTH)? })),
);

#[derive(Debug)]
struct BandedKalman {
    /// Diagonals on either side of the main one.
    half_bandwidth: usize,
}

impl MethodSettings for BandedKalman {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(BandedKalmanFilter::new(setup.problem, self.half_bandwidth)?))
    }

    fn describe(&self) -> String {
        format!("Kalman filter, {} diagonals on either side of the covariance's main one", self.half_bandwidth)
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn carries_bias_covariance(&self) -> bool {
        true
    }
}
