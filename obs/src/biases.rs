//! The true values of an observing system's biases as time goes by.

use crate::bias::{BiasProcess, InitialBias};
use crate::calibration::{Calibration, Parameter, Placement};
use crate::error::ObservationError;
use isobar_model::random::stream;
use isobar_model::{Duration, Time};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::HashSet;

/// One parameter's truth as time goes by.
#[derive(Clone, Debug)]
struct TrueBias {
    process: BiasProcess,
    /// The value without a jump.
    value: f64,
    random: ChaCha8Rng,
}

impl TrueBias {
    /// Each parameter has its own random stream, so that none depends on which others there are.
    fn new(process: BiasProcess, name: &str, seed: u64) -> Self {
        let mut random = stream(seed, &format!("bias/{name}"));
        let normal: f64 = StandardNormal.sample(&mut random);
        let value = match process.initial {
            InitialBias::Drawn { sigma } => sigma * normal,
            InitialBias::Given { value } => value,
        };
        Self { process, value, random }
    }

    fn advance(&mut self, span: Duration) {
        let drift = self.process.true_drift();
        if drift.changes() {
            let normal: f64 = StandardNormal.sample(&mut self.random);
            self.value = drift.kept(span) * self.value + drift.added_sigma(span) * normal;
        }
    }

    /// The value `elapsed` after the start, at a `time`.
    fn at(&self, elapsed: Duration, time: Time) -> f64 {
        self.value + self.process.known_change(elapsed, time)
    }
}

/// All bias parameters of an observing system: those that methods must estimate, and those that are known.
#[derive(Clone, Debug)]
pub(crate) struct Biases {
    seed: u64,
    start: Time,
    time: Time,
    calibration: Calibration,
    /// The truth of each parameter of the calibration; nothing for recorded observations, of whose biases none is known.
    truths: Vec<Option<TrueBias>>,
    values: Vec<Option<f64>>,
    known: Vec<(Parameter, TrueBias)>,
    /// The names of all.
    names: HashSet<String>,
}

impl Biases {
    /// No parameters yet.
    pub fn new(seed: u64, start: Time) -> Self {
        let (calibration, truths, values, known, names) = Default::default();
        Self { seed, start, time: start, calibration, truths, values, known, names }
    }

    /// Adds a parameter; its number in the calibration, or `None` if it is known.
    ///
    /// # Errors
    /// Numbers of the process that are not what they must be; a name that is there already.
    pub fn add(
        &mut self,
        network: &str,
        name: String,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<Option<usize>, ObservationError> {
        let truth = TrueBias::new(process.clone(), &name, self.seed);
        let parameter = self.parameter(network, name, unit, placement, process)?;
        if process.known {
            self.known.push((parameter, truth));
            return Ok(None);
        }
        Ok(Some(self.estimate(parameter, Some(truth))))
    }

    /// Adds a parameter of recorded observations, of whose true value nothing is known; its number in the calibration.
    ///
    /// # Errors
    /// As [`Biases::add`].
    pub fn add_recorded(
        &mut self,
        network: &str,
        name: String,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<usize, ObservationError> {
        let parameter = self.parameter(network, name, unit, placement, process)?;
        Ok(self.estimate(parameter, None))
    }

    /// A parameter, as methods may know it.
    fn parameter(
        &mut self,
        network: &str,
        name: String,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<Parameter, ObservationError> {
        process.validate(network)?;
        if !self.names.insert(name.clone()) {
            return Err(ObservationError::duplicate_name(network, "biases", &name));
        }
        Ok(Parameter {
            name,
            unit: unit.to_owned(),
            placement,
            sigma_prior: process.sigma_prior(),
            drift: process.drift(),
        })
    }

    /// Adds a parameter to the calibration; its number there.
    fn estimate(&mut self, parameter: Parameter, truth: Option<TrueBias>) -> usize {
        self.values.push(truth.as_ref().map(|truth| truth.at(Duration::from_seconds(0), self.start)));
        self.truths.push(truth);
        self.calibration.parameters.push(parameter);
        self.values.len() - 1
    }

    /// Lets every true value evolve over `span`.
    pub fn advance(&mut self, span: Duration) {
        self.time = self.time + span;
        let elapsed = self.time - self.start;
        for (truth, value) in self.truths.iter_mut().zip(&mut self.values) {
            *value = truth.as_mut().map(|truth| {
                truth.advance(span);
                truth.at(elapsed, self.time)
            });
        }
        for (_, truth) in &mut self.known {
            truth.advance(span);
        }
    }

    /// The true values without jumps and the places in their random streams: estimated parameters, then known ones.
    pub fn save(&self) -> Vec<(f64, u128)> {
        let known = self.known.iter().map(|(_, truth)| truth);
        self.truths.iter().flatten().chain(known).map(|truth| (truth.value, truth.random.get_word_pos())).collect()
    }

    /// Takes back what [`Biases::save`] gave, as of `time`; whether it fits.
    pub fn restore(&mut self, time: Time, saved: &[(f64, u128)]) -> bool {
        if saved.len() != self.truths.iter().flatten().count() + self.known.len() {
            return false;
        }
        let known = self.known.iter_mut().map(|(_, truth)| truth);
        for (truth, &(value, random)) in self.truths.iter_mut().flatten().chain(known).zip(saved) {
            truth.value = value;
            truth.random.set_word_pos(random);
        }
        self.time = time;
        let elapsed = self.time - self.start;
        self.values = self.truths.iter().map(|truth| Some(truth.as_ref()?.at(elapsed, time))).collect();
        true
    }

    /// The parameters that methods must estimate.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// How their true values come to be, where these are known.
    pub fn processes(&self) -> impl Iterator<Item = &BiasProcess> {
        self.truths.iter().flatten().map(|truth| &truth.process)
    }

    /// Their true values now, where these are known.
    pub fn values(&self) -> &[Option<f64>] {
        &self.values
    }

    /// The known parameters, with their true values now.
    pub fn known(&self) -> impl Iterator<Item = (&Parameter, f64)> {
        let elapsed = self.time - self.start;
        self.known.iter().map(move |(parameter, truth)| (parameter, truth.at(elapsed, self.time)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bias::{AssumedDrift, Evolution};
    use crate::calibration::Drift;

    const DAY: Duration = Duration::from_seconds(86_400);

    /// `count` parameters of one process under seed 7.
    fn biases(process: &BiasProcess, count: usize) -> Biases {
        let mut biases = Biases::new(7, Time::from_seconds(0));
        for number in 0..count {
            biases.add("net", format!("net/h/{number}"), "m", Placement::Shared, process).unwrap();
        }
        biases
    }

    /// The true values of parameters that all have one.
    fn values(biases: &Biases) -> Vec<f64> {
        biases.values().iter().map(|value| value.unwrap()).collect()
    }

    /// Mean and mean square.
    fn moments(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        (values.iter().sum::<f64>() / n, values.iter().map(|value| value * value).sum::<f64>() / n)
    }

    #[test]
    fn drawn_biases_have_their_standard_deviation() {
        let values = values(&biases(&BiasProcess::constant(12.0), 4000));
        let (mean, square) = moments(&values);
        // Five standard errors: σ/√n of the mean, σ²√(2/n) of the variance.
        assert!(mean.abs() < 5.0 * 12.0 / 4000f64.sqrt(), "{mean}");
        assert!((square / 144.0 - 1.0).abs() < 5.0 * (2.0f64 / 4000.0).sqrt(), "{square}");
    }

    #[test]
    fn a_random_walk_spreads_as_the_root_of_time_whatever_the_step() {
        let process = BiasProcess {
            initial: InitialBias::Given { value: 3.0 },
            evolution: Evolution::RandomWalk { sigma_per_sqrt_day: 2.0 },
            ..BiasProcess::constant(1.0)
        };
        for steps in [1, 4, 16] {
            let mut biases = biases(&process, 4000);
            for _ in 0..steps {
                biases.advance(Duration::from_seconds(4 * DAY.seconds() / steps));
            }
            let changes: Vec<f64> = values(&biases).iter().map(|value| value - 3.0).collect();
            let (mean, square) = moments(&changes);
            // Four days: standard deviation 4; tolerances of five standard errors.
            assert!(mean.abs() < 5.0 * 4.0 / 4000f64.sqrt(), "{mean}");
            assert!((square / 16.0 - 1.0).abs() < 5.0 * (2.0f64 / 4000.0).sqrt(), "{steps} steps: {square}");
        }
    }

    /// Variance and correlation of an AR(1) process are those of its definition at any time and with any step.
    #[test]
    fn a_first_order_process_keeps_its_variance_and_forgets_exponentially() {
        let process =
            BiasProcess { evolution: Evolution::FirstOrder { correlation_hours: 48.0 }, ..BiasProcess::constant(3.0) };
        for steps in [1, 4, 16] {
            let mut biases = biases(&process, 8000);
            let before = values(&biases);
            for _ in 0..steps {
                biases.advance(Duration::from_seconds(3 * DAY.seconds() / steps));
            }
            let after = values(&biases);
            let (mean, square) = moments(&after);
            let products: Vec<f64> = before.iter().zip(&after).map(|(a, b)| a * b).collect();
            let correlation = moments(&products).0 / 9.0;
            let errors = 5.0 / 8000f64.sqrt();
            assert!(mean.abs() < 3.0 * errors && (square / 9.0 - 1.0).abs() < 2f64.sqrt() * errors, "{mean} {square}");
            assert!((correlation - (-1.5f64).exp()).abs() < 1.2 * errors, "{steps} steps: {correlation}");
        }
        let drift = process.drift();
        let (short, long) = (Duration::from_seconds(3600), Duration::from_seconds(7200));
        assert!((drift.kept(short).powi(2) - drift.kept(long)).abs() < 1e-15);
        let twice = drift.added_variance(short) * (1.0 + drift.kept(short).powi(2));
        assert!((twice / drift.added_variance(long) - 1.0).abs() < 1e-13);
    }

    #[test]
    fn a_jump_comes_at_its_time_and_stays() {
        let process = BiasProcess {
            initial: InitialBias::Given { value: 1.0 },
            evolution: Evolution::Jump { at_hours: 48.0, size: -5.0 },
            assumed_drift: Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: 0.5 }),
            ..BiasProcess::constant(1.0)
        };
        let mut biases = biases(&process, 1);
        let mut history = values(&biases);
        for _ in 0..4 {
            biases.advance(DAY);
            history.extend(values(&biases));
        }
        assert_eq!(history, [1.0, 1.0, -4.0, -4.0, -4.0]);
        let parameter = &biases.calibration().parameters[0];
        assert_eq!((parameter.sigma_prior, parameter.drift), (1.0, Drift::RandomWalk { sigma_per_sqrt_day: 0.5 }));
    }

    #[test]
    fn a_diurnal_bias_is_largest_at_its_hour() {
        let process = BiasProcess {
            initial: InitialBias::Given { value: 1.0 },
            evolution: Evolution::Sinusoid { amplitude: 2.0, period_hours: 24.0, peak_hours: 15.0 },
            ..BiasProcess::constant(1.0)
        };
        let mut biases = biases(&process, 1);
        let mut history = values(&biases);
        for _ in 0..8 {
            biases.advance(Duration::from_seconds(3 * 3600));
            history.extend(values(&biases));
        }
        for (number, value) in history.iter().enumerate() {
            let hours = 3.0 * number as f64 - 15.0;
            let expected = 1.0 + 2.0 * (std::f64::consts::TAU * hours / 24.0).cos();
            assert!((value - expected).abs() < 1e-12, "{number}: {value}");
        }
    }

    #[test]
    fn assumptions_are_the_truth_unless_given() {
        let mut process = BiasProcess::constant(2.0);
        process.evolution = Evolution::RandomWalk { sigma_per_sqrt_day: 0.7 };
        assert_eq!((process.sigma_prior(), process.drift()), (2.0, Drift::RandomWalk { sigma_per_sqrt_day: 0.7 }));
        process.initial = InitialBias::Given { value: -4.0 };
        assert_eq!(process.sigma_prior(), 4.0);
        process.evolution = Evolution::FirstOrder { correlation_hours: 3.0 };
        let correlation_time = Duration::from_seconds(10_800);
        assert_eq!(process.drift(), Drift::FirstOrder { sigma: 4.0, correlation_time });
        process.assumed_sigma_prior = Some(9.0);
        process.assumed_drift = Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: 0.0 });
        assert_eq!((process.sigma_prior(), process.drift()), (9.0, Drift::CONSTANT));
    }

    #[test]
    fn known_parameters_evolve_but_are_not_part_of_the_calibration() {
        let process = BiasProcess {
            initial: InitialBias::Given { value: 1.0 },
            evolution: Evolution::Jump { at_hours: 24.0, size: 1.0 },
            known: true,
            ..BiasProcess::constant(1.0)
        };
        let mut biases = biases(&process, 2);
        biases.advance(DAY);
        assert!(biases.calibration().is_empty() && biases.values().is_empty());
        let known: Vec<_> = biases.known().map(|(parameter, value)| (parameter.name.as_str(), value)).collect();
        assert_eq!(known, [("net/h/0", 2.0), ("net/h/1", 2.0)]);
    }

    #[test]
    fn a_parameter_does_not_depend_on_the_others() {
        let process =
            BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: 2.0 }, ..BiasProcess::constant(1.0) };
        let (mut few, mut many) = (biases(&process, 2), biases(&process, 5));
        few.advance(DAY);
        many.advance(DAY);
        assert_eq!(few.values(), &many.values()[..2]);
        assert_ne!(few.values()[0], few.values()[1]);
    }

    #[test]
    fn a_parameter_of_recorded_observations_has_no_true_value_and_changes_no_other() {
        let process =
            BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: 2.0 }, ..BiasProcess::constant(1.0) };
        let (mut alone, mut beside) = (biases(&process, 1), Biases::new(7, Time::from_seconds(0)));
        let recorded = beside.add_recorded("file", "file/h/a".to_owned(), "m", Placement::Shared, &process).unwrap();
        beside.add("net", "net/h/0".to_owned(), "m", Placement::Shared, &process).unwrap();
        alone.advance(DAY);
        beside.advance(DAY);
        assert_eq!((recorded, beside.values()), (0, &[None, alone.values()[0]][..]));
        let parameter = &beside.calibration().parameters[0];
        assert_eq!((parameter.sigma_prior, parameter.drift), (1.0, Drift::RandomWalk { sigma_per_sqrt_day: 2.0 }));
        let mut restored = beside.clone();
        beside.advance(DAY);
        assert!(restored.restore(beside.time, &beside.save()));
        assert_eq!(restored.values(), beside.values());
        assert_eq!((beside.save().len(), beside.processes().count()), (1, 1));
    }

    #[test]
    fn bad_numbers_and_repeated_names_are_errors() {
        let add = |process: &BiasProcess| {
            let mut biases = Biases::new(7, Time::from_seconds(0));
            biases.add("net", "net/h/a".to_owned(), "m", Placement::Shared, process).unwrap_err().to_string()
        };
        let good = BiasProcess::constant(1.0);
        let negative = add(&BiasProcess::constant(-1.0));
        assert!(negative.contains("biases.initial.sigma is -1, but must be at least 0"), "{negative}");
        let cases = [
            (BiasProcess { initial: InitialBias::Given { value: f64::NAN }, ..good.clone() }, "initial.value is NaN"),
            (BiasProcess { initial: InitialBias::Given { value: 0.0 }, ..good.clone() }, "sigma_prior is 0"),
            (BiasProcess { assumed_sigma_prior: Some(-1.0), ..good.clone() }, "sigma_prior is -1"),
            (
                BiasProcess {
                    assumed_drift: Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: -2.0 }),
                    ..good.clone()
                },
                "assumed_drift.sigma_per_sqrt_day is -2",
            ),
            (
                BiasProcess {
                    assumed_drift: Some(AssumedDrift::FirstOrder { correlation_hours: 0.0 }),
                    ..good.clone()
                },
                "assumed_drift.correlation_hours is 0",
            ),
            (
                BiasProcess { evolution: Evolution::FirstOrder { correlation_hours: -1.0 }, ..good.clone() },
                "evolution.correlation_hours is -1",
            ),
            (
                BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: -3.0 }, ..good.clone() },
                "evolution.sigma_per_sqrt_day is -3",
            ),
            (
                BiasProcess {
                    evolution: Evolution::Sinusoid { amplitude: 1.0, period_hours: 0.0, peak_hours: 0.0 },
                    ..good.clone()
                },
                "period_hours is 0",
            ),
            (
                BiasProcess { evolution: Evolution::Jump { at_hours: -1.0, size: 1.0 }, ..good.clone() },
                "at_hours is -1",
            ),
            (
                BiasProcess { evolution: Evolution::Jump { at_hours: 1.0, size: f64::INFINITY }, ..good.clone() },
                "size is inf",
            ),
        ];
        for (process, expected) in cases {
            let message = add(&process);
            assert!(message.contains(expected), "{message}");
        }
        let mut twice = biases(&good, 1);
        let error = twice.add("net", "net/h/0".to_owned(), "m", Placement::Shared, &good).unwrap_err();
        assert!(error.to_string().contains("biases has `net/h/0` twice"), "{error}");
    }
}
