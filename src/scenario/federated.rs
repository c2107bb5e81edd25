//! What a method of kind `federated_kf` may say.

use crate::reader::{Limits, Read, Section};
use isobar_assim::federated::FederatedSettings;

pub(super) const KEYS: [&str; 5] = ["bias", "adapt", "information_sharing", "reset_every_cycles", "memory_limit_gb"];

/// How far the sum of information-sharing factors may be from 1, for factors such as 0.333.
const ROUNDING: f64 = 0.005;

/// Reads the division of a filter among the observing systems of these names, of which biases may be frozen in a run.
pub(super) fn read(section: &Section<'_>, networks: &[&str], freezes: bool) -> Read<FederatedSettings> {
    if freezes {
        let message = "local filters have no place for what frozen biases of two systems have in common".to_string();
        let label = "choose another kind of method, or leave out `freeze_after_cycles`";
        return Err(section.required("kind")?.misplaced(message, label));
    }
    let reset_every_cycles =
        Some(section.whole_or("reset_every_cycles", 1, 0, 1_000_000)?).filter(|&cycles| cycles > 0);
    let share = match section.optional("information_sharing") {
        None => vec![1.0; networks.len()],
        Some(field) => {
            let shares = field.section(networks)?;
            let limits = Limits::Between(1e-6, 1.0);
            let share = networks.iter().map(|name| shares.number(name, limits)).collect::<Read<Vec<f64>>>()?;
            let sum: f64 = share.iter().sum();
            if (sum - 1.0).abs() > ROUNDING {
                let message = format!("the factors of `{}` sum to {sum}", field.title());
                return Err(field.invalid(message, "must sum to 1"));
            }
            share
        }
    };
    let sum: f64 = share.iter().sum();
    let systems = networks.iter().zip(share).map(|(name, share)| (name.to_string(), share / sum)).collect();
    Ok(FederatedSettings { systems, reset_every_cycles })
}
