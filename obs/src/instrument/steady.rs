//! Instruments that see the same in every cycle.

use super::{Instrument, platforms_of};
use crate::error::ObservationError;
use crate::observation::{Observation, Reading};
use crate::site::Site;
use crate::state_operator::StateOperator;
use crate::station::{LeftOutStation, Station};
use crate::withheld::Platform;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// An instrument that makes the same observations in every cycle, each time with new random errors.
pub struct Steady {
    observations: Vec<Observation>,
    stations: Vec<Station>,
    left_out: Vec<LeftOutStation>,
    errors: ChaCha8Rng,
}

impl Steady {
    /// The instrument at a site that makes these observations; those of a platform follow each other.
    ///
    /// # Errors
    /// If a standard deviation is not above 0, or a variable or a value of the state does not exist.
    pub fn new(site: &Site<'_>, observations: Vec<Observation>) -> Result<Self, ObservationError> {
        let fault = |number: usize, problem: &str| {
            let problem = format!("observation {}: {problem}", number + 1);
            Err(ObservationError::in_setting(site.network, "observations", problem))
        };
        for (number, Observation { report, sigma, state, .. }) in observations.iter().enumerate() {
            if !(*sigma > 0.0 && sigma.is_finite()) {
                return fault(number, &format!("sigma is {sigma}, but must be above 0"));
            }
            if report.variable >= site.layout.variables.len() {
                return fault(number, &format!("there is no variable of number {}", report.variable));
            }
            if let StateOperator::Linear(row) = state
                && let Some((index, _)) = row.iter().find(|(index, _)| *index >= site.layout.len())
            {
                return fault(number, &format!("there is no value {index} of the state"));
            }
        }
        Ok(Self::with_stations(site, observations, Vec::new(), Vec::new()))
    }

    /// As [`Steady::new`], of stations.
    pub(super) fn with_stations(
        site: &Site<'_>,
        observations: Vec<Observation>,
        stations: Vec<Station>,
        left_out: Vec<LeftOutStation>,
    ) -> Self {
        Self { observations, stations, left_out, errors: site.stream("observations") }
    }
}

impl Instrument for Steady {
    fn observe(&mut self, _cycle: usize, _pass: usize) -> Vec<Observation> {
        let mut observations = self.observations.clone();
        for Observation { sigma, reading, .. } in &mut observations {
            let normal: f64 = StandardNormal.sample(&mut self.errors);
            *reading = Reading::Error(*sigma * normal);
        }
        observations
    }

    fn most_observations(&self, _cycle: usize) -> usize {
        self.observations.len()
    }

    fn platforms(&self) -> Vec<Platform> {
        platforms_of(self.observations.iter().map(|it| {
            let of_state = it.predictors.iter().map(|predictor| predictor.parameter);
            (&it.report.platform, it.calibration_row.iter().map(|entry| entry.0).chain(of_state))
        }))
    }

    fn weights(&self) -> usize {
        self.observations.iter().map(|observation| observation.state.weights()).sum()
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        vec![&mut self.errors]
    }

    fn stations(&self) -> &[Station] {
        &self.stations
    }

    fn left_out(&self) -> &[LeftOutStation] {
        &self.left_out
    }
}
