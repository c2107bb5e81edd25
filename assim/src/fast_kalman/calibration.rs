//! A calibration from elsewhere: see [`Assimilator::set_calibration`](crate::Assimilator::set_calibration).

use super::FastKalmanFilter;
use crate::error::Error;
use crate::linalg::cholesky;
use faer::{Mat, MatRef};

/// With Cov(ĉ) = L Lᵀ, shared parameters before local ones, the columns of L that the shared ones have become factors; of
/// what the local ones have beyond them each keeps its variance.
pub(super) fn set(filter: &mut FastKalmanFilter, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
    let numbers: Vec<usize> = filter.shared.iter().chain(&filter.local).copied().collect();
    let (p, shared) = (numbers.len(), filter.shared.len());
    if estimate.len() != p || covariance.nrows() != p {
        return Err(Error::Setting("the calibration is not the one that the method estimates".into()));
    }
    let ordered = Mat::from_fn(p, p, |i, j| covariance[(numbers[i], numbers[j])]);
    let root = cholesky(ordered, || "the covariance of the calibration".into())?;
    numbers.iter().for_each(|&number| filter.bias[number] = estimate[number]);
    let m = filter.state.values().len();
    let factors = &mut filter.covariance.factors;
    factors.shared.fill(0.0);
    for column in 0..factors.columns() {
        factors.local.column_mut(column).fill(0.0);
    }
    let before = factors.columns();
    factors.append(shared);
    for j in 0..shared {
        (0..shared).for_each(|i| factors.shared[(i, before + j)] = root[(i, j)]);
        (shared..p).for_each(|i| factors.local.column_mut(before + j)[i - shared] = root[(i, j)]);
    }
    filter.covariance.linked.clear();
    for i in shared..p {
        let variance = (shared..=i).map(|j| root[(i, j)].powi(2)).sum();
        let (block, position) = filter.blocks.place(m + i - shared);
        let mut own = filter.covariance.own.block_mut(&filter.blocks, block);
        for other in 0..own.nrows() {
            (own[(position, other)], own[(other, position)]) = (0.0, 0.0);
        }
        own[(position, position)] = variance;
    }
    Ok(())
}
