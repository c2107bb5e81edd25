//! Stations that are withheld from the methods to verify their estimates.

use crate::error::ObservationError;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// A platform that may report in more than one cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Platform {
    /// Its name in reports.
    pub name: Arc<str>,
    /// The calibration parameters of its observations, by number.
    pub biases: BTreeSet<usize>,
}

/// The withheld platforms of a network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Withheld {
    /// Their names, in order.
    pub names: BTreeSet<Arc<str>>,
    /// The number of all platforms of the network.
    pub of: usize,
}

impl Withheld {
    /// Chooses a share of the platforms at random, rounded to a whole number, and at least one. Each bias keeps a platform that
    /// is not withheld, since nothing else could determine it.
    ///
    /// # Errors
    /// If there are no platforms, or too few that can be withheld.
    pub(crate) fn choose(
        share: f64,
        platforms: &[Platform],
        network: &str,
        random: &mut ChaCha8Rng,
    ) -> Result<Self, ObservationError> {
        let fault = |problem: String| Err(ObservationError::in_setting(network, "withhold", problem));
        if platforms.is_empty() {
            return fault(format!("withhold is {share}, a share of stations, and the network has no stations"));
        }
        let count = ((share * platforms.len() as f64).round() as usize).max(1);
        let mut order: Vec<usize> = (0..platforms.len()).collect();
        for last in (1..order.len()).rev() {
            order.swap(last, random.random_range(0..=last));
        }
        let mut assimilated: HashMap<usize, usize> = HashMap::new();
        platforms.iter().flat_map(|it| &it.biases).for_each(|&bias| *assimilated.entry(bias).or_default() += 1);
        let mut names = BTreeSet::new();
        for number in order {
            let Platform { name, biases } = &platforms[number];
            let is_last = names.len() + 1 == platforms.len();
            if names.len() < count && !is_last && biases.iter().all(|bias| assimilated[bias] > 1) {
                biases.iter().for_each(|bias| *assimilated.entry(*bias).or_default() -= 1);
                names.insert(Arc::clone(name));
            }
        }
        if names.len() < count {
            return fault(format!(
                "withhold is {share}, which is {count} of {} stations, but only {} can be withheld: the others have biases that \
                 no other station would determine, or are the last one",
                platforms.len(),
                names.len()
            ));
        }
        Ok(Self { names, of: platforms.len() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::stream;

    fn platforms(biases: &[&[usize]]) -> Vec<Platform> {
        let platform = |(number, own): (usize, &&[usize])| Platform {
            name: number.to_string().into(),
            biases: own.iter().copied().collect(),
        };
        biases.iter().enumerate().map(platform).collect()
    }

    fn choose(share: f64, biases: &[&[usize]], seed: u64) -> Result<Vec<String>, String> {
        let chosen = Withheld::choose(share, &platforms(biases), "net", &mut stream(seed, "withheld"));
        chosen.map(|it| it.names.iter().map(ToString::to_string).collect()).map_err(|error| error.to_string())
    }

    #[test]
    fn the_share_is_kept_and_the_seed_chooses() {
        let none: Vec<&[usize]> = vec![&[]; 20];
        let mut times = [0; 20];
        for seed in 0..2000 {
            let chosen = choose(0.2, &none, seed).unwrap();
            assert_eq!(chosen.len(), 4);
            chosen.iter().for_each(|name| times[name.parse::<usize>().unwrap()] += 1);
        }
        // Each is chosen 400 times, with a standard deviation of √(2000 · 0.2 · 0.8) = 18.
        assert!(times.iter().all(|&times| (310..490).contains(&times)), "{times:?}");
        assert_eq!(choose(0.2, &none, 7), choose(0.2, &none, 7));
        assert_ne!(choose(0.2, &none, 7), choose(0.2, &none, 8));
        assert_eq!(choose(0.001, &none, 1).unwrap().len(), 1);
    }

    #[test]
    fn no_bias_is_left_to_those_that_are_withheld() {
        // One bias of three, one of two of them, one of a single station; and a station without.
        let biases: [&[usize]; 6] = [&[0], &[0, 1], &[0, 1], &[2], &[], &[]];
        for seed in 0..200 {
            let chosen = choose(0.5, &biases, seed).unwrap();
            assert!(!chosen.contains(&"3".to_string()));
            let is_left =
                |bias: usize| (0..6).any(|it| biases[it].contains(&bias) && !chosen.contains(&it.to_string()));
            assert!((0..3).all(is_left), "{chosen:?}");
        }
        let error = choose(0.5, &[&[0], &[1], &[2], &[]], 1).unwrap_err();
        assert!(error.contains("withhold is 0.5, which is 2 of 4 stations, but only 1 can be withheld"), "{error}");
        assert!(choose(0.5, &[], 1).unwrap_err().contains("the network has no stations"));
        assert!(choose(0.9, &[&[]], 1).unwrap_err().contains("only 0 can be withheld"));
    }
}
