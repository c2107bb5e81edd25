//! Biases: the true evolution of calibration parameters, and what methods may assume of it.

use crate::calibration::{Calibration, Parameter, Placement};
use crate::error::{ObservationError, require};
use isobar_model::random::stream;
use isobar_model::{Duration, Time};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// How one bias parameter b(t) truly behaves, and what methods may assume of it. Numbers are in the parameter's unit,
/// that of the observed variable.
#[derive(Clone, Debug, PartialEq)]
pub struct BiasProcess {
    /// The value at the start.
    pub initial: InitialBias,
    /// How it changes.
    pub evolution: Evolution,
    /// Standard deviation of the prior that methods assume; `None`: that of the truth, or the size of a given value.
    pub assumed_sigma_prior: Option<f64>,
    /// Standard deviation over one day of the random walk that methods assume; `None`: that of the truth, thus 0
    /// unless the truth is a random walk.
    pub assumed_sigma_drift_per_sqrt_day: Option<f64>,
    /// Whether the instrument is calibrated: the bias is taken out of the data before any method sees them, and is no
    /// parameter of the [`Calibration`].
    pub known: bool,
}

/// The true value of a bias parameter at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialBias {
    /// Drawn from N(0, `sigma`²).
    Drawn {
        /// Standard deviation, at least 0.
        sigma: f64,
    },
    /// Given.
    Given {
        /// The value.
        value: f64,
    },
}

/// How the true value of a bias parameter changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Evolution {
    /// Not at all.
    Constant,
    /// A Wiener process: b(t + Δt) = b(t) + N(0, σ² Δt), Δt in days.
    RandomWalk {
        /// σ, the standard deviation of the change over one day.
        sigma_per_sqrt_day: f64,
    },
    /// It is larger by `size` from one time on: a recalibration, a new type of sonde.
    Jump {
        /// When, in hours since the start; at least 0.
        at_hours: f64,
        /// By how much, of either sign.
        size: f64,
    },
}

impl BiasProcess {
    /// A constant drawn from N(0, `sigma`²), of which methods know `sigma`.
    pub fn constant(sigma: f64) -> Self {
        Self {
            initial: InitialBias::Drawn { sigma },
            evolution: Evolution::Constant,
            assumed_sigma_prior: None,
            assumed_sigma_drift_per_sqrt_day: None,
            known: false,
        }
    }

    /// The standard deviation of the prior that methods assume.
    pub fn sigma_prior(&self) -> f64 {
        self.assumed_sigma_prior.unwrap_or(match self.initial {
            InitialBias::Drawn { sigma } => sigma,
            InitialBias::Given { value } => value.abs(),
        })
    }

    /// The standard deviation over one day of the random walk that methods assume.
    pub fn sigma_drift_per_sqrt_day(&self) -> f64 {
        self.assumed_sigma_drift_per_sqrt_day.unwrap_or(match self.evolution {
            Evolution::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day,
            Evolution::Constant | Evolution::Jump { .. } => 0.0,
        })
    }

    /// The mean of the true value over all that it might be, so long after the start.
    pub fn mean(&self, elapsed: Duration) -> f64 {
        let initial = match self.initial {
            InitialBias::Drawn { .. } => 0.0,
            InitialBias::Given { value } => value,
        };
        initial + self.jumped(elapsed)
    }

    /// The variance of the true value at the start.
    pub fn initial_variance(&self) -> f64 {
        match self.initial {
            InitialBias::Drawn { sigma } => sigma * sigma,
            InitialBias::Given { .. } => 0.0,
        }
    }

    /// The variance that the true value gains in a day.
    pub fn variance_per_day(&self) -> f64 {
        match self.evolution {
            Evolution::RandomWalk { sigma_per_sqrt_day } => sigma_per_sqrt_day.powi(2),
            Evolution::Constant | Evolution::Jump { .. } => 0.0,
        }
    }

    /// By how much it has jumped.
    fn jumped(&self, elapsed: Duration) -> f64 {
        match self.evolution {
            Evolution::Jump { at_hours, size } if elapsed.as_f64() >= at_hours * 3600.0 => size,
            _ => 0.0,
        }
    }

    fn validate(&self, instrument: &str) -> Result<(), ObservationError> {
        match self.initial {
            InitialBias::Drawn { sigma } => {
                require(sigma >= 0.0, instrument, "biases.initial.sigma", sigma, "at least 0")?;
            }
            InitialBias::Given { value } => require(true, instrument, "biases.initial.value", value, "finite")?,
        }
        match self.evolution {
            Evolution::Constant => {}
            Evolution::RandomWalk { sigma_per_sqrt_day: sigma } => {
                require(sigma >= 0.0, instrument, "biases.evolution.sigma_per_sqrt_day", sigma, "at least 0")?;
            }
            Evolution::Jump { at_hours, size } => {
                require(at_hours >= 0.0, instrument, "biases.evolution.at_hours", at_hours, "at least 0")?;
                require(true, instrument, "biases.evolution.size", size, "finite")?;
            }
        }
        if !self.known {
            let prior = self.sigma_prior();
            let expected = "above 0: it is the prior of an unknown parameter, by default that of the true value \
                            (give it, or take the bias out, or make it known)";
            require(prior > 0.0, instrument, "biases.assumed_sigma_prior", prior, expected)?;
            let drift = self.sigma_drift_per_sqrt_day();
            let setting = "biases.assumed_sigma_drift_per_sqrt_day";
            require(drift >= 0.0, instrument, setting, drift, "at least 0")?;
        }
        Ok(())
    }
}

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
        if let Evolution::RandomWalk { sigma_per_sqrt_day } = self.process.evolution {
            let normal: f64 = StandardNormal.sample(&mut self.random);
            self.value += sigma_per_sqrt_day * span.days().sqrt() * normal;
        }
    }

    fn at(&self, elapsed: Duration) -> f64 {
        self.value + self.process.jumped(elapsed)
    }
}

/// All bias parameters of an observing system: those that methods must estimate, and those that are known.
#[derive(Clone, Debug)]
pub(crate) struct Biases {
    seed: u64,
    start: Time,
    time: Time,
    calibration: Calibration,
    truths: Vec<TrueBias>,
    values: Vec<f64>,
    known: Vec<(Parameter, TrueBias)>,
}

impl Biases {
    /// No parameters yet.
    pub fn new(seed: u64, start: Time) -> Self {
        let (calibration, truths, values, known) = Default::default();
        Self { seed, start, time: start, calibration, truths, values, known }
    }

    /// Adds a parameter; its number in the calibration, or `None` if it is known.
    ///
    /// # Errors
    /// Numbers of the process that are not what they must be; a name that is there already.
    pub fn add(
        &mut self,
        instrument: &str,
        name: String,
        unit: &str,
        placement: Placement,
        process: &BiasProcess,
    ) -> Result<Option<usize>, ObservationError> {
        process.validate(instrument)?;
        if self.calibration.position(&name).is_some() || self.known.iter().any(|known| known.0.name == name) {
            return Err(ObservationError::DuplicateName {
                instrument: instrument.to_owned(),
                setting: "biases",
                value: name,
            });
        }
        let truth = TrueBias::new(process.clone(), &name, self.seed);
        let parameter = Parameter {
            name,
            unit: unit.to_owned(),
            placement,
            sigma_prior: process.sigma_prior(),
            sigma_drift_per_sqrt_day: process.sigma_drift_per_sqrt_day(),
        };
        if process.known {
            self.known.push((parameter, truth));
            return Ok(None);
        }
        self.values.push(truth.at(Duration::from_seconds(0)));
        self.truths.push(truth);
        self.calibration.parameters.push(parameter);
        Ok(Some(self.values.len() - 1))
    }

    /// Lets every true value evolve over `span`.
    pub fn advance(&mut self, span: Duration) {
        self.time = self.time + span;
        let elapsed = self.time - self.start;
        for (truth, value) in self.truths.iter_mut().zip(&mut self.values) {
            truth.advance(span);
            *value = truth.at(elapsed);
        }
        for (_, truth) in &mut self.known {
            truth.advance(span);
        }
    }

    /// The true values without jumps and the places in their random streams: estimated parameters, then known ones.
    pub fn save(&self) -> Vec<(f64, u128)> {
        let known = self.known.iter().map(|(_, truth)| truth);
        self.truths.iter().chain(known).map(|truth| (truth.value, truth.random.get_word_pos())).collect()
    }

    /// Takes back what [`Biases::save`] gave, as of `time`; whether it fits.
    pub fn restore(&mut self, time: Time, saved: &[(f64, u128)]) -> bool {
        if saved.len() != self.truths.len() + self.known.len() {
            return false;
        }
        let known = self.known.iter_mut().map(|(_, truth)| truth);
        for (truth, &(value, random)) in self.truths.iter_mut().chain(known).zip(saved) {
            truth.value = value;
            truth.random.set_word_pos(random);
        }
        self.time = time;
        let elapsed = self.time - self.start;
        self.values = self.truths.iter().map(|truth| truth.at(elapsed)).collect();
        true
    }

    /// The parameters that methods must estimate.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// How their true values come to be.
    pub fn processes(&self) -> impl Iterator<Item = &BiasProcess> {
        self.truths.iter().map(|truth| &truth.process)
    }

    /// Their true values now.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The known parameters, with their true values now.
    pub fn known(&self) -> impl Iterator<Item = (&Parameter, f64)> {
        let elapsed = self.time - self.start;
        self.known.iter().map(move |(parameter, truth)| (parameter, truth.at(elapsed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: Duration = Duration::from_seconds(86_400);

    /// `count` parameters of one process under seed 7.
    fn biases(process: &BiasProcess, count: usize) -> Biases {
        let mut biases = Biases::new(7, Time::from_seconds(0));
        for number in 0..count {
            biases.add("net", format!("net/h/{number}"), "m", Placement::Shared, process).unwrap();
        }
        biases
    }

    /// Mean and mean square.
    fn moments(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        (values.iter().sum::<f64>() / n, values.iter().map(|value| value * value).sum::<f64>() / n)
    }

    #[test]
    fn drawn_biases_have_their_standard_deviation() {
        let values = biases(&BiasProcess::constant(12.0), 4000).values().to_vec();
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
            let changes: Vec<f64> = biases.values().iter().map(|value| value - 3.0).collect();
            let (mean, square) = moments(&changes);
            // Four days: standard deviation 4; tolerances of five standard errors.
            assert!(mean.abs() < 5.0 * 4.0 / 4000f64.sqrt(), "{mean}");
            assert!((square / 16.0 - 1.0).abs() < 5.0 * (2.0f64 / 4000.0).sqrt(), "{steps} steps: {square}");
        }
    }

    #[test]
    fn a_jump_comes_at_its_time_and_stays() {
        let process = BiasProcess {
            initial: InitialBias::Given { value: 1.0 },
            evolution: Evolution::Jump { at_hours: 48.0, size: -5.0 },
            assumed_sigma_drift_per_sqrt_day: Some(0.5),
            ..BiasProcess::constant(1.0)
        };
        let mut biases = biases(&process, 1);
        let mut history = vec![biases.values()[0]];
        for _ in 0..4 {
            biases.advance(DAY);
            history.push(biases.values()[0]);
        }
        assert_eq!(history, [1.0, 1.0, -4.0, -4.0, -4.0]);
        let parameter = &biases.calibration().parameters[0];
        assert_eq!((parameter.sigma_prior, parameter.sigma_drift_per_sqrt_day), (1.0, 0.5));
    }

    #[test]
    fn assumptions_are_the_truth_unless_given() {
        let mut process = BiasProcess::constant(2.0);
        process.evolution = Evolution::RandomWalk { sigma_per_sqrt_day: 0.7 };
        assert_eq!((process.sigma_prior(), process.sigma_drift_per_sqrt_day()), (2.0, 0.7));
        process.initial = InitialBias::Given { value: -4.0 };
        assert_eq!(process.sigma_prior(), 4.0);
        (process.assumed_sigma_prior, process.assumed_sigma_drift_per_sqrt_day) = (Some(9.0), Some(0.0));
        assert_eq!((process.sigma_prior(), process.sigma_drift_per_sqrt_day()), (9.0, 0.0));
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
            (BiasProcess { assumed_sigma_drift_per_sqrt_day: Some(-2.0), ..good.clone() }, "per_sqrt_day is -2"),
            (
                BiasProcess { evolution: Evolution::RandomWalk { sigma_per_sqrt_day: -3.0 }, ..good.clone() },
                "evolution.sigma_per_sqrt_day is -3",
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
