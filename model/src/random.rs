//! Seeded random streams, one for each purpose, so that adding one never changes another.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::hash::Hasher;

/// The random stream of `purpose` (`"truth"`, `"observations/europe"`, …) under the experiment's seed.
pub fn stream(seed: u64, purpose: &str) -> ChaCha8Rng {
    let mut hasher = fnv::FnvHasher::default();
    hasher.write(purpose.as_bytes());
    let mut stream = ChaCha8Rng::seed_from_u64(seed);
    stream.set_stream(hasher.finish());
    stream
}

/// `n` independent draws of N(0, 1).
pub fn standard_normals(stream: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    (0..n).map(|_| StandardNormal.sample(stream)).collect()
}
