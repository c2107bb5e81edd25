//! The contract battery of instruments.

use super::operator::{ContractViolation, check_operator};
use crate::error::ObservationError;
use crate::network::Network;
use crate::system::ObservingSystem;
use crate::window::ObservationWindow;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Duration, Layout, State, Time};
use std::collections::HashSet;
use std::sync::Arc;

/// A clause of the contract of [`Instrument`](crate::Instrument) that an instrument does not keep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InstrumentViolation {
    /// The instrument cannot be built.
    #[error(transparent)]
    Settings(#[from] ObservationError),
    /// It never reports.
    #[error("there is no observation in {CYCLES} cycles")]
    Silent,
    /// Reports, errors or rows of the Jacobian are not what they must be.
    #[error("cycle {cycle}: {problem}")]
    Malformed {
        /// The cycle.
        cycle: usize,
        /// What is wrong.
        problem: String,
    },
    /// An instrument with the same seed, or one that goes on from a checkpoint, observes something else.
    #[error("cycle {cycle}: the observations are not those of the same seed, or of a resumed system")]
    NotRepeatable {
        /// The cycle.
        cycle: usize,
    },
    /// The operator does not keep its contract.
    #[error(transparent)]
    Operator(#[from] ContractViolation),
}

/// Number of cycles in which an instrument is checked.
const CYCLES: usize = 4;

/// Checks that a network's instrument keeps its contract on a layout, in cycles of six hours: reports of that network, those
/// of a platform one after another, of variables of the layout, with positive errors; Jacobians within the state and the
/// calibration; operators that pass [`check_operator`], also [anchored](ObservationOperator::anchored) ones; and the same
/// observations from the same seed, also after a system was saved and restored.
///
/// # Errors
/// The first clause that is not kept.
pub fn check_instrument(network: &Network, layout: &Arc<Layout>, seed: u64) -> Result<(), InstrumentViolation> {
    let (start, window) = (Time::from_seconds(0), Duration::from_seconds(21_600));
    let system = || ObservingSystem::new(layout, None, std::slice::from_ref(network), seed, window, start);
    let state = |name: &str| {
        State::from_values(layout, standard_normals(&mut stream(seed, &format!("contract/{name}")), layout.len()))
    };
    let (mut first, mut second) = (system()?, system()?);
    let (truth, x, background) = (state("truth"), state("state"), state("background"));
    let mut count = 0;
    for cycle in 1..=CYCLES {
        let observed = first.observe(&truth);
        count += observed.len();
        let p = first.calibration().len();
        // What is not known is as good as anything.
        let c: Vec<f64> = first.true_calibration().iter().map(|value| value.unwrap_or(1.0)).collect();
        let jacobian = observed.operator.linearize(&x, &c);
        if !jacobian.state.has_shape(observed.len(), layout.len()) || !jacobian.calibration.has_shape(observed.len(), p)
        {
            return Err(malformed(cycle, "a row of the Jacobian is outside of the state or the calibration"));
        }
        check_reports(&network.name, &observed, layout)?;
        check_operator(&*observed.operator, &x, &c, seed)?;
        check_operator(&*observed.anchored(&background).operator, &x, &c, seed)?;
        let again = second.observe(&truth);
        if again.values != observed.values || again.reports != observed.reports {
            return Err(InstrumentViolation::NotRepeatable { cycle });
        }
        second = system()?;
        second.restore(&first.save())?;
    }
    if count == 0 { Err(InstrumentViolation::Silent) } else { Ok(()) }
}

fn malformed(cycle: usize, problem: impl Into<String>) -> InstrumentViolation {
    InstrumentViolation::Malformed { cycle, problem: problem.into() }
}

fn check_reports(name: &str, observed: &ObservationWindow, layout: &Layout) -> Result<(), InstrumentViolation> {
    let fault = |problem: &str| Err(malformed(observed.cycle, problem));
    if !observed.fits(layout) {
        return fault("a report is of a variable that the layout does not have");
    }
    if observed.sigma.iter().any(|&sigma| sigma <= 0.0) {
        return fault("a standard deviation is not positive");
    }
    let (mut last, mut seen) = (None, HashSet::new());
    for report in &observed.reports {
        if &*report.network != name {
            return fault("a report is of another network");
        }
        if last != Some(&report.platform) && !seen.insert(&report.platform) {
            return fault("the observations of a platform do not follow each other");
        }
        last = Some(&report.platform);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::layout;
    use crate::{
        AirMassBias, BiasProcess, BiasScope, Instrument, InstrumentSettings, Observation, ObservationFile,
        RadiosondeSettings, Reading, RecordedSettings, Report, SatelliteSettings, Site, StateOperator, StationBias,
        StationSource,
    };
    use isobar_model::Boundary;
    use rand_chacha::ChaCha8Rng;

    /// A network of each kind of instrument.
    fn networks() -> Vec<Network> {
        let groups = vec!["a".to_owned(), "b".to_owned()];
        let mut sondes = RadiosondeSettings::new(StationSource::Random { count: 60, groups });
        for scope in [BiasScope::EachGroup, BiasScope::EachStation] {
            let process = BiasProcess::constant(3.0);
            sondes.biases.push(StationBias { variable: "h".to_owned(), scope, process });
        }
        let mut satellite = SatelliteSettings::default();
        (satellite.swath_width_m, satellite.footprint_sigma_m) = (1e6, 1.5e5);
        satellite.track_angle_deg = 10.0;
        for (variable, scale) in [("h", 2.0), ("u", 0.5)] {
            let (variable, process) = (variable.to_owned(), BiasProcess::constant(3.0));
            satellite.air_mass_biases.push(AirMassBias { variable, mean: 0.7, scale, process });
        }
        let text = "cycle,x_m,y_m,variable,value,sigma\n2,1e5,3e5,h,7,2\n2,1e5,3e5,u,7,2\n3,1e5,3e5,u,7,2\n";
        let observations = ObservationFile::parse(text, "buoys.csv", None).unwrap();
        let recorded = RecordedSettings::new(observations);
        let polar = Network { missing_rate: 0.2, ..Network::new("polar", satellite) };
        vec![Network::new("net", sondes), polar, Network::new("buoys", recorded)]
    }

    #[test]
    fn every_instrument_keeps_the_contract() {
        for boundary in [Boundary::Channel, Boundary::Periodic] {
            for network in networks() {
                check_instrument(&network, &layout(boundary), 3).unwrap();
            }
        }
    }

    /// An instrument that reports the first value of the state, with a chosen fault.
    #[derive(Clone, Copy, Debug, Default)]
    struct Faulty {
        sigma: Option<f64>,
        network: Option<&'static str>,
        is_silent: bool,
        /// Whether it counts its reports, which no checkpoint holds.
        counts: bool,
        reports: usize,
    }

    impl InstrumentSettings for Faulty {
        fn build(&self, _: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
            Ok(Box::new(*self))
        }
    }

    impl Instrument for Faulty {
        fn observe(&mut self, _: usize, _: usize) -> Vec<Observation> {
            self.reports += 1;
            let network = self.network.unwrap_or("net").into();
            let error = if self.counts { self.reports as f64 } else { 0.0 };
            let report = Report { network, platform: "a".into(), variable: 0, x_m: 1.0, y_m: 1.0, scan: None };
            let state = StateOperator::Linear(vec![(0, 1.0)]);
            let reading = Reading::Error(error);
            let observation = Observation { reading, ..Observation::new(report, self.sigma.unwrap_or(1.0), state) };
            if self.is_silent { Vec::new() } else { vec![observation] }
        }

        fn most_observations(&self, _: usize) -> usize {
            1
        }

        fn weights(&self) -> usize {
            1
        }

        fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
            Vec::new()
        }
    }

    #[test]
    fn an_instrument_from_outside_may_pass_and_faulty_ones_are_found() {
        let layout = layout(Boundary::Channel);
        let check = |instrument: Faulty| check_instrument(&Network::new("net", instrument), &layout, 3);
        let right = Faulty::default();
        assert_eq!(check(right), Ok(()));
        for (faulty, wanted) in [
            (Faulty { sigma: Some(0.0), ..right }, "a standard deviation is not positive"),
            (Faulty { network: Some("other"), ..right }, "a report is of another network"),
            (Faulty { is_silent: true, ..right }, "no observation in 4 cycles"),
            (Faulty { counts: true, ..right }, "cycle 2: the observations are not those of the same seed"),
        ] {
            let error = check(faulty).unwrap_err().to_string();
            assert!(error.contains(wanted), "{error}");
        }
    }
}
