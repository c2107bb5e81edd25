//! What the records mean for a run: a Kalman filter over all that was known of the sensors before it starts.
//!
//! ```text
//! c(t) = c(s) + N(0, σ_d² (t − s))           the drift that the scenario assumes
//! calibration      c, P ← value, S            of its sensors; their covariance with all others becomes zero
//! recalibration    c ← c + u, P ← P + σ²      B u of the calibration's recursion
//! test point       r − x = c + N(0, σ²)       an observation of one parameter
//! ```
//!
//! in the order of time, and at one time in this order: recalibrations, calibrations, test points. A sensor without any
//! calibration has the scenario's prior, whatever its test points and recalibrations make of it. What is later than the
//! start of the run is not used, but for recalibrations: they come when they come.

use super::record::{Record, Records};
use crate::text::clean;
use faer::linalg::solvers::Llt;
use faer::{Mat, Side};
use isobar_assim::{Recalibration, SensorKnowledge, drift};
use isobar_model::Time;
use isobar_model::vector::multiply;
use isobar_obs::{Calibration, Parameter};
use std::collections::HashMap;

/// What a run starts with.
#[derive(Clone, Debug)]
pub struct WarmStart {
    /// The parameters, with the standard deviations and covariances of now.
    pub calibration: Calibration,
    /// Their prior means, and the recalibrations to come.
    pub knowledge: SensorKnowledge,
    /// Number of parameters of which something was known.
    pub known: usize,
    /// What the user should know of records that are not used.
    pub warnings: Vec<String>,
}

impl WarmStart {
    /// Goes on with methods that have begun with `calibration` and these recalibrations, and are at `now`: their prior is what
    /// it was then, whatever has become known of that time since. The recalibrations to come are those of today.
    ///
    /// Parameters that are others than those then stay as they are.
    pub fn go_on(&mut self, calibration: &Calibration, known: &[Recalibration], now: Time) {
        let name = |it: &Parameter| it.name.clone();
        let names = |it: &Calibration| it.parameters.iter().map(name).collect::<Vec<_>>();
        if names(calibration) == names(&self.calibration) {
            self.calibration = calibration.clone();
        }
        self.warnings.retain(|warning| warning != NOTHING_KNOWN);
        let all = self.knowledge.recalibrations.len();
        self.knowledge.recalibrations.retain(|it| it.time > now || known.contains(it));
        let late = all - self.knowledge.recalibrations.len();
        if late > 0 {
            self.warnings.push(format!(
                "{late} recalibrations came to be known after the cycle at whose time they were, and are not used"
            ));
        }
    }
}

/// What is said where nothing is known.
const NOTHING_KNOWN: &str = "nothing in the database is of a sensor of this scenario at this time";

/// What belongs to calibrations, by their time \[s\] and origin.
type ByOrigin<'a, T> = HashMap<(i64, &'a str), Vec<T>>;

/// An event of a sensor, by the number of its parameter.
enum Event<'a> {
    Recalibrated(usize, f64, f64),
    Calibrated(&'a str),
    Tested(usize, f64, f64),
}

impl Event<'_> {
    fn rank(&self) -> usize {
        match self {
            Event::Recalibrated(..) => 0,
            Event::Calibrated(_) => 1,
            Event::Tested(..) => 2,
        }
    }
}

/// The parameters' mean and covariance as time goes by.
struct Filter<'a> {
    calibration: &'a Calibration,
    time: Option<Time>,
    mean: Vec<f64>,
    covariance: Mat<f64>,
}

impl Filter<'_> {
    /// Lets the drift go on to a time; before the first event nothing drifts, because the priors are those of the start.
    fn advance(&mut self, to: Time) {
        if let Some(from) = self.time {
            let kept = drift(self.calibration, to - from, self.covariance.as_mut());
            multiply(&mut self.mean, &kept);
        }
        self.time = Some(to);
    }

    /// An observation of one parameter.
    fn observe(&mut self, number: usize, value: f64, variance: f64) {
        let own = self.covariance.col_as_slice(number).to_vec();
        let alpha = own[number] + variance;
        let innovation = (value - self.mean[number]) / alpha;
        self.mean.iter_mut().zip(&own).for_each(|(mean, own)| *mean += own * innovation);
        for (j, of_column) in own.iter().enumerate() {
            let column = self.covariance.col_as_slice_mut(j);
            column.iter_mut().zip(&own).for_each(|(value, of_row)| *value -= of_row * of_column / alpha);
        }
    }
}

/// What is known at `start` of the parameters of an experiment that goes on until `end`.
///
/// # Errors
/// In words: a sensor whose bias has another unit, a matrix of covariances that is not positive definite.
pub fn warm_start(records: &Records, calibration: &Calibration, start: Time, end: Time) -> Result<WarmStart, String> {
    let p = calibration.len();
    let numbers: HashMap<&str, usize> =
        calibration.parameters.iter().enumerate().map(|(number, it)| (it.name.as_str(), number)).collect();
    let number = |sensor: &str| numbers.get(sensor).copied();
    let mut touched = vec![false; p];
    let mut events: Vec<(Time, Event<'_>)> = Vec::new();
    let (mut recalibrations, mut late_test_points) = (Vec::new(), 0);
    // By time and origin: values, and covariances of pairs.
    let mut calibrated: ByOrigin<'_, (usize, f64, f64)> = HashMap::new();
    let mut covariances: ByOrigin<'_, (usize, usize, f64)> = HashMap::new();
    for record in records.iter() {
        match record {
            Record::Sensor { name, unit, .. } => {
                if let Some(number) = number(name)
                    && calibration.parameters[number].unit != *unit
                {
                    let own = &calibration.parameters[number].unit;
                    return Err(format!(
                        "the bias of \"{}\" is in {own} here, but in {} there",
                        clean(name),
                        clean(unit)
                    ));
                }
            }
            Record::Calibration { sensor, time, origin, value, sigma } => {
                if let Some(number) = number(sensor)
                    && *time <= start
                {
                    touched[number] = true;
                    let own = calibrated.entry((time.seconds(), origin)).or_default();
                    if own.is_empty() {
                        events.push((*time, Event::Calibrated(origin)));
                    }
                    own.push((number, *value, *sigma));
                }
            }
            Record::Covariance { sensor, other, time, origin, covariance } => {
                if let (Some(i), Some(j)) = (number(sensor), number(other)) {
                    covariances.entry((time.seconds(), origin)).or_default().push((i, j, *covariance));
                }
            }
            Record::TestPoint { sensor, time, reading, reference, sigma } => {
                if let Some(number) = number(sensor) {
                    if *time <= start {
                        touched[number] = true;
                        events.push((*time, Event::Tested(number, reading - reference, sigma * sigma)));
                    } else {
                        late_test_points += usize::from(*time <= end);
                    }
                }
            }
            Record::Recalibration { sensor, time, step, sigma, .. } => {
                if let Some(parameter) = number(sensor) {
                    touched[parameter] |= *time <= end;
                    if *time <= start {
                        events.push((*time, Event::Recalibrated(parameter, *step, sigma * sigma)));
                    } else if *time <= end {
                        recalibrations.push(Recalibration { time: *time, parameter, step: *step, sigma: *sigma });
                    }
                }
            }
        }
    }
    // Stable: records come in a fixed order.
    events.sort_by_key(|(time, event)| (time.seconds(), event.rank()));
    let prior = Mat::from_fn(p, p, |i, j| calibration.prior_covariance(i, j));
    let mut filter = Filter { calibration, time: None, mean: vec![0.0; p], covariance: prior };
    for (time, event) in &events {
        filter.advance(*time);
        match event {
            Event::Recalibrated(number, step, variance) => {
                filter.mean[*number] += step;
                filter.covariance[(*number, *number)] += variance;
            }
            Event::Calibrated(origin) => {
                let key = (time.seconds(), *origin);
                let own = &calibrated[&key];
                for &(number, value, sigma) in own {
                    filter.mean[number] = value;
                    (0..p).for_each(|j| {
                        filter.covariance[(number, j)] = 0.0;
                        filter.covariance[(j, number)] = 0.0;
                    });
                    filter.covariance[(number, number)] = sigma * sigma;
                }
                for &(i, j, covariance) in covariances.get(&key).into_iter().flatten() {
                    (filter.covariance[(i, j)], filter.covariance[(j, i)]) = (covariance, covariance);
                }
            }
            Event::Tested(number, value, variance) => filter.observe(*number, *value, *variance),
        }
    }
    filter.advance(start);
    if p > 0 && Llt::new(filter.covariance.as_ref(), Side::Lower).is_err() {
        return Err("the matrix of its covariances is not positive definite".into());
    }
    let mut warm = calibration.clone();
    for (i, parameter) in warm.parameters.iter_mut().enumerate().filter(|(i, _)| touched[*i]) {
        parameter.sigma_prior = filter.covariance[(i, i)].sqrt();
    }
    for i in 0..p {
        for j in (0..i).filter(|&j| filter.covariance[(i, j)] != 0.0) {
            warm.covariances.insert((i, j), filter.covariance[(i, j)]);
        }
    }
    let mut warnings = Vec::new();
    if late_test_points > 0 {
        warnings.push(format!(
            "{late_test_points} test points lie within the run, which does not use them: give them before its start, or as \
             [[comparisons]]"
        ));
    }
    let known = touched.iter().filter(|&&touched| touched).count();
    if known == 0 && !records.is_empty() {
        warnings.push(NOTHING_KNOWN.into());
    }
    recalibrations.sort_by_key(|it| (it.time.seconds(), it.parameter));
    let knowledge = SensorKnowledge { mean: filter.mean, recalibrations };
    Ok(WarmStart { calibration: warm, knowledge, known, warnings })
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_obs::{Drift, Placement};

    const DAY: i64 = 86_400;

    fn calibration(drift: f64) -> Calibration {
        let parameter = |name: &str, sigma_prior| Parameter {
            name: name.into(),
            unit: "m".into(),
            placement: Placement::Shared,
            sigma_prior,
            drift: Drift::RandomWalk { sigma_per_sqrt_day: drift },
        };
        Calibration {
            parameters: vec![parameter("a", 2.0), parameter("b", 3.0), parameter("new", 5.0)],
            ..Default::default()
        }
    }

    fn records(records: Vec<Record>) -> Records {
        let mut all = Records::default();
        for name in ["a", "b", "elsewhere"] {
            all.add(Record::Sensor { name: name.into(), unit: "m".into(), place: None, note: String::new() }).unwrap();
        }
        records.into_iter().for_each(|record| assert!(all.add(record).unwrap()));
        all
    }

    fn day(day: i64) -> Time {
        Time::from_seconds(day * DAY)
    }

    fn calibrated(sensor: &str, on: i64, value: f64, sigma: f64) -> Record {
        Record::Calibration { sensor: sensor.into(), time: day(on), origin: "lab".into(), value, sigma }
    }

    fn recalibrated(sensor: &str, on: i64, step: f64, sigma: f64) -> Record {
        Record::Recalibration { sensor: sensor.into(), time: day(on), step, sigma, note: String::new() }
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-12 * b.abs().max(1.0), "{a} is not {b}");
    }

    #[test]
    fn calibrations_drift_and_recalibrations_add_up_until_the_start() {
        let all = records(vec![
            calibrated("a", 1, 1.5, 0.5),
            calibrated("b", 1, -4.0, 1.0),
            Record::Covariance {
                sensor: "b".into(),
                other: "a".into(),
                time: day(1),
                origin: "lab".into(),
                covariance: 0.3,
            },
            recalibrated("a", 3, 2.0, 0.7),
            recalibrated("b", 12, 9.0, 0.1),
            recalibrated("b", 40, 1.0, 0.1),
            calibrated("a", 11, 100.0, 0.1),
            calibrated("elsewhere", 2, 7.0, 0.1),
        ]);
        let warm = warm_start(&all, &calibration(0.2), day(10), day(20)).unwrap();
        assert_eq!(warm.known, 2);
        close(warm.knowledge.mean[0], 3.5);
        close(warm.knowledge.mean[1], -4.0);
        assert_eq!(warm.knowledge.mean[2], 0.0);
        // Nine days of drift, and what is not known of the step.
        close(warm.calibration.prior_covariance(0, 0), 0.25 + 0.49 + 9.0 * 0.04);
        close(warm.calibration.prior_covariance(1, 1), 1.0 + 9.0 * 0.04);
        close(warm.calibration.prior_covariance(0, 1), 0.3);
        // A new sensor has what the scenario says.
        assert_eq!(warm.calibration.parameters[2], calibration(0.2).parameters[2]);
        assert_eq!(
            warm.knowledge.recalibrations,
            [Recalibration { time: day(12), parameter: 1, step: 9.0, sigma: 0.1 }]
        );
        assert!(warm.warnings.is_empty());
    }

    #[test]
    fn a_test_point_is_an_observation_of_its_sensor_and_of_those_that_were_calibrated_with_it() {
        let point = |on| Record::TestPoint {
            sensor: "a".into(),
            time: day(on),
            reading: 1003.0,
            reference: 1000.0,
            sigma: 0.5,
        };
        let all = records(vec![
            calibrated("a", 1, 1.0, 1.0),
            calibrated("b", 1, 2.0, 1.0),
            Record::Covariance {
                sensor: "a".into(),
                other: "b".into(),
                time: day(1),
                origin: "lab".into(),
                covariance: 0.8,
            },
            point(5),
            point(15),
        ]);
        let warm = warm_start(&all, &calibration(0.0), day(10), day(20)).unwrap();
        // Gain 1/(1 + 0.25) on 3 − 1.
        close(warm.knowledge.mean[0], 1.0 + 0.8 * 2.0);
        close(warm.knowledge.mean[1], 2.0 + 0.64 * 2.0);
        close(warm.calibration.prior_covariance(0, 0), 0.2);
        close(warm.calibration.prior_covariance(0, 1), 0.8 - 0.64);
        close(warm.calibration.prior_covariance(1, 1), 1.0 - 0.64 * 0.8);
        assert!(warm.warnings[0].contains("1 test points lie within the run"), "{:?}", warm.warnings);
    }

    #[test]
    fn what_does_not_fit_is_told() {
        let mut all = Records::default();
        all.add(Record::Sensor { name: "a".into(), unit: "K".into(), place: None, note: String::new() }).unwrap();
        let error = warm_start(&all, &calibration(0.0), day(10), day(20)).unwrap_err();
        assert_eq!(error, "the bias of \"a\" is in m here, but in K there");
        let nothing = warm_start(&records(vec![]), &calibration(0.0), day(10), day(20)).unwrap();
        assert!(nothing.known == 0 && nothing.warnings[0].contains("nothing in the database"));
        let together = |sensor: &str, other: &str, covariance| Record::Covariance {
            sensor: sensor.into(),
            other: other.into(),
            time: day(1),
            origin: "lab".into(),
            covariance,
        };
        let mut impossible =
            records(vec![calibrated("a", 1, 0.0, 1.0), calibrated("b", 1, 0.0, 1.0), together("a", "b", 0.9)]);
        let sensor = Record::Sensor { name: "new".into(), unit: "m".into(), place: None, note: String::new() };
        for record in [sensor, calibrated("new", 1, 0.0, 1.0), together("a", "new", 0.9), together("b", "new", -0.9)] {
            impossible.add(record).unwrap();
        }
        let error = warm_start(&impossible, &calibration(0.0), day(10), day(20)).unwrap_err();
        assert!(error.contains("not positive definite"), "{error}");
    }
}
