//! The filter's memory from cycle to cycle, for a checkpoint.

use super::FastKalmanFilter;
use super::factored_covariance::{FactoredCovariance, Patch};
use super::factors::Factors;
use crate::error::Error;
use crate::saved::{Matrix, from_bytes, restore_bias, restore_state, to_bytes, unfit};
use crate::tall_matrix::TallMatrix;
use faer::MatRef;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
struct Saved {
    state: Vec<f64>,
    bias: Vec<f64>,
    /// The matrices of all blocks, one after another.
    own: Vec<f64>,
    /// Variables and covariance of each linked patch.
    linked: Vec<(Vec<usize>, Matrix)>,
    /// Number of factors, and their rows of the state, of the local parameters and of the shared ones.
    columns: usize,
    state_factors: Vec<f64>,
    local_factors: Vec<f64>,
    shared_factors: Matrix,
    /// Place in the random stream of the probes.
    random: u128,
}

/// The columns of a matrix, one after another.
fn values(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let columns = matrix.col_iter().map(|it| it.try_as_col_major().expect("columns are contiguous").as_slice());
    columns.flatten().copied().collect()
}

pub(super) fn save(filter: &FastKalmanFilter) -> Result<Vec<u8>, Error> {
    let FactoredCovariance { own, linked, factors } = &filter.covariance;
    to_bytes(&Saved {
        state: filter.state.values().to_vec(),
        bias: filter.bias.clone(),
        own: own.values().to_vec(),
        linked: linked.iter().map(|it| (it.variables.clone(), (&it.covariance).into())).collect(),
        columns: factors.columns(),
        state_factors: values(factors.state.as_ref()),
        local_factors: values(factors.local.as_ref()),
        shared_factors: (&factors.shared).into(),
        random: filter.random.get_word_pos(),
    })
}

pub(super) fn restore(filter: &mut FastKalmanFilter, saved: &[u8]) -> Result<(), Error> {
    let Saved { state, bias, own, linked, columns, state_factors, local_factors, shared_factors, random } =
        from_bytes(saved)?;
    restore_state(&mut filter.state, &state)?;
    restore_bias(&mut filter.bias, &bias)?;
    let FactoredCovariance { own: blocks, factors, .. } = &mut filter.covariance;
    if blocks.values().len() != own.len() {
        return Err(unfit("the covariance of the blocks"));
    }
    blocks.values_mut().copy_from_slice(&own);
    let tall = |rows: usize, values: Vec<f64>| match rows.checked_mul(columns) {
        Some(length) if length == values.len() => Ok(TallMatrix::from_values(rows, columns, values)),
        _ => Err(unfit("the matrix of the factors")),
    };
    let factors = Factors {
        state: tall(factors.state.rows(), state_factors)?,
        local: tall(factors.local.rows(), local_factors)?,
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
