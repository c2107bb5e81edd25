//! What the members of an ensemble make of the observations.

use super::members::Ensemble;
use crate::appropriate_time::Times;
use crate::error::Error;
use crate::problem::{Innovations, Problem, require_finite};
use faer::Mat;
use isobar_model::bands::RowExchange;
use isobar_model::{Bands, Boundary, ColumnsMut, Duration, Model, State};
use isobar_obs::{Jacobian, ObservationWindow, TimedObservations};
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
        bands: &Bands,
        trajectories: Option<(Ensemble, Duration)>,
    ) -> Result<ObservedEnsemble, Error> {
        let own_mean = self.mean();
        let (of_state, parameters) = own_mean.split_at(self.state_values());
        let (state, calibration) = self.unpack(problem, bands.gather(of_state.to_vec()), parameters);
        let mut innovations = problem.innovations(observed, &state, &calibration)?;
        let members: Vec<Vec<f64>> = match observed.operator.within_window().zip(trajectories) {
            None if bands.is_whole() => self
                .each()
                .map(|member| {
                    let (state, calibration) = self.unpack_member(problem, member);
                    observed.operator.simulate(&state, &calibration)
                })
                .collect(),
            None => self.observe_together(problem, observed, bands, &state, &innovations.jacobian),
            Some((within, (starts, window))) => self.observe_within(problem, within, &starts, window)?,
        };
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

    /// [`Ensemble::observe`] by several ranks: each of the observations whose footprints begin in its rows, for which it receives
    /// the rows beside these as far as they reach. Elsewhere its states are the mean, which no such observation sees.
    fn observe_together(
        &self,
        problem: &Problem<dyn Model>,
        observed: &ObservationWindow,
        bands: &Bands,
        mean: &State,
        jacobian: &Jacobian,
    ) -> Vec<Vec<f64>> {
        let (grid, m) = (bands.grid(), self.state_values());
        let rows: Vec<Vec<usize>> = (0..observed.len())
            .map(|row| jacobian.state.row(row).iter().map(|entry| entry.0 % grid.cells() / grid.nx).collect())
            .collect();
        let rank_of = |rows: &Vec<usize>| rows.first().map_or(0, |&row| bands.rank_of(row));
        let exchange =
            RowExchange::new(bands, rows.iter().map(|rows| reach(bands, rank_of(rows), rows)).max().unwrap_or(0));
        let wide_len = exchange.rows().len() * grid.nx;
        let fields = mean.layout().variables.len();
        let mut wide: Vec<Vec<f64>> = self.each().map(|_| vec![0.0; fields * wide_len]).collect();
        self.each().zip(&mut wide).for_each(|(member, wide)| exchange.widen(&member[..m], wide));
        let fields = wide.iter_mut().flat_map(|wide| wide.chunks_exact_mut(wide_len)).map(ColumnsMut::Double);
        exchange.fill(bands, &mut fields.collect::<Vec<_>>());
        let own: Vec<bool> = rows.iter().map(|rows| rank_of(rows) == bands.communicator().rank()).collect();
        let members = self.each().zip(wide).flat_map_iter(|(member, wide)| {
            let mut values = mean.values().to_vec();
            exchange.place(bands, &wide, &mut values);
            let (state, calibration) = self.unpack(problem, values, &member[m..]);
            let seen = observed.operator.simulate(&state, &calibration);
            seen.into_iter().zip(&own).map(|(seen, &own)| if own { seen } else { 0.0 }).collect::<Vec<_>>()
        });
        let mut all: Vec<f64> = members.collect();
        bands.communicator().sum(&mut all);
        all.chunks_exact(observed.len().max(1)).map(<[f64]>::to_vec).collect()
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
            let (state, calibration) = self.unpack_member(problem, member);
            let (mut x, _) = self.unpack_member(problem, start);
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

/// How many rows beyond the band of a rank some rows of the grid lie, the shorter way around a periodic domain.
fn reach(bands: &Bands, rank: usize, rows: &[usize]) -> usize {
    let (band, ny) = (bands.of_rank(rank), bands.grid().ny);
    let beyond = |&row: &usize| {
        if band.contains(&row) {
            return 0;
        }
        match bands.grid().boundary {
            Boundary::Channel => band.start.saturating_sub(row).max((row + 1).saturating_sub(band.end)),
            Boundary::Periodic => ((band.start + ny - row) % ny).min((row + ny + 1 - band.end) % ny),
        }
    };
    rows.iter().map(beyond).max().unwrap_or(0)
}
