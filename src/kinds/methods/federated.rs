//! `kind = "federated_kf"`.

use super::adapt::ADAPT;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, MethodSettings, Setup, Sizes, Surroundings,
    Work,
};
use crate::kinds::Kind;
use crate::kinds::models::Model;
use crate::reader::{Absent, Described, Form, Key, Limits, Read, Section, Whole};
use isobar_assim::federated::{FederatedKalmanFilter, FederatedSettings};
use isobar_assim::{Assimilator, Error};

pub(super) const INFORMATION_SHARING: Key<Described> = Key::absent(
    "information_sharing",
    "1",
    Described("a table with a factor for each network; their sum is 1", || {
        Form::Named(&[], Box::new(Form::Number(SHARE)))
    }),
    Absent::Explained("equal shares"),
    "which part of the common information each system's filter has",
);

/// The part that the filter of a network has.
const SHARE: Limits = Limits::Between(1e-6, 1.0);

pub(super) const RESET_EVERY_CYCLES: Key<Whole> = Key::absent(
    "reset_every_cycles",
    "cycles",
    Whole(0, 1_000_000),
    Absent::Means(1),
    "how often the systems' filters start again from the fused estimate; 0: never",
);

/// How far the sum of information-sharing factors may be from 1, for factors such as 0.333.
const ROUNDING: f64 = 0.005;

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "federated_kf",
    "A Kalman filter for each observing system, and a master that fuses them",
    &[&[
        &BIAS,
        &ERROR_CORRELATION,
        &FIRST_GUESS,
        &COMPARISONS,
        &ADAPT,
        &INFORMATION_SHARING,
        &RESET_EVERY_CYCLES,
        &MEMORY_LIMIT_GB,
    ]],
    |section, surroundings| Ok(Box::new(read(section, surroundings)?)),
);

/// Reads how a federated filter is divided.
pub(super) fn read(section: &Section<'_>, surroundings: &Surroundings) -> Read<FederatedSettings> {
    let networks: Vec<&str> = surroundings.networks.iter().map(String::as_str).collect();
    if networks.is_empty() {
        let message = "a federated filter has a filter for each network, and there are no networks".to_string();
        return Err(section.required("kind")?.misplaced(message, "add a network, or choose another kind of method"));
    }
    let reset_every_cycles = Some(section.get(&RESET_EVERY_CYCLES)?).filter(|&cycles| cycles > 0);
    let shares = shares(section, &networks)?;
    let sum: f64 = shares.iter().sum();
    let systems = networks.iter().zip(shares).map(|(name, share)| (name.to_string(), share / sum)).collect();
    Ok(FederatedSettings { systems, reset_every_cycles })
}

/// The factor of each network, to rounding.
fn shares(section: &Section<'_>, networks: &[&str]) -> Read<Vec<f64>> {
    let Some(field) = section.optional(INFORMATION_SHARING.name) else { return Ok(vec![1.0; networks.len()]) };
    let table = field.section(networks)?;
    let shares = networks.iter().map(|name| table.number(name, SHARE)).collect::<Read<Vec<f64>>>()?;
    let sum: f64 = shares.iter().sum();
    if (sum - 1.0).abs() > ROUNDING {
        let message = format!("the factors of `{}` sum to {sum}", field.title());
        return Err(field.invalid(message, "must sum to 1"));
    }
    Ok(shares)
}

/// How a federated filter is divided, in words.
pub(super) fn describe(settings: &FederatedSettings) -> String {
    let reset = match settings.reset_every_cycles {
        None => "never reset".to_string(),
        Some(1) => "reset in every cycle".to_string(),
        Some(cycles) => format!("reset every {cycles} cycles"),
    };
    let shares = settings.systems.iter().map(|(name, share)| format!("{name} {share:.3}"));
    format!("information shared as {}, {reset}", shares.collect::<Vec<_>>().join(", "))
}

impl MethodSettings for FederatedSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(FederatedKalmanFilter::new(setup.problem, self.clone())?))
    }

    fn work(&self, sizes: &Sizes) -> Work {
        // A dense filter for each system, and the master.
        let filters = self.systems.len() as f64 + 1.0;
        let one = Work::dense(sizes);
        Work {
            numbers: 5.0 * filters * sizes.unknowns().powi(2),
            tangent_steps: one.tangent_steps * filters,
            multiplications: one.multiplications * filters,
            steps: one.steps * filters,
            ..one
        }
    }

    fn describe(&self) -> String {
        format!("federated Kalman filter, {}", describe(self))
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        if self.systems.len() == 1 || self.reset_every_cycles == Some(1) {
            Ok(())
        } else {
            Err("its local filters go on from estimates of their own")
        }
    }

    fn warning(&self, model: &Model) -> Option<&'static str> {
        let goes_astray = self.reset_every_cycles != Some(1) && self.systems.len() > 1;
        (goes_astray && !model.equations.is_linear()).then_some(
            "with reset_every_cycles other than 1 on a nonlinear model each local filter linearises about an estimate of its \
             own, which drifts away; its claimed errors are too small, and if it is never reset (0) it may be worse than no \
             assimilation",
        )
    }

    fn takes_comparisons(&self) -> Result<(), &'static str> {
        Err("no local filter sees the sensors of two systems")
    }

    fn can_freeze_biases(&self) -> Result<(), &'static str> {
        Err("local filters have no place for what frozen biases of two systems have in common")
    }
}
