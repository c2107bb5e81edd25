//! The federated filter of Fast Kalman Filters.

use super::{FederatedFastKalmanFilter, FederatedSettings, Filters, Fusible, Part, biases_of_systems, filters};
use crate::error::Error;
use crate::errors::blocks::{BlockErrors, FastKalmanFilter, FastKalmanSettings, divide, fuse};
use crate::filter::{Belief, Errors};
use crate::problem::{Innovations, Problem};
use faer::Mat;
use isobar_model::TangentLinear;
use isobar_obs::Placement;

impl FederatedFastKalmanFilter {
    /// A filter that starts from the background, each of its local filters with these settings.
    ///
    /// # Errors
    /// As [`FederatedKalmanFilter::new`](super::FederatedKalmanFilter::new) and [`FastKalmanFilter::new`].
    pub fn of_fast_filters(
        problem: impl Into<Problem<dyn TangentLinear>>,
        settings: FederatedSettings,
        fast: FastKalmanSettings,
    ) -> Result<Self, Error> {
        let mut problem = problem.into();
        settings.check()?;
        let FederatedSettings { systems, reset_every_cycles } = settings;
        biases_of_systems(&problem.calibration, &systems)?;
        // A single filter has nothing to fuse, and keeps local biases in their blocks.
        if systems.len() > 1 {
            let parameters = problem.calibration.parameters.iter_mut();
            parameters.for_each(|parameter| parameter.placement = Placement::Shared);
        }
        BlockErrors::require_memory_of_federation(&problem, &fast, systems.len())?;
        let build = |Part { problem, factor }| {
            let mut filter = FastKalmanFilter::new(problem, fast)?;
            filter.belief.errors.inflate(factor);
            Ok(filter)
        };
        Ok(Self::of(filters(&problem, &systems, build)?, reset_every_cycles))
    }

    /// The fused covariance of the errors of (x, c), `[m + p, m + p]`, for tests and queries on small problems.
    pub fn dense_covariance(&self) -> Mat<f64> {
        self.filters.master.dense_covariance()
    }
}

impl Fusible for BlockErrors {
    fn fuse(filters: &mut Filters<Self>) -> Result<(), Error> {
        let Filters { master, local } = filters;
        let local: Vec<(&Belief<Self>, &[usize])> =
            local.iter().map(|local| (&local.filter.belief, local.parameters.as_slice())).collect();
        fuse(&mut master.belief, &local)
    }

    fn divide(filters: &mut Filters<Self>) -> Result<(), Error> {
        let Filters { master, local } = filters;
        let mut local: Vec<(&mut Belief<Self>, f64, &[usize])> = local
            .iter_mut()
            .map(|local| (&mut local.filter.belief, local.share, local.parameters.as_slice()))
            .collect();
        divide(&master.belief, &mut local)
    }

    /// By an analysis that is not kept.
    fn normalised_square(master: &FastKalmanFilter, innovations: &Innovations) -> Result<f64, Error> {
        let Belief { s, errors } = &mut master.belief.clone();
        Ok(errors.analyse(s, innovations)?.chi2)
    }

    fn require_memory_of(filters: &Filters<Self>, observations: usize) -> Result<(), Error> {
        let Filters { master, local } = filters;
        let limit_bytes = master.problem.memory_limit_bytes;
        let all = local.iter().map(|local| &local.filter).chain([master]);
        all.map(|filter| &filter.belief).try_for_each(|belief| {
            belief.errors.require_memory(observations, belief.s.state.values().len(), limit_bytes)
        })
    }
}
