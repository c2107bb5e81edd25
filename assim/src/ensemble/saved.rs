//! What a checkpoint holds of an ensemble method.

use super::members::Ensemble;
use crate::error::Error;
use crate::saved::{from_bytes, to_bytes, unfit};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Members, factors of adaptive inflation, and the place in the random stream.
#[derive(Serialize, Deserialize)]
struct Saved {
    members: Vec<f64>,
    variance_factors: Vec<f64>,
    random: u128,
}

pub(super) fn save(ensemble: &Ensemble, variance_factors: &[f64], random: &ChaCha8Rng) -> Result<Vec<u8>, Error> {
    let members = (0..ensemble.members()).flat_map(|member| ensemble.member(member)).copied().collect();
    to_bytes(&Saved { members, variance_factors: variance_factors.to_vec(), random: random.get_word_pos() })
}

/// Takes back what [`save`] gave.
///
/// # Errors
/// [`Error::Saved`] if it is of another ensemble.
pub(super) fn restore(
    saved: &[u8],
    ensemble: &mut Ensemble,
    variance_factors: &mut [f64],
    random: &mut ChaCha8Rng,
) -> Result<(), Error> {
    let Saved { members, variance_factors: factors, random: place } = from_bytes(saved)?;
    if factors.len() != variance_factors.len() {
        return Err(unfit("the inflation"));
    }
    ensemble.restore(members)?;
    variance_factors.copy_from_slice(&factors);
    random.set_word_pos(place);
    Ok(())
}
