//! Comparisons of sensors and test points, cycle by cycle.

use crate::scenario::Scenario;
use crate::text::{clean, nearest};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Duration, Time};
use isobar_obs::{Calibration, ObservingSystem, SensorComparison};

/// The comparisons of a run, with the numbers of their parameters.
#[derive(Clone, Debug, Default)]
pub struct Comparisons(Vec<Placed>);

#[derive(Clone, Debug)]
struct Placed {
    time: Time,
    /// Its value is 0 where it is made from the truth.
    comparison: SensorComparison,
    /// What is added to the true difference, where it is made from the truth.
    error: Option<f64>,
}

/// Why a comparison does not fit the run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misplaced {
    /// Its number in the scenario, from 0.
    pub number: usize,
    /// The key that is wrong.
    pub key: &'static str,
    /// Why, with what would be right.
    pub reason: String,
}

impl Comparisons {
    /// Those of a scenario, with the numbers of their sensors. What is made from the truth has an error from its own random
    /// stream, by `seed`, sensors and time.
    ///
    /// # Errors
    /// The first comparison of a sensor that is not there, or of two whose biases have different units, or without a value where
    /// the true bias is not known.
    pub fn new(scenario: &Scenario, observing: &ObservingSystem, seed: u64) -> Result<Self, Misplaced> {
        let settings = &scenario.comparisons;
        let (calibration, truth) = (observing.calibration(), observing.true_calibration());
        let mut placed: Vec<Placed> = Vec::new();
        for (number, own) in settings.iter().enumerate() {
            let misplaced = |key, reason| Misplaced { number, key, reason };
            let parameter = find(calibration, &own.sensor).map_err(|reason| misplaced("sensor", reason))?;
            let with = own.with.as_ref().map(|name| find(calibration, name)).transpose();
            let other = with.map_err(|reason| misplaced("with", reason))?;
            let unit = |number: usize| &calibration.parameters[number].unit;
            if let Some(other) = other.filter(|&other| unit(other) != unit(parameter)) {
                let reason = format!(
                    "the bias {} is in {}, and {} in {}: sensors of one unit can be compared",
                    clean(&own.sensor),
                    unit(parameter),
                    clean(&calibration.parameters[other].name),
                    unit(other)
                );
                return Err(misplaced("with", reason));
            }
            let is_known = |number: usize| truth.get(number).is_some_and(Option::is_some);
            if own.value.is_none() && ![Some(parameter), other].into_iter().flatten().all(is_known) {
                let reason = "`value` must be given: nothing is known of a true bias, from which it could be made";
                return Err(misplaced("sensor", reason.into()));
            }
            let earlier = settings[..number]
                .iter()
                .filter(|it| (&it.sensor, &it.with, it.time) == (&own.sensor, &own.with, own.time));
            let name = format!(
                "comparison/{}/{}/{}/{}",
                own.sensor,
                own.with.as_deref().unwrap_or_default(),
                own.time.seconds(),
                earlier.count()
            );
            let error = own.value.is_none().then(|| own.sigma * standard_normals(&mut stream(seed, &name), 1)[0]);
            let comparison = SensorComparison { parameter, other, value: own.value.unwrap_or(0.0), sigma: own.sigma };
            placed.push(Placed { time: own.time, comparison, error });
        }
        Ok(Self(placed))
    }

    /// Those of the cycle of this length that ends at `end`, when the true biases are `truth`.
    pub fn of_cycle(&self, end: Time, window: Duration, truth: &[Option<f64>]) -> Vec<SensorComparison> {
        let own = self.0.iter().filter(|it| it.time <= end && end < it.time + window);
        let value = |it: &Placed| {
            let Some(error) = it.error else { return it.comparison.value };
            let of_truth = |(parameter, weight): (usize, f64)| weight * truth[parameter].unwrap_or(0.0);
            it.comparison.row().map(of_truth).sum::<f64>() + error
        };
        own.map(|it| SensorComparison { value: value(it), ..it.comparison }).collect()
    }
}

/// The number of a parameter.
fn find(calibration: &Calibration, name: &str) -> Result<usize, String> {
    let names = || calibration.parameters.iter().map(|parameter| parameter.name.as_str());
    names().position(|own| own == name).ok_or_else(|| {
        let near = nearest(name, names()).map_or(String::new(), |near| format!("; did you mean \"{}\"?", clean(near)));
        let all: Vec<String> = names().take(8).map(clean).collect();
        let more = if names().count() > all.len() { ", …" } else { "" };
        let all = if all.is_empty() { "none".to_string() } else { all.join(", ") + more };
        format!("no bias that methods estimate is called \"{}\"{near} (biases: {all})", clean(name))
    })
}
