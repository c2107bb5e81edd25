//! The filter's memory from cycle to cycle, for a checkpoint.

use super::factored_covariance::{FactoredCovariance, Patch};
use super::factors::Factors;
use super::{FastKalmanFilter, Precision};
use crate::error::Error;
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes, unfit};
use crate::tall_matrix::{TallMatrix, Values, stored};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// The factors of the state are in the precision of the settings.
#[derive(Serialize, Deserialize)]
struct Saved<S> {
    state: Vec<f64>,
    bias: Vec<f64>,
    /// The matrices of all blocks, one after another.
    own: Vec<f64>,
    /// Variables and covariance of each linked patch.
    linked: Vec<(Vec<usize>, Matrix)>,
    /// Number of factors, and their rows of the state, of the local parameters and of the shared ones.
    columns: usize,
    state_factors: Vec<S>,
    local_factors: Vec<f64>,
    shared_factors: Matrix,
    /// Place in the random stream of the probes.
    random: u128,
}

pub(super) fn save(filter: &FastKalmanFilter) -> Result<Vec<u8>, Error> {
    let FactoredCovariance { own, linked, factors } = &filter.covariance;
    stored!(factors.state.values(), of_state => to_bytes(&Saved {
        state: filter.state.values().to_vec(),
        bias: filter.bias.clone(),
        own: own.values().to_vec(),
        linked: linked.iter().map(|it| (it.variables.clone(), (&it.covariance).into())).collect(),
        columns: factors.columns(),
        state_factors: of_state.clone(),
        local_factors: (0..factors.columns()).flat_map(|column| factors.local.column(column).into_owned()).collect(),
        shared_factors: (&factors.shared).into(),
        random: filter.random.get_word_pos(),
    }))
}

pub(super) fn restore(filter: &mut FastKalmanFilter, saved: &[u8]) -> Result<(), Error> {
    match filter.settings.factor_precision {
        Precision::Double => restore_as::<f64>(filter, saved),
        Precision::Single => restore_as::<f32>(filter, saved),
    }
}

fn restore_as<S: DeserializeOwned>(filter: &mut FastKalmanFilter, saved: &[u8]) -> Result<(), Error>
where
    Values: From<Vec<S>>,
{
    let Saved::<S> { state, bias, own, linked, columns, state_factors, local_factors, shared_factors, random } =
        from_bytes(saved)?;
    restore_state(&mut filter.state, &state)?;
    restore_bias(&mut filter.bias, &bias)?;
    let FactoredCovariance { own: blocks, factors, .. } = &mut filter.covariance;
    if blocks.values().len() != own.len() {
        return Err(unfit("the covariance of the blocks"));
    }
    blocks.values_mut().copy_from_slice(&own);
    let fits = |rows: usize, length: usize| match rows.checked_mul(columns) == Some(length) {
        true => Ok(rows),
        false => Err(unfit("the matrix of the factors")),
    };
    let (of_state, of_local) =
        (fits(factors.state.rows(), state_factors.len())?, fits(factors.local.rows(), local_factors.len())?);
    let factors = Factors {
        state: TallMatrix::from_values(of_state, columns, state_factors),
        local: TallMatrix::from_values(of_local, columns, local_factors),
        shared: shared_factors.restored(filter.shared.len(), Some(columns), "the shared parameters' factors")?,
    };
    // No variable is in two patches, and those of a patch ascend.
    let mut held = vec![false; filter.blocks.variables()];
    for variables in linked.iter().map(|patch| &patch.0) {
        if !variables.is_sorted_by(|a, b| a < b) {
            return Err(unfit("a patch of blocks"));
        }
        for &variable in variables {
            match held.get_mut(variable) {
                Some(held) if !*held => *held = true,
                _ => return Err(unfit("a patch of blocks")),
            }
        }
    }
    let patch = |(variables, covariance): (Vec<usize>, Matrix)| {
        let size = variables.len();
        Ok(Patch { covariance: covariance.restored(size, Some(size), "the covariance of a patch")?, variables })
    };
    filter.covariance.linked = linked.into_iter().map(patch).collect::<Result<_, Error>>()?;
    filter.covariance.factors = factors;
    filter.random.set_word_pos(random);
    Ok(())
}
