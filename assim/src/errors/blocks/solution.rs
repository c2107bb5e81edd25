//! What goes into an analysis, and what comes out of it beside the covariance.

use crate::block_angular::PartitionReport;
use crate::problem::Innovations;
use faer::Mat;
use isobar_obs::SparseRows;

/// The Jacobians by block variables b and shared parameters c.
pub(crate) struct SplitRows {
    pub block: SparseRows,
    pub shared: SparseRows,
}

impl SplitRows {
    /// The rows of H, where the block variables are the state's values and then the local parameters, in the order of these
    /// numbers.
    pub fn new(innovations: &Innovations, local: &[usize], shared: &[usize]) -> Self {
        let mut position = vec![(false, 0); local.len() + shared.len()];
        local.iter().enumerate().for_each(|(i, &number)| position[number] = (true, innovations.state_values + i));
        shared.iter().enumerate().for_each(|(i, &number)| position[number] = (false, i));
        let (mut block, mut shared) = (SparseRows::new(), SparseRows::new());
        for row in 0..innovations.len() {
            let calibration = innovations.jacobian.calibration.row(row);
            let of = |local: bool| {
                let position = &position;
                calibration
                    .iter()
                    .filter(move |entry| position[entry.0].0 == local)
                    .map(|entry| (position[entry.0].1, entry.1))
            };
            block.push_row(innovations.jacobian.state.row(row).iter().copied().chain(of(true)));
            shared.push_row(of(false));
        }
        SplitRows { block, shared }
    }
}

/// What an analysis adds to the estimate.
pub(crate) struct Increments {
    /// To the block variables: the state's values, then the local parameters.
    pub of_blocks: Vec<f64>,
    /// To the shared parameters.
    pub of_shared: Vec<f64>,
}

/// What an analysis came to beside the covariance.
pub(crate) struct BlockAnalysis {
    pub increments: Increments,
    /// dᵀ Cov(d)⁻¹ d.
    pub chi2: f64,
    pub partition: PartitionReport,
    /// What it says of the amplitudes of free columns, if there are any.
    pub found: Option<Found>,
}

/// The solution of an analysis, before its partition is reported.
pub(super) struct Solved {
    pub increments: Increments,
    pub chi2: f64,
    pub found: Option<Found>,
}

impl Solved {
    pub fn with(self, partition: PartitionReport) -> BlockAnalysis {
        let Self { increments, chi2, found } = self;
        BlockAnalysis { increments, chi2, partition, found }
    }
}

/// What an analysis says of the amplitudes C of free columns: see `free_columns`.
pub(crate) struct Found {
    /// J.
    pub matrix: Mat<f64>,
    /// j.
    pub vector: Vec<f64>,
    /// By how much dᵀ Cov(d)⁻¹ d is larger for C = 0 than with the nominal prior.
    pub chi2_of_zero: f64,
}

/// A vector over (x, c) from what it holds of the block variables, the state's values and then the local parameters with these
/// numbers, and of the shared parameters.
pub(in crate::errors) fn augmented(
    of_blocks: &[f64],
    of_shared: &[f64],
    local: &[usize],
    shared: &[usize],
) -> Vec<f64> {
    let m = of_blocks.len() - local.len();
    let mut all = of_blocks[..m].to_vec();
    all.resize(m + local.len() + shared.len(), 0.0);
    for (&number, value) in local.iter().zip(&of_blocks[m..]).chain(shared.iter().zip(of_shared)) {
        all[m + number] = *value;
    }
    all
}

/// What a vector h over (x, c) holds of the block variables: the inverse of [`augmented`].
pub(in crate::errors) fn of_blocks<'a>(h: &'a [f64], m: usize, local: &'a [usize]) -> impl Iterator<Item = f64> + 'a {
    h[..m].iter().copied().chain(local.iter().map(move |&number| h[m + number]))
}
