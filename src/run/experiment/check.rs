//! What can be known of a scenario without running it: its faults, and what it will cost.

use super::cost::{self, Cost, Rates};
use super::{ExperimentError, ground, method, notices, placed_warnings, work};
use crate::kinds::methods::Method;
use crate::run::comparisons::Comparisons;
use crate::scenario::Scenario;
use crate::sensors::SensorError;

/// What a scenario is found to be when nothing is wrong with it.
pub struct Checked {
    /// What there is to know without being wrong, such as how many observations of a file can be used.
    pub information: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What each method is estimated to cost on this machine, in the order of the scenario.
    pub costs: Vec<(String, Cost)>,
}

/// The largest method that a check sets up where the state is large \[bytes\]: beyond, that takes many seconds, and is left to the
/// run, which refuses what does not fit before its first cycle.
const MOST_SET_UP: f64 = 6e7;

/// The most values of a state that is not large.
const MOST_VALUES: usize = 5000;

/// Whether a scenario's model, initial state, covariances and observing systems fit together.
///
/// # Errors
/// All things that do not, as far as they do not depend on each other; at least one.
pub fn check(scenario: &Scenario) -> Result<Checked, Vec<ExperimentError>> {
    let mut faults: Vec<ExperimentError> = check_sensors(scenario).err().into_iter().collect();
    let ground = match ground(scenario, scenario.seed, scenario.cycle.count) {
        Ok(ground) => ground,
        Err(fault) => {
            faults.push(fault);
            return Err(faults);
        }
    };
    let truth = ground.truth.as_ref().map(|truth| truth.check_cycles(scenario.cycle.count));
    faults.extend(truth.and_then(Result::err).map(ExperimentError::Truth));
    let problem = &ground.problem;
    let is_large = problem.background.values().len() > MOST_VALUES;
    for (name, method) in &scenario.methods {
        // What a method refuses depends on all that it is given, so that each is set up for once; a large one only if it will
        // be refused, before it takes any memory.
        let bytes = cost::bytes(&work(scenario, method, problem));
        if !is_large || bytes < MOST_SET_UP || bytes > method.memory_limit_bytes as f64 {
            faults.extend(self::method(problem, name, scenario, scenario.start).err());
        }
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let cycles = 1..=scenario.cycle.count;
    let placed = placed_warnings(scenario, &ground).map_err(|fault| vec![fault])?;
    let compared = Comparisons::new(scenario, &ground.observing, scenario.seed);
    compared.map_err(|fault| vec![ExperimentError::Comparison(fault)])?;
    let recorded: Vec<_> = ground.observing.recorded_use(cycles).collect();
    let mut warnings = notices::warnings(scenario, &ground.observing, &recorded, scenario.cycle.count);
    warnings.extend(notices::of_methods(scenario, |_| true));
    warnings.extend(notices::of_thresholds(&placed, problem));
    let rates = Rates::measure(problem);
    let cost = |(name, method): (&String, &Method)| (name.clone(), rates.cost(&work(scenario, method, problem)));
    let costs: Vec<(String, Cost)> = scenario.methods.iter().map(cost).collect();
    warnings.extend(notices::memory(costs.iter().map(|(_, cost)| cost.bytes).sum()));
    Ok(Checked { information: notices::information(scenario, &ground.observing, &recorded), warnings, costs })
}

/// What all methods of a scenario are estimated to hold at one time \[bytes\].
///
/// # Errors
/// If the scenario cannot become an experiment.
pub fn estimated_bytes(scenario: &Scenario) -> Result<f64, ExperimentError> {
    let problem = ground(scenario, scenario.seed, scenario.cycle.count)?.problem;
    Ok(scenario.methods.values().map(|method| cost::bytes(&work(scenario, method, &problem))).sum())
}

/// Whether the scenario's database of sensors can be written back, and may be, if it is to be.
///
/// # Errors
/// If not.
pub fn check_sensors(scenario: &Scenario) -> Result<(), ExperimentError> {
    let Some(settings) = &scenario.sensors else { return Ok(()) };
    Ok(settings.check_place().map_err(|reason| SensorError::new(&settings.database, reason))?)
}
