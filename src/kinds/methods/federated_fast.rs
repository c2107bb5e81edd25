//! `kind = "federated_fkf"`.

use super::adapt::ADAPT;
use super::federated::{self, INFORMATION_SHARING, RESET_EVERY_CYCLES};
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MethodSettings, Setup, Sizes, Surroundings, Work, fast_kalman,
};
use crate::kinds::Kind;
use crate::kinds::models::Model;
use isobar_assim::federated::{FederatedFastKalmanFilter, FederatedSettings};
use isobar_assim::{Assimilator, Error};

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "federated_fkf",
    "A Fast Kalman Filter for each observing system, and a master that fuses them without a dense covariance",
    &[
        &[
            &BIAS,
            &ERROR_CORRELATION,
            &FIRST_GUESS,
            &COMPARISONS,
            &ADAPT,
            &INFORMATION_SHARING,
            &RESET_EVERY_CYCLES,
            &fast_kalman::FACTOR_PRECISION,
        ],
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

    fn work(&self, sizes: &Sizes) -> Work {
        let systems = self.division.systems.len() as f64;
        // Each bias, and each observation, is of one system.
        let own = Sizes {
            biases: sizes.biases / systems,
            shared_biases: sizes.shared_biases / systems,
            observations: sizes.observations / systems,
            ..sizes.clone()
        };
        let one = fast_kalman::work(&self.fast, 1, &own);
        let local = Work {
            numbers: systems * one.numbers,
            steps: systems * one.steps,
            tangent_steps: systems * one.tangent_steps,
            multiplications: systems * one.multiplications,
            ..one
        };
        if systems == 1.0 {
            return local;
        }
        // The master has the factors of all, twice more while they are fused; its blocks are factored with them.
        let Sizes { values: m, shared_biases: p, variables, .. } = *sizes;
        let (nx, ny) = self.fast.filter.blocks.cells(&sizes.grid);
        let block = (nx * ny) as f64 * variables;
        let columns = systems * self.fast.filter.factors as f64 + p;
        // Forecast and analysis are fused: the triangle of the border, its inverse applied to all rows, and the blocks of each
        // pair of estimates; what is divided is compressed, and the factors that are left are whitened by the blocks.
        let fusion = 3.0 * m * columns * columns + 3.0 * m * block * (columns + block) + columns.powi(3);
        let division = 2.0 * m * columns * columns + m * block * columns + 10.0 * columns.powi(3);
        local.and(Work {
            numbers: fast_kalman::width(self.fast.filter.factor_precision) * 3.0 * m * columns
                + 6.0 * m * block
                + 8.0 * columns * columns,
            multiplications: 2.0 * fusion + division,
            ..Work::default()
        })
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

    fn takes_comparisons(&self) -> Result<(), &'static str> {
        self.division.takes_comparisons()
    }

    fn can_freeze_biases(&self) -> Result<(), &'static str> {
        self.division.can_freeze_biases()
    }
}
