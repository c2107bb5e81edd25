//! What the members of an ensemble make of the observations.

use super::members::Ensemble;
use crate::appropriate_time::Times;
use crate::error::Error;
use crate::problem::{Innovations, Problem, require_finite};
use faer::Mat;
use isobar_model::{Duration, Model, State};
use isobar_obs::{ObservationWindow, TimedObservations};
use rayon::prelude::*;

/// What the members make of the observations.
pub(super) struct ObservedEnsemble {
    /// y − the members' mean h(x, c), with the Jacobians about their mean.
    pub innovations: Innovations,
    /// Y': the members' h(x, c) about their mean, `[n, N]`.
    pub perturbations: Mat<f64>,
    /// How far rounding may have changed a row of Y': a machine epsilon of |h(x, c)|, `[n]`.
    pub rounding: Vec<f64>,
    /// Where the observations are (x, y) \[m\].
    pub places: Vec<(f64, f64)>,
}

impl Ensemble {
    /// Each member as the instruments would see it; `trajectories` are where the members' trajectories through the window began,
    /// and its length: what is within the window is seen from these.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if a departure is not finite; as a forecast.
    pub(super) fn observe(
        &self,
        problem: &Problem<dyn Model>,
        observed: &ObservationWindow,
        trajectories: Option<(Ensemble, Duration)>,
    ) -> Result<ObservedEnsemble, Error> {
        let members: Vec<Vec<f64>> = match observed.operator.within_window().zip(trajectories) {
            None => self
                .each()
                .map(|member| {
                    let (state, calibration) = self.unpack(problem, member);
                    observed.operator.simulate(&state, &calibration)
                })
                .collect(),
            Some((within, (starts, window))) => self.observe_within(problem, within, &starts, window)?,
        };
        let (state, calibration) = self.unpack(problem, &self.mean());
        let mut innovations = problem.innovations(observed, &state, &calibration)?;
        let mean: Vec<f64> = (0..observed.len())
            .map(|row| members.iter().map(|member: &Vec<f64>| member[row]).sum::<f64>() / members.len() as f64)
            .collect();
        innovations.departures = observed.values.iter().zip(&mean).map(|(y, mean)| y - mean).collect();
        require_finite(&innovations.departures, observed)?;
        // From h(x, c) itself, not from departures: a large y would round the members' differences away.
        let perturbations = Mat::from_fn(mean.len(), members.len(), |i, j| members[j][i] - mean[i]);
        let places = observed.reports.iter().map(|report| (report.x_m, report.y_m)).collect();
        let rounding = mean.iter().map(|mean| f64::EPSILON * mean.abs()).collect();
        Ok(ObservedEnsemble { innovations, perturbations, rounding, places })
    }

    /// What each member sees of the observations of a window, at their times.
    fn observe_within(
        &self,
        problem: &Problem<dyn Model>,
        within: TimedObservations<'_>,
        starts: &Ensemble,
        window: Duration,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let times = Times::new(&*problem.model, window, within.lags)?;
        let both = self.each().zip(starts.each());
        both.map(|(member, start)| {
            let (state, calibration) = self.unpack(problem, member);
            let (mut x, _) = self.unpack(problem, start);
            let see = |x: &State| within.whole.simulate(x, &calibration);
            let now = see(&state);
            let seen = times.follow(&*problem.model, &mut x, see)?.at_time;
            // What is valid at the end is seen with the model errors.
            let own = |((seen, now), lag): ((f64, f64), &Duration)| if lag.seconds() == 0 { now } else { seen };
            Ok(seen.into_iter().zip(now).zip(within.lags).map(own).collect())
        })
        .collect()
    }
}
