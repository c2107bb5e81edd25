//! When biases without a stable update are adjusted no more.

use serde::{Deserialize, Serialize};

/// By what rule biases are frozen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Freezing {
    /// All are adjusted in every analysis.
    #[default]
    Never,
    /// After this cycle those without a stable update go back to their prior for good.
    AfterCycle(usize),
    /// While they have no stable update.
    WhileUnstable(Hysteresis),
}

/// A bias is frozen, with its current estimate and variance, after `unstable_cycles` in succession without a stable update, and
/// adjusted again after `stable_cycles` in succession with one.
///
/// While it is frozen, the method is a Schmidt–Kalman filter (see [`isobar_assim::Calibrated`]), and the verdict is that on the
/// update that it does not get: by the variance that it would have left. Innovations of a filter with a frozen bias are not
/// white, and so no part of that verdict; once the bias is adjusted again, their correlation is gathered anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hysteresis {
    /// Cycles in succession without a stable update, after which a bias is frozen; at least 1.
    pub unstable_cycles: usize,
    /// Cycles in succession with one, after which it is adjusted again; at least 1.
    pub stable_cycles: usize,
}

/// The last verdict on a bias, and for how many cycles in succession it has been the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Standing {
    pub stable: bool,
    pub frozen: bool,
    cycles: usize,
}

impl Standing {
    /// That of a bias on which there was this verdict before, if there was one.
    pub fn after(before: Option<Self>, stable: bool, frozen: bool) -> Self {
        let cycles = before.filter(|before| before.stable == stable).map_or(0, |before| before.cycles);
        Self { stable, frozen, cycles: cycles + 1 }
    }

    /// The same, as if it were of no cycle yet.
    pub fn uncounted(self) -> Self {
        Self { cycles: 0, ..self }
    }

    /// Whether the bias is to be frozen from now on.
    pub fn is_to_be_frozen(&self, rule: Hysteresis) -> bool {
        match (self.frozen, self.stable) {
            (false, false) => self.cycles >= rule.unstable_cycles,
            (true, true) => self.cycles < rule.stable_cycles,
            (frozen, _) => frozen,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bias_is_frozen_and_thawed_after_as_many_cycles_in_succession_as_the_rule_says() {
        let rule = Hysteresis { unstable_cycles: 2, stable_cycles: 3 };
        let mut standing: Option<Standing> = None;
        let verdicts = [false, true, false, false, true, true, false, true, true, true, false, true];
        let frozen = verdicts.map(|stable| {
            let frozen = standing.is_some_and(|it| it.frozen);
            let mut now = Standing::after(standing, stable, frozen);
            now.frozen = now.is_to_be_frozen(rule);
            standing = Some(now);
            now.frozen
        });
        assert_eq!(frozen, [false, false, false, true, true, true, true, true, true, false, false, false]);
    }
}
