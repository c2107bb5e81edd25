//! `kind = "banded_kf"`.

use super::adapt::ADAPT;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, MethodSettings, Setup, Sizes, Surroundings,
    Work,
};
use crate::kinds::Kind;
use crate::reader::{Key, Whole};
use isobar_assim::banded::BandedKalmanFilter;
use isobar_assim::{Assimilator, Error};

/// More diagonals than any covariance has.
const MOST_DIAGONALS: usize = 1_000_000_000;

/// Values of each row that columns on their way through the model take.
const BATCH: f64 = 256.0;

const HALF_BANDWIDTH: Key<Whole> = Key::required(
    "half_bandwidth",
    "",
    Whole(0, MOST_DIAGONALS),
    "diagonals of the covariance on either side of the main one",
);

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "banded_kf",
    "The Kalman filter with a banded covariance",
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &ADAPT, &HALF_BANDWIDTH, &MEMORY_LIMIT_GB]],
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

    fn work(&self, sizes: &Sizes) -> Work {
        // L, Q and the next L, and a batch of columns; every column of L goes through the tangent-linear model.
        let Sizes { values: m, biases: p, observations: n, .. } = *sizes;
        let width = (self.half_bandwidth as f64 + 1.0).min(m);
        let numbers = (3.0 * width + BATCH) * m + 4.0 * m * p + 5.0 * p * p + n * (p + width);
        let multiplications = m * width * (2.0 * width + p) + n * width * (width + p);
        Work { numbers, multiplications, tangent_steps: (m + p) * sizes.steps, ..Work::forecast(sizes) }
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
