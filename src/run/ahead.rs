//! Forecasts ahead of an analysis: a copy of the method goes on without observations, and is dropped.
//!
//! ```text
//! x(t + τ) = M(x(t)),    P(t + τ) = A P Aᵀ + Q    in each cycle          WO 97/18442, eq. (24)
//! ```
//!
//! in the form that the method has for it, by its own [`Assimilator::forecast`]. Time and memory of the copy are no part of
//! the method's cost. What it makes is kept until its valid time comes.

use super::cycle::{Runner, guarded};
use super::monitor::{self, Fault};
use crate::event::{self, RunInfo};
use crate::lead_times::LeadTimes;
use isobar_assim::{Assimilator, Error, Estimate};
use isobar_model::Duration;
use isobar_model::communicator::Communicator;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};

/// Parts of the memory limit that a method with forecasts ahead needs, each as large as what it carries from cycle to cycle:
/// that, a copy of it, and what the copy's forecast takes.
const PARTS: u64 = 3;

/// The forecasts of one method whose valid time has not come, the earliest start first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ahead {
    pending: Vec<Pending>,
}

/// A forecast whose valid time has not come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pending {
    /// The cycle from whose analysis it started.
    pub from_cycle: usize,
    /// The cycle at whose end it is valid.
    pub cycle: usize,
    /// The forecast.
    pub estimate: Estimate,
}

impl Ahead {
    /// Makes the forecasts from the analysis of a cycle that are valid until the end of cycle `last`.
    ///
    /// # Errors
    /// Why a forecast cannot be made to its end; what was made before that is kept.
    pub fn start(
        &mut self,
        runner: &mut Runner,
        cycle: usize,
        times: &LeadTimes,
        window: Duration,
        last: usize,
        memory_limit_bytes: u64,
        communicator: &dyn Communicator,
    ) -> Result<(), Fault> {
        let longest = times.kept().take_while(|lead| cycle + lead <= last).last().unwrap_or(0);
        if longest == 0 {
            return Ok(());
        }
        guarded(|| require_room(runner.method(), memory_limit_bytes, communicator))?;
        let mut copy = runner.method().boxed_clone();
        for lead in 1..=longest {
            let estimate = guarded(|| copy.forecast(window))?.estimate;
            monitor::check_forecast(runner.model(), &estimate)?;
            if lead.is_multiple_of(times.every_cycles) {
                self.pending.push(Pending { from_cycle: cycle, cycle: cycle + lead, estimate });
            }
        }
        Ok(())
    }

    /// The forecasts from the analysis of a cycle whose valid time has not come, the shortest first.
    pub fn from(&self, cycle: usize) -> impl Iterator<Item = &Pending> {
        self.pending.iter().filter(move |pending| pending.from_cycle == cycle)
    }

    /// Takes out the forecasts that are valid at the end of a cycle.
    pub fn due(&mut self, cycle: usize) -> Vec<Pending> {
        self.pending.extract_if(.., |pending| pending.cycle == cycle).collect()
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.pending.clear();
    }

    /// Whether all are of this run and still to come after a cycle.
    pub fn fits(&self, cycle: usize, info: &RunInfo) -> bool {
        let longest = info.lead_times.map_or(0, |times| times.longest_cycles);
        self.pending.iter().all(|Pending { from_cycle, cycle: valid, estimate }| {
            (1..=cycle).contains(from_cycle)
                && (cycle + 1..=from_cycle.saturating_add(longest)).contains(valid)
                && estimate.calibration.len() == info.calibration.len()
                && event::fits(estimate, info)
        })
    }
}

/// Fails unless a copy of the method can forecast beside it within its memory limit; each of several ranks has its share of both.
///
/// # Errors
/// [`Error::TooLarge`], and those of the method's memory.
pub fn require_room(method: &dyn Assimilator, limit_bytes: u64, communicator: &dyn Communicator) -> Result<(), Error> {
    if limit_bytes == u64::MAX {
        return Ok(());
    }
    // Rank 0 writes the whole memory.
    let mut counted = Counted(0);
    method.save(&mut counted)?;
    let of_all = communicator.of_first(vec![counted.0 as f64])[0] as u64;
    let needed_bytes = PARTS * of_all.div_ceil(communicator.ranks() as u64);
    if needed_bytes <= limit_bytes {
        return Ok(());
    }
    let what = "a copy of the method that forecasts ahead beside it";
    Err(Error::TooLarge { what: what.into(), needed_bytes, limit_bytes })
}

/// Counts the bytes that are written, and forgets them.
struct Counted(u64);

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::experiment::{ground, method};
    use crate::scenario::Scenario;
    use isobar_model::communicator::Alone;
    use std::path::Path;

    /// The free run carries its state, and a little more.
    #[test]
    fn a_copy_needs_room_beside_the_method() {
        let scenario = Scenario::parse(Path::new("mine.toml"), include_str!("../cli/template.toml")).unwrap();
        let problem = ground(&scenario, 1, 5).unwrap().problem;
        let free = method(&problem, "free", &scenario, scenario.start).unwrap();
        let state = 8 * problem.background.values().len() as u64;
        let room = |limit_bytes| require_room(&*free, limit_bytes, &Alone);
        assert!(room(4 * state).is_ok() && room(u64::MAX).is_ok());
        let error = room(3 * state - 1).unwrap_err();
        assert!(
            error.to_string().starts_with("a copy of the method that forecasts ahead beside it would need"),
            "{error}"
        );
    }
}
