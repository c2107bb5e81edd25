//! `kind = "federated_fkf"`.

use super::adapt::ADAPT;
use super::federated::{self, INFORMATION_SHARING, RESET_EVERY_CYCLES};
use super::{BIAS, MethodSettings, Setup, Surroundings, fast_kalman};
use crate::kinds::Kind;
use crate::kinds::models::Model;
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedSettings};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "federated_fkf",
    "A Fast Kalman Filter for each observing system, and a master that fuses them without a dense covariance",
    &[
        &[&BIAS, &ADAPT, &INFORMATION_SHARING, &RESET_EVERY_CYCLES, &fast_kalman::FACTOR_PRECISION],
        fast_kalman::SHARED_KEYS,
    ],
    |section, surroundings| {
        let division = federated::read(section, surroundings)?;
        Ok(Box::new(FederatedFast { division, fast: fast_kalman::read(section, surroundings)? }))
    },
);

#[derive(Debug)]
struct FederatedFast {
    division: FederatedSettings,
    /// Of each local filter.
    fast: fast_kalman::Settings,
}

impl MethodSettings for FederatedFast {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let division = self.division.clone();
        Ok(Box::new(FederatedFastKalmanFilter::of_fast_filters(setup.problem, division, self.fast.filter)?))
    }

    fn describe(&self) -> String {
        let local = fast_kalman::describe(&self.fast, 1);
        format!("federated Fast Kalman Filter, {}, local filters of {local}", federated::describe(&self.division))
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        self.division.fixed_gain()
    }

    fn warning(&self, model: &Model) -> Option<&'static str> {
        self.division.warning(model)
    }

    fn can_freeze_biases(&self) -> Result<(), &'static str> {
        self.division.can_freeze_biases()
    }
}
